"""Every key of a campaign file in one table: its check, its meaning, an example."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from jbw.campaign.values import (
    a_prior,
    a_repeat_list,
    a_whole_number,
    files,
    level_list,
    modes,
    non_negative,
    number,
    one_of,
    positive,
    positive_list,
    rising_pair,
    role_numbers,
    role_paths,
    role_units,
    sampling,
    some_of,
    strings,
    text,
    yes_or_no,
)

# Kinds whose likelihood leaves out the samples that a record masks. The others need every sample:
# a transform spreads one bad sample over all frequencies, a simulation needs all of its input.
MASKABLE = ("frf",)
KINDS = ("noise", "multisine", "tones", "stepped", "sweep", "decay", "frf", "loop")
SAMPLERS = (
    "nuts",
    "elliptical_slice",
    "random_walk",
    "random_walk_paper",
    "importance",
    "tempered_smc",
    "nested",
    "quadrature",
)
RESPONSES = {"displacement", "velocity", "acceleration"}
SOURCES = {"input", "force"}


@dataclass(frozen=True)
class Key:
    """One key: how its value is checked, whether it must be there, and what it means."""

    check: Callable[[Any], Any]
    says: str
    required: bool = False
    example: str = "..."


CAMPAIGN = {
    "name": Key(text, "a short name", example='"beam"'),
    "gain": Key(positive, "force per modal mass for one volt [N/kg/V]", example="15.0"),
    "modal_mass": Key(positive, "[kg], for a measured force", example="1.93"),
}
TEST = {
    "kind": Key(one_of(*KINDS), f"one of {', '.join(KINDS)}", required=True),
    "files": Key(
        files,
        "file or pattern, or a list of them; or a table role = file, where each role has its own",
        required=True,
    ),
    "channels": Key(
        role_paths,
        "role = channel's name or path in the file: [3] counts from zero, (4) and {4} from one as "
        "in MATLAB, [:] takes all, and 'a - b' is a difference",
        required=True,
    ),
    "units": Key(role_units, "role = unit"),
    "scale": Key(role_numbers, "role = calibration factor, before the unit"),
    "name": Key(text, "a short name, unique"),
    "level": Key(
        non_negative, "nominal level, in the unit of what the rig held constant", example="0.20"
    ),
    "amplitudes": Key(
        one_of("peak", "rms"), "what the amplitudes of kind frf are", example='"peak"'
    ),
    "periods": Key(a_whole_number(1), "whole periods of the excitation in a record", example="4"),
    "fs": Key(sampling, "sampling frequency [Hz], or the path of a scalar in the file"),
    "band": Key(rising_pair, "lowest and highest frequency to use [Hz]", example="[5.0, 40.0]"),
    "tones": Key(positive_list, "frequencies present at once, or in turn if stepped [Hz]"),
    "dwell": Key(positive, "duration of each step of a stepped test [s]"),
    "settle": Key(non_negative, "time to discard before the steady state [s]"),
    "delay": Key(number, "lag of the response channel behind the input [s]", example="0.0"),
    "assembly": Key(text, "which assembly of the joint", example='"first"'),
    "run": Key(text, "which day or run", example='"monday"'),
    "repeats": Key(one_of("files", "rows"), "one repeat a file, or one a row"),
    "exclude": Key(
        a_repeat_list,
        "repeats to drop: numbers counted from zero, or file names",
        example='[2, "bad_*.h5"]',
    ),
    "remove_mean": Key(
        yes_or_no, "take the mean out of input and response, for offsets", example="true"
    ),
    "gaps": Key(
        one_of("refuse", "mask"),
        "what to do with samples that are NaN; mask leaves out these lines of kind frf",
        example='"refuse"',
    ),
    "span": Key(rising_pair, "first and last second to read", example="[0.0, 8.0]"),
}
IDENTIFY = {
    "fit_levels": Key(
        level_list, "sweep levels to fit; the others are predicted", example="[0.05, 0.20]"
    ),
    "fit_repeats": Key(
        a_whole_number(1), "so many repeats are fitted; the rest held out", example="32"
    ),
    "fit": Key(some_of(*KINDS), f"kinds to fit, among {', '.join(KINDS)}; all by default"),
    "hold_out": Key(strings, "names of tests that no fit sees"),
    "compare_with": Key(
        some_of("linear", "cubic"),
        "oscillators without hysteresis to compare with; linear by default",
        example='["linear", "cubic"]',
    ),
    "offsets": Key(
        one_of("auto", "runs", "none"),
        "whether each run has an omega_n and a zeta of its own; auto: where the data show it",
        example='"auto"',
    ),
    "model_error": Key(
        one_of("auto", "none"),
        "auto: coloured residuals, and misfit that all repeats share, count for fewer values; "
        "none: the law is taken for exact",
        example='"auto"',
    ),
    "coordinates": Key(
        one_of("auto", "paper", "products"),
        "sample alpha, delta, gamma or their products; auto: products where no more is known",
        example='"auto"',
    ),
    "substeps": Key(
        a_whole_number(1), "solver steps a sample; by default as many as the data take"
    ),
    "sampler": Key(
        one_of("auto", *SAMPLERS),
        "of the joint posterior; auto: elliptical slices where time is stepped through, else NUTS; "
        "importance, tempered_smc, nested and quadrature give the evidence too",
        example='"auto"',
    ),
    "profiles": Key(
        yes_or_no,
        "follow every parameter's profile likelihood, at some hundred fits",
        example="true",
    ),
    "num_chains": Key(a_whole_number(1), "chains", example="4"),
    "num_samples": Key(a_whole_number(1), "draws kept a chain", example="1000"),
    "num_warmup": Key(a_whole_number(0), "draws to adapt with, a chain", example="500"),
    "seed": Key(a_whole_number(0), "of the random numbers", example="0"),
    "modes": Key(
        modes, "frequencies of the modes in the band [Hz], the joint's own first", example="[18.8]"
    ),
    "prior": Key(a_prior, "parameter = [lower, upper], in SI", example="{ zeta = [0.003, 0.006] }"),
}
TABLES = {"campaign": CAMPAIGN, "test": TEST, "identify": IDENTIFY}

"""The settings of an identification: the tables [identify] and [joint]."""

import sys
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, StrictBool, model_validator

from jbw.campaign import values
from jbw.campaign.document import LISTED, FileTable, checked, key, refuse, unlike
from jbw.errors import ConfigError
from jbw.inference.density import Density
from jbw.inference.samplers.register import SAMPLERS
from jbw.measurement.kinds import KINDS, Kind
from jbw.quantities import (
    AT,
    BOUC_WEN,
    DEFAULT_LAWS,
    LINEAR,
    MODES,
    POINTS,
    RESIDUAL_TERMS,
    Quantity,
    joints_of,
    motion_factor,
    must_be,
)

LIMIT = 0.05  # largest relative error of held-out tests with which a law counts as predictive
MOST_MODES = 1 + len(MODES)  # largest number of modes that a structure may have
MOST_POINTS = len(POINTS)  # largest number of response points in addition to the first
SPRING = "cubic"  # law that is added if only a prior on its parameter is stated

Prior = Mapping[str, tuple[float, float]]
Sampler = Annotated[str, values.OneOf(lambda: ("auto", *SAMPLERS))]


def _coordinates() -> tuple[str, ...]:
    """Return the names of all parametrisations, including those of laws that are loaded."""
    register = sys.modules.get("jbw.oscillator.laws")
    laws = () if register is None else register.LAWS.values()
    named = dict.fromkeys(name for law in laws for name in law.coordinates)
    return tuple(dict.fromkeys(("auto", "paper", "products", *named)))


Coordinates = Annotated[str, values.OneOf(_coordinates)]
Reference = Literal["linear", "cubic"]
References = Annotated[
    tuple[Reference, ...],
    BeforeValidator(
        lambda value: () if value == [] else values.strings(value),
        json_schema_input_type=Reference | list[Reference],
    ),
]


class Identify(FileTable):
    """The settings of an identification: fitted tests, held-out tests and sampling.

    None means that the data or the sampler decide.
    """

    fit_levels: values.Levels | None = key(
        None, "sweep levels to fit; the others are predicted", [0.05, 0.20]
    )
    fit_repeats: values.Repeats | None = key(
        None,
        'number of repeats of every test to fit, or "all"; the other repeats are held out; by '
        "default half of them if there are four or more",
        32,
    )
    fit: values.ToFit | None = key(None, f"kinds to fit, among {', '.join(KINDS)}; all by default")
    hold_out: values.Strings = key((), "names of tests that are held out of every fit")
    predictive: Annotated[float, Field(gt=0, le=0.25), BeforeValidator(values.number)] = key(
        LIMIT,
        (
            "largest error of held-out tests, relative to their rms, with which a law counts as "
            "predictive; 0.05 by default"
        ),
        0.03,
    )
    final: StrictBool = key(
        False,
        "fit all tests once more after the errors of the held-out tests are known. This takes the "
        "time of both fits; the verdict still uses the errors of the held-out tests",
        True,
    )
    strict: StrictBool = key(
        False,
        "refuse the campaign if a test cannot be used; by default such a test is left out",
        True,
    )
    compare_with: References = key(
        ("linear",),
        "oscillators without hysteresis to compare with; linear by default, none if empty",
        ["linear", "cubic"],
    )
    offsets: Literal["auto", "runs", "none"] = key(
        "auto",
        "whether each run has its own omega_n and zeta. auto: only if the data show that runs "
        "differ. Levels of one assembly share zeta, unless zeta varies between repeats of one "
        "level",
        "auto",
    )
    run_scatter: values.Positive | None = key(
        None,
        "expected relative standard deviation of omega_n between runs, within a factor of "
        "two; by default anything from 1e-7 to 1e-2, or 5e-4 when laws are compared",
        5e-4,
    )
    model_error: Literal["auto", "none"] = key(
        "auto",
        "auto: correlated residuals, and errors that all repeats share, count as fewer "
        "independent values; none: the law is taken as exact",
        "auto",
    )
    coordinates: Coordinates = key(
        "auto",
        "sample the laws' parameters as in the paper, or their products; auto: products if "
        "only these are identified",
        "auto",
    )
    substeps: values.Count | None = key(
        None, "solver steps per sample; by default as many as the data need"
    )
    sampler: Sampler = key(
        "auto",
        "sampler of the joint posterior; auto: weighted points in rounds (amis), or chains if "
        "these do not suit; amis, importance, tempered_smc, nested and quadrature also give "
        "the evidence",
        "auto",
    )
    profiles: StrictBool = key(
        False, "compute the profile likelihood of every parameter, by some hundred fits", True
    )
    num_chains: values.Count = key(4, "number of chains", 4)
    num_samples: values.Count | None = key(None, "number of draws per chain", 1000)
    num_warmup: values.Index | None = key(None, "warm-up draws per chain", 500)
    budget_s: values.Positive = key(
        900.0,
        "time limit [s] for drawing from the joint posterior until the draws are sufficient; if "
        "num_samples is stated, that number is drawn instead, sufficient or not",
        600.0,
    )
    seed: values.Index = key(0, "seed of the random numbers", 0)
    modes: values.Modes = key(
        (),
        "modes in the band; by default one mode is fitted. Either the frequencies [Hz] of the "
        "joint's mode and then of its linear neighbours, or the number of modes: Step 2 then finds "
        "the modes in the noise or multisine test, and takes the highest peak as the joint's mode",
        [18.8, 21.4],
    )
    prior: Mapping[str, values.Prior] = key(
        dict,
        "parameter = [lower, upper], uniform and in SI, or a distribution of NumPyro by name and "
        "arguments, such as LogNormal",
        {"zeta": [0.003, 0.006]},
    )

    @classmethod
    def of(cls, stated: "Identify | Mapping[str, Any]") -> "Identify":
        """Return [identify] settings, given as a record or as a mapping of keys.

        Raises:
            ConfigError: The [identify] table does not accept a key or value.
        """
        if isinstance(stated, cls):
            return stated
        errors: list[str] = []
        settings = checked(cls, stated, "[identify]", errors)
        refuse("Argument `settings`", errors)
        return settings or cls()

    def draws(self, own: tuple[int, int]) -> tuple[int, int]:
        """Return the numbers of warm-up and stored draws per chain, by default the sampler's."""
        num_warmup, num_samples = own
        return (
            num_warmup if self.num_warmup is None else self.num_warmup,
            num_samples if self.num_samples is None else self.num_samples,
        )


class Structured(FileTable):
    """The [structure] table: the modes that move the joint, with what is known about them."""

    modes: values.Frequencies = key(
        ...,
        "natural frequencies [Hz] of the modes that share the joint, beginning with the "
        "mode in whose motion the laws are expressed",
        [18.8, 57.2],
    )
    driving_point: StrictBool = key(
        False, "the response is measured where the source pushes, in the same direction", True
    )
    joint_shape: values.Shapes = key(
        (),
        "motion of the joint in every mode, divided by that of the response, as measured across "
        "the joint; a common factor does not matter",
        [1.0, -0.8],
    )

    modal: StrictBool = key(
        False, "each mode has separate laws, and no mode is affected by the others", True
    )
    points: values.Strings = key(
        (),
        "names of additional points where responses are measured; the first point, where the "
        "modes have unit size, needs no name",
        ["wing", "tip"],
    )

    @classmethod
    def of(cls, stated: "Structured | Mapping[str, Any] | None") -> "Structured | None":
        """Return [structure] settings, given as a record or as a mapping; None for one mode.

        Raises:
            ConfigError: The [structure] table does not accept a key or value.
        """
        if stated is None or isinstance(stated, cls):
            return stated
        errors: list[str] = []
        structure = checked(cls, stated, "[structure]", errors)
        refuse("Argument `structure`", errors)
        return structure

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        shape, num = self.joint_shape, len(self.modes)
        if len(self.points) > MOST_POINTS or len(set(self.points)) < len(self.points):
            raise ValueError(
                f"points: must be at most {MOST_POINTS} different names, but are {self.points}."
            )
        if self.modal and (self.driving_point or shape):
            named = "driving_point" if self.driving_point else "joint_shape"
            raise ValueError(
                f"modal: modes with separate laws do not share a joint, but `{named}` describes a "
                f"shared joint; leave out `modal` or `{named}`."
            )
        if self.points and num == 1:
            raise ValueError(
                "points: need two modes or more, but `modes` has one; a single mode moves all "
                "points in proportion, so the first point suffices."
            )
        if shape and len(shape) != num:
            raise ValueError(
                f"joint_shape: must have one number per mode, {num}, but has {len(shape)}."
            )
        if num > MOST_MODES:
            raise ValueError(f"modes: must be {MOST_MODES} at most, but are {num}.")
        return self


def structure_errors(
    structure: Structured | None, tests: Iterable[Any], points: Iterable[str] = ()
) -> Iterator[str]:
    """Yield an error for each test at an unknown point, or of a kind that allows only one mode.

    `points` are the points defined with a model's matrices.
    """
    points = tuple(points) if structure is None else structure.points
    for test in tests:
        test_points = (test.point, *getattr(test, "points", ()))
        for point in (point for point in test_points if point and point not in points):
            listed = ", ".join(points) or "of which there are none"
            yield (
                f"[structure] points: must name `{point}`, where test `{test.name}` has a "
                f"response, but names {listed}; add `{point}`."
            )
    if structure is None:
        return
    several = [kind.name for kind in KINDS.values() if _knows_several(kind)]
    for test in tests if len(structure.modes) > 1 else ():
        if test.traits.is_free and (structure.modal or test.point):
            what = "modal" if structure.modal else "points"
            yield (
                f"[structure] {what}: free decays of several modes allow only one joint and one "
                f"point, but test `{test.name}` is a free decay; identify every mode in a separate "
                "band."
            )
        if not _knows_several(test.traits):
            named = f"test `{test.name}`" if test.name else "a test"
            yield (
                f"[structure]: {named} is of kind `{test.kind}`, which models only one mode; leave "
                "the test out of the file, or state only one mode (kinds that model several modes: "
                f"{', '.join(several)})."
            )


def _knows_several(kind: Kind) -> bool:
    """Return whether tests of a kind are simulated over time, as several modes require."""
    return kind.is_transient or kind.is_periodic or kind.is_free


class JointLaws(FileTable):
    """The [joint] table: the laws that act in parallel across the joint."""

    laws: values.Laws = key(
        DEFAULT_LAWS,
        "laws of the joint, which act in parallel; none, [], for a linear structure",
        ["bouc_wen", "cubic"],
    )


def laws_of(laws: Sequence[str], prior: Container[Any]) -> tuple[str, ...]:
    """Return the names of a campaign's laws, including a cubic spring implied by its prior."""
    laws = tuple(laws)
    return (*laws, SPRING) if SPRING in prior and laws == DEFAULT_LAWS else laws


def law_errors(
    laws: Sequence[str], prior: Prior, num_modes: int = 1, kinds: Iterable[str] = ()
) -> list[str]:
    """Return the errors in a campaign's laws, and in the priors on their parameters and modes.

    Laws may also be wrong for the kinds of tests. The register of laws loads JAX, so it is used
    only if [joint] or a prior needs it.
    """
    quantities = {quantity.name: quantity for quantity in (*LINEAR, *RESIDUAL_TERMS)}
    quantities |= {
        quantity.name: quantity for mode in MODES[: num_modes - 1] for quantity in mode[:-1]
    }
    quantities |= {quantity.name: quantity for point in POINTS for quantity in point[:num_modes]}
    at_joints = [motion_factor(i + 1, j) for j in joints_of(laws) for i in range(num_modes)]
    quantities |= {quantity.name: quantity for quantity in at_joints}
    if tuple(laws) == DEFAULT_LAWS:
        quantities |= {quantity.name: quantity for quantity in BOUC_WEN}
    if tuple(laws) != DEFAULT_LAWS or set(prior) - set(quantities):
        from jbw.oscillator.laws import quantities_of
        from jbw.oscillator.modes.parameters import own_quantities

        try:
            quantities |= {quantity.name: quantity for quantity in quantities_of(laws)}
            quantities |= {
                quantity.name: quantity for quantity in own_quantities(tuple(laws), num_modes)
            }
        except ConfigError as error:
            return [f"[joint] laws: {' '.join(filter(None, (error.what, error.remedy)))}"]
        if worn := never_steady(laws, kinds):
            return [f"[joint] laws: {worn}"]
    errors = [*_out_of_bounds(prior, quantities)] or [*_too_stiff(prior, quantities)]
    return [f"[identify] prior: {line}" for line in errors]


def never_steady(laws: Sequence[str], kinds: Iterable[str]) -> str | None:
    """Return the error for a degrading law in tests that need steady motion, or None."""
    from jbw.oscillator.laws import laws_named

    worn = [law.name for law in laws_named(laws) if law.degrades]
    steady = sorted({kind for kind in kinds if kind in KINDS and KINDS[kind].is_cycle_by_cycle})
    if not worn or not steady:
        return None
    return (
        f"under `{worn[0]}` every cycle changes the joint, but tests of kind "
        f"{', '.join(f'`{kind}`' for kind in steady)} are predicted by steady motion. Put "
        "these tests into a separate campaign, with the same law before damage. Put under [joint]: "
        '`laws = ["bouc_wen_nu"]`.'
    )


def _out_of_bounds(prior: Prior, quantities: Mapping[str, Quantity]) -> Iterator[str]:
    unknown = [name for name in prior if name not in quantities]
    if len(unknown) > LISTED:
        yield (
            f"{len(unknown)} unknown parameters: {', '.join(unknown[:3])[:60]}, ...; "
            "state only parameters of the chosen laws."
        )
        return
    for name, (lower, _) in prior.items():
        if name not in quantities:
            from jbw.oscillator.laws import LAWS

            owners = [law.name for law in LAWS.values() if name in law.names()]
            owner = f" of the chosen laws; law `{owners[0]}` has this parameter" if owners else ""
            yield f"{name}: unknown parameter{owner}{unlike(name, quantities)}."
            continue
        if (must := must_be(quantities[name], lower)) is not None:
            cut = isinstance(prior[name], Density) and "; TruncatedNormal takes an end `low`"
            yield f"{name}: must be {must}, but its lower bound is {lower:g}{cut or ''}."


def _too_stiff(prior: Prior, quantities: Mapping[str, Quantity]) -> Iterator[str]:
    """Yield an error for each prior that allows a joint to be as stiff as the whole structure."""
    least = prior["omega_n"][0] ** 2 if "omega_n" in prior else inf
    shares = {
        name: highest
        for name, (_, highest) in prior.items()
        # With several joints, each joint has its own stiffness.
        if quantities[name].is_share and AT not in name
    }
    stiff = [(name, highest) for name, highest in shares.items() if highest >= least]
    if not stiff and sum(shares.values()) >= least:
        stiff = [(" + ".join(shares), sum(shares.values()))]
    for name, highest in stiff:
        yield (
            f"{name} < omega_n^2 must hold everywhere, but {name} reaches {highest:g} "
            f"and omega_n^2 begins at {least:g}; lower {name}'s upper bound."
        )

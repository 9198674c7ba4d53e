"""Campaigns with a reduced model and several joints: driven modes, checks, bounds of the laws."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np
from jaxtyping import Float

from jbw.campaign.joints import SeveralJoints
from jbw.campaign.settings import MOST_MODES, MOST_POINTS, Identify
from jbw.errors import ConfigError, DataError
from jbw.identification.uncertain_shapes import shape_factors, shape_prior
from jbw.measurement.channels import lines_within
from jbw.measurement.records import Test, drive_of
from jbw.observables.dataset import Dataset
from jbw.observables.modal_readings import DRIVEN
from jbw.observables.modes import HARDLY_SEEN, Modes, gain_shares
from jbw.oscillator.law import Bounds, Scales, feels_rate
from jbw.oscillator.laws import law_named
from jbw.oscillator.modes.assembled import STIFFNESS, held_numbers, motion_name, seen_name
from jbw.quantities import FED, label, name_at, split

ASSEMBLED = "assembled"
FEWEST = 3  # smallest number of strong spectral lines within 7 % of a mode that a source drives


def assembled_modes(joints: SeveralJoints, tests: Sequence[Test], settings: Identify) -> Modes:
    """Return the modes of a reduced model that the tests drive or measure.

    Raises:
        ConfigError: Tests, laws or settings are not supported for several joints.
        DataError: The tests drive no mode of the model, or too many.
    """
    reduced = joints.model
    require_known_laws(joints.laws)
    _require_kinds(tests)
    _require_sources(tests)
    if "cubic" in settings.compare_with:
        raise ConfigError(
            "[identify] compare_with must be linear if a structure has several joints, but "
            "names cubic, a spring of one joint.",
            remedy='Put under [identify]: `compare_with = ["linear"]`, or leave `compare_with` '
            "out.",
        )
    if settings.coordinates not in ("auto", "paper"):
        raise ConfigError(
            "[identify] coordinates must be auto or paper if a structure has several joints, "
            f"but is {settings.coordinates}.",
            why="For several joints, the coordinates of the samplers are always the parameters of "
            "the laws.",
            remedy="Leave `coordinates` out of [identify].",
        )
    _require_first_point(reduced.outputs[0], tests)
    driven = _driven_modes(reduced, tests)
    _require_bands(tests, reduced.frequencies_hz[driven])
    order = [*driven, *(i for i in range(reduced.omega.size) if i not in driven)]
    points = tuple(sorted({test.point for test in tests if test.point}))  # as in `seen_by`
    if len(points) > MOST_POINTS:
        raise ConfigError(
            f"[structure] points: tests may be measured at up to {MOST_POINTS} points in addition "
            f"to the first, but are measured at {len(points)}.",
            remedy="Leave tests out of the campaign file, so that at most "
            f"{MOST_POINTS + 1} points remain.",
        )
    rows = dict(zip(reduced.outputs, reduced.c[:, order], strict=True))
    numbers = held_numbers(
        reduced.omega[order],
        reduced.zeta[order],
        {label(j.name): row for j, row in zip(reduced.joints, reduced.H[:, order], strict=True)},
        {label(joint.name): joint.stiffness for joint in reduced.joints},
        reduced.b[order],
        {"": rows[reduced.outputs[0]], **{point: rows[point] for point in points}},
    )
    hz = tuple(float(reduced.frequencies_hz[i]) for i in driven)
    return Modes(
        hz,
        points=points,
        meet=ASSEMBLED,
        numbers=tuple(numbers.items()),
        uncertain=joints.uncertain,
    )


def _require_first_point(first: str, tests: Sequence[Test]) -> None:
    """Raise a ConfigError if no test is at the first point, which determines the gain."""
    if all(test.point for test in tests):
        raise ConfigError(
            "[structure] points: at least one test must leave `point` out, which means that it is "
            f"measured at the first point, `{first}`, but all tests state `point`, for example "
            f"`{tests[0].point}`.",
            remedy=f"Remove `point` from the tests at `{first}`, or put another point first in "
            "`points` of [structure].",
        )


def require_known_laws(laws: Sequence[str]) -> None:
    """Raise a ConfigError for laws that cannot be identified in structures with several joints.

    Raises:
        ConfigError: A law is a damper, or changes with every cycle.
    """
    for name in laws:
        plain, joints = split(name)
        kind = law_named(plain)
        if (drags := feels_rate(kind)) or kind.degrades:
            behaviour = "is a damper" if drags else "changes with every cycle"
            raise ConfigError(
                f"[[joint]] `{joints[0]}` laws: must be springs or hysteresis that does not change "
                f"from cycle to cycle, but `{plain}` {behaviour}, which is not supported yet for "
                "several joints.",
                remedy="Give the joint hysteresis such as bouc_wen, or a spring.",
            )


def _require_kinds(tests: Sequence[Test]) -> None:
    for test in tests:
        if not (test.traits.is_transient or test.traits.is_periodic or test.traits.is_free):
            raise ConfigError(
                f"[[test]] {test.name}: must be a sweep, a multisine or free decays if the "
                f"structure has several joints, but is of kind `{test.kind}`, which is not "
                "supported yet for several joints.",
                remedy="Leave the test out of the campaign file.",
            )
        if test.traits.is_free and test.point:
            raise ConfigError(
                f"[[test]] {test.name}: free decays must be measured at the first point of "
                f"[structure] if the structure has several joints, but `point` is `{test.point}`.",
                remedy="Leave the test out of the campaign file.",
            )


def _require_bands(tests: Sequence[Test], driven_hz: Float[np.ndarray, " mode"]) -> None:
    """Raise a ConfigError if the band of a free decay does not contain every fitted mode."""
    low_hz, high_hz = driven_hz.min(), driven_hz.max()
    for test in tests:
        if not test.traits.is_free or test.band_hz is None:
            continue
        low, high = test.band_hz
        if not (low < low_hz and high_hz < high):
            raise ConfigError(
                f"[[test]] {test.name}: `band` must contain all modes that the tests move, "
                f"{', '.join(f'{hz:.4g}' for hz in driven_hz)} Hz, but is {low:g} to {high:g} Hz.",
                why="The modes of a free decay ring at once, and all move the joints.",
                remedy="Widen `band`, or leave the test out of the campaign file.",
            )


def _require_sources(tests: Sequence[Test]) -> None:
    """Raise a ConfigError for several kinds of source, or for a source in N/kg."""
    tests = [test for test in tests if not test.traits.is_free]
    drives = sorted({drive_of(test) for test in tests})
    if len(drives) > 1:
        raise ConfigError(
            "[structure] needs tests of one drive, but the tests are driven by "
            f"{' and '.join(drives)}.",
            why="A shaker that moves with the structure changes every mode.",
            remedy="Leave the tests of one drive out of the campaign file.",
        )
    for test in tests:
        record = test.records[0]
        if record.units[record.source] == "N/kg":
            raise ConfigError(
                f"[[test]] {test.name}: the source must be a force, a voltage or a current if "
                "[structure] has `matrices`, but is in N/kg, a force per modal mass.",
                remedy="Give the force in N.",
            )


def _driven_modes(reduced: Any, tests: Sequence[Test]) -> list[int]:
    """Return the indices of the driven elastic modes; begin with a well measured one."""
    frequencies = reduced.frequencies_hz
    elastic = [i for i, hz in enumerate(frequencies) if hz > 0]
    windows = Modes(tuple(float(frequencies[i]) for i in elastic)).windows_hz
    passed = {i for test in tests for i, window in zip(elastic, windows, strict=True)
              if _moves(test, window)}  # fmt: skip
    gains = np.abs(reduced.b * reduced.c[0])
    driven = sorted(passed)
    if not driven:
        raise DataError(
            "[structure] to_hz: a test must drive a mode of the model within 7 % of the mode's "
            "frequency, but no test does. Modes of the model: "
            f"{', '.join(f'{frequencies[i]:.4g}' for i in elastic[:5])} Hz.",
            remedy="Sweep through a mode, or correct `units` and `stiffness`.",
        )
    if len(driven) > MOST_MODES:
        raise DataError(
            f"[structure] to_hz: tests must drive {MOST_MODES} modes at most, but drive "
            f"{len(driven)}.",
            remedy="State a narrower `band` in the tests, so that the bands contain fewer modes.",
        )
    observed = [i for i in driven if gains[i] > HARDLY_SEEN * gains[driven].max()]
    if not observed:
        raise DataError(
            f"[structure] points: the first point, `{reduced.outputs[0]}`, must move in a mode "
            "that the tests drive, but in the model this point or the input is at a node of every "
            "driven mode.",
            remedy="Name another point first, or correct the direction of `input`.",
        )
    return [observed[0], *(i for i in driven if i != observed[0])]


def _moves(test: Test, window_hz: tuple[float, float]) -> bool:
    """Return whether a test moves a mode: its source drives the mode, or the test is its decay."""
    if not test.traits.is_free:
        return passes(test, window_hz)
    if test.band_hz is None:
        return False
    low, high = test.band_hz
    return low < sum(window_hz) / 2 < high


def passes(test: Test, window_hz: tuple[float, float]) -> bool:
    """Return whether a test's source has enough strong spectral lines in a frequency range."""
    record = test.records[0]
    hz = np.fft.rfftfreq(record.num_samples, 1 / record.fs)
    size = np.abs(np.fft.rfft(record.channels[record.source]))
    is_loud = (size > DRIVEN * size[1:].max()) & lines_within(hz, window_hz) & (hz > 0)
    if test.band_hz is not None:
        is_loud &= lines_within(hz, test.band_hz)
    return int(np.sum(is_loud)) >= FEWEST


def known_gain(modes: Modes | None, tests: Sequence[Test]) -> float | None:
    """Return the first mode's gain from the model [1/kg] if a force is measured, or else None."""
    driven = [test for test in tests if not test.traits.is_free]
    if modes is None or modes.meet != ASSEMBLED or not driven or drive_of(driven[0]) in FED:
        return None
    numbers = dict(modes.numbers)
    return numbers["push_1"] * numbers["seen_1"]


def with_steps(parts: Sequence, modes: Modes | None, settings: Identify) -> list:
    """Return the data with solver steps that resolve the fastest residual mode (1 rad per step).

    Raises:
        ConfigError: The stated `substeps` are too few: the motion would be unstable.
    """
    if modes is None or modes.meet != ASSEMBLED:
        return list(parts)
    highest = max(x for name, x in modes.numbers if name.startswith("model_omega_"))
    stepped = []
    for part in parts:
        needed = 2 ** int(np.ceil(np.log2(highest / part.fs)))
        if settings.substeps is not None and highest / part.fs / settings.substeps > np.pi:
            raise ConfigError(
                f"[identify] substeps must be {needed} at least, so that steps follow the residual "
                f"mode at {highest / (2 * np.pi):.4g} Hz, but is {settings.substeps}.",
                remedy=f"Put under [identify]: `substeps = {needed}`, or no `substeps`.",
            )
        least = settings.substeps or max(needed, part.substeps)
        stepped.append(replace(part, substeps=least))
    return stepped


def joint_bounds(
    modes: Modes, data: Dataset, stated: Mapping[str, tuple[float, float]], zeta: float
) -> Bounds:
    """Return wide prior bounds of all joints' laws, and of the factors on their mode shapes.

    Bounds of the laws follow from the joint's stiffness when fully stuck and its largest motion.

    Raises:
        ConfigError: Bounds that a campaign states allow a joint stiffer than when fully stuck.
    """
    numbers = dict(modes.numbers)
    bounds: Bounds = {}
    for name in data.laws:
        joints = split(name)[1]
        stiffness = min(numbers[name_at(STIFFNESS, joint)] for joint in joints)
        peak = max(_largest_motion(modes, data, joint) for joint in joints)
        prior = law_named(name).prior(Scales(sqrt(stiffness), zeta, peak))
        same_joints = [law for law in data.laws if split(law)[1] == joints]
        shares = {quantity.name for quantity in law_named(name).table if quantity.is_share}
        for parameter, (low, high) in prior.items():
            high = high / len(same_joints) if parameter in shares else high
            bounds[parameter] = stated.get(parameter, (low, high))
            if parameter in shares and bounds[parameter][1] > stiffness:
                raise ConfigError(
                    f"[identify.prior] `{parameter}`: the upper bound must be below {stiffness:g} "
                    f"N/m, the `stiffness` of the fully stuck joint `{joints[0]}`, but is "
                    f"{bounds[parameter][1]:g}.",
                    remedy=f"Lower the upper bound of `{parameter}`, or raise `stiffness`.",
                )
    factors = shape_factors(modes, data.laws)
    return bounds | {name: stated.get(name, shape_prior()) for name in factors}


def _largest_motion(modes: Modes, data: Dataset, joint: str) -> float:
    """Return a joint's largest motion [m or rad] in any mode that the first point shows."""
    numbers, amplitudes = dict(modes.numbers), largest_amplitudes(modes, data)
    motion = [numbers[motion_name(i, joint)] for i in range(1, len(amplitudes) + 1)]
    return float(np.nanmax(np.abs(motion) * amplitudes))


def largest_amplitudes(modes: Modes, data: Dataset) -> Float[np.ndarray, " mode"]:
    """Return the largest amplitude of each driven mode, NaN if the first point hardly shows it."""
    numbers, shares = dict(modes.numbers), np.abs(gain_shares(modes))
    peaks_of_parts = (part.shown().peaks_of_modes for part in data.parts)
    peaks = np.max([largest for largest in peaks_of_parts if largest], axis=0)
    sensor_shapes = np.array([numbers[seen_name(i)] for i in range(1, len(shares) + 1)])
    is_seen = shares > HARDLY_SEEN * shares.max()
    return np.where(is_seen, peaks / np.where(is_seen, np.abs(sensor_shapes), 1.0), np.nan)

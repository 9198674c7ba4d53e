"""A day at the rig: every planned test is played, sensed, recorded and written to files.

A campaign is written in the form that a laboratory would deliver: HDF5 files and a campaign file.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw.campaign.document import toml
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.errors import ConfigError, RunError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.kinds import kind_named
from jbw.measurement.records import Test
from jbw.oscillator.oscillator import Joint, as_oscillator
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import rig as messages
from jbw.rig.conditions import Conditions, check, specimen_of_days
from jbw.rig.integrator import specimen_of
from jbw.rig.presets import PRIOR, TRUTH, Plan, Preset, plans_named, preset_named
from jbw.rig.record_test import record_test
from jbw.rig.structure import first_mode_truth, law_of_mode, of_day


@dataclass(frozen=True)
class RigCampaign(Campaign):
    """A measured campaign in memory; the identification has to find its gain and modal mass."""

    # the true parameters behind the data, which serve only to judge an identification
    truth: Mapping[str, Any] = field(default_factory=dict)
    # For each test, the demanded signal of the source in each repeat [V or N], if the source is
    # recorded.
    demands: Mapping[str, Sequence[NDArray[np.float64]]] = field(default_factory=dict, repr=False)


def measure(
    preset: str | Preset = "laboratory",
    *,
    seed: int = 0,
    joint: Joint = TRUTH,
    tests: Iterable[str] | None = None,
    repeats: int | None = None,
    noise_std: float | None = None,
    noise_ratio: float | None = None,
    input_noise_std: float | None = None,
    force_noise_std: float = 0.02,
    bits: int = 24,
    distortion_db: float | None = None,
    delay: float = 0.0,
    omega_n_cv: float | None = None,
    zeta_cv: float | None = None,
    fs: float = 1024.0,
) -> RigCampaign:
    """Measure a campaign on the virtual specimen; equal arguments give bit-identical data.

    Every test has its own streams of random numbers, so a subset of the tests, or fewer repeats,
    gives the same records as the whole campaign. Repeat r of every test is taken on day r. With
    `omega_n_cv` or `zeta_cv` the joint is reassembled each day and is the same that day in all
    tests; each day's record then becomes a separate test, whose run is the day. Teloli et al.
    found 0.0018 for omega_n between assemblies.

    Args:
        preset: "everyday", "laboratory", "paper", "mixed", "modes", "controlled" or your own
            preset.
        seed: Seed of everything random.
        joint: The specimen: a `BoucWen` with nu = 1, or an `Oscillator` such as `SLIDERS` with any
            laws; the rig has separate code for each law (`jbw.rig.law_forces`).
        tests: Names of the tests to measure, in the order of the preset; all when None.
        repeats: Records of each test; the preset's number when None.
        noise_std: Laser noise over 0 .. fs/2 [m/s]; the preset's when None.
        noise_ratio: Laser noise as a fraction of the rms velocity of each record, in place of
            `noise_std` [-].
        input_noise_std: Noise of the source's channel [V or N]; the preset's when None.
        force_noise_std: Noise of restoring forces, and of the force in response-controlled tests
            [N].
        bits: Bits of the converters.
        distortion_db: Third harmonic of the source in tones, steps, sweeps and controlled points
            [dB]; at -60 dB it is already as large as the joint's own.
        delay: Lag of the velocity channel, stated in the tests [s].
        omega_n_cv: Coefficient of variation of omega_n from day to day [-]; the preset's when None.
        zeta_cv: Coefficient of variation of zeta from day to day [-]; the preset's when None.
        fs: Sampling frequency [Hz].

    Raises:
        ConfigError: The preset or a test is unknown, or a number is out of its range.
        ModelError: JAX works in float32, the rig does not know a law, or the response is not
            finite.
    """
    rig = preset_named(preset)
    if noise_std is None and noise_ratio is None:
        noise_ratio = rig.noise_ratio
    conditions = Conditions(
        seed=seed, fs=fs, noise_std=rig.noise_std if noise_std is None else noise_std,
        noise_ratio=noise_ratio,
        input_noise_std=rig.source_noise_std if input_noise_std is None else input_noise_std,
        force_noise_std=force_noise_std, bits=bits, distortion_db=distortion_db, delay=delay,
        omega_n_cv=rig.omega_n_cv if omega_n_cv is None else omega_n_cv,
        zeta_cv=rig.zeta_cv if zeta_cv is None else zeta_cv,
    )  # fmt: skip
    check(conditions)
    if repeats is not None and repeats < 1:
        raise ConfigError(f"Argument `repeats` must be at least 1, but is {repeats}.")
    plans = [replace(p, repeats=repeats or p.repeats) for p in plans_named(rig, tests)]
    count = max(plan.repeats for plan in plans)
    days = specimen_of_days(specimen_of(joint), count, conditions)
    # Two tests run at once, because FFT, compiled loop and random numbers all release the
    # interpreter's lock.
    with ThreadPoolExecutor(max_workers=2) as pool:
        by_plan = pool.map(lambda plan: record_test(plan, rig, days, conditions), plans)
        recorded = list(chain.from_iterable(by_plan))
    truth = _truth_of(rig, joint)
    return RigCampaign(
        name=f"virtual rig, {rig.name}",
        folder=None,
        tests=tuple(test for test, _ in recorded),
        settings=_settings(rig, plans, conditions, truth["joint"]),
        truth={
            "preset": rig.name,
            **truth,
            "days": [{"omega_n": day.omega_n, "zeta": day.zeta} for day in days],
            "conditions": asdict(conditions),
        },
        demands={test.name: demands for test, demands in recorded if demands},
        laws=tuple(law.name for law in joint.laws),
    )


def _truth_of(rig: Preset, joint: Joint) -> dict[str, Any]:
    """Return the true gain and parameters that an identification of the joint should find."""
    parameters = {name: float(x) for name, x in as_oscillator(joint).parameters().items()}
    if rig.shapes is None:
        return {"gain": rig.gain, "joint": parameters}
    shapes = of_day(rig.shapes, specimen_of(joint))
    for law in as_oscillator(joint).laws:
        parameters |= law_of_mode(law, shapes)
    parameters |= first_mode_truth(shapes, rig.armature)
    return {"gain": float(shapes.drive[0] * shapes.output[0]), "joint": parameters}


def _settings(
    rig: Preset, plans: Sequence[Plan], conditions: Conditions, truth: Mapping[str, float]
) -> Identify:
    """Return settings with the prior and held-out tests (middle sweep level, half of the repeats).

    The prior contains those bounds of Teloli et al. that include the specimen's true value.
    """
    sweeps = [plan for plan in plans if kind_named(plan.kind).is_transient]
    fitted = [kind for kind in rig.fit if kind in {plan.kind for plan in plans}]
    settings: dict[str, Any] = {"fit": fitted} if fitted else {}
    # With an armature, tests have levels in two different units.
    if len(sweeps) >= 3 and rig.shapes is None:
        levels = [plan.excitation.level for plan in sweeps]
        settings["fit_levels"] = [min(levels), max(levels)]
    fewest = min((plan.repeats for plan in sweeps), default=0)
    if fewest >= 8 and not conditions.varies:
        settings["fit_repeats"] = fewest // 2
    prior = {
        name: (low, high)
        for name, (low, high) in PRIOR.items()
        if name in truth and low < truth[name] < high
    }
    return Identify(**settings, prior=prior)


def write(campaign: RigCampaign, folder: str | Path) -> Path:
    """Write the campaign's files; the campaign file comes last and marks the folder as complete.

    A folder from an interrupted call is completed; equal campaigns give equal files, byte for byte.
    The path of `campaign.toml` is returned.

    Raises:
        RunError: The folder contains a campaign or other data files, or cannot be written.
    """
    folder = Path(folder)
    target = folder / "campaign.toml"
    _check_folder(campaign, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for test in campaign.tests:
            demands = campaign.demands.get(test.name, (None,) * len(test.records))
            for record, demand in zip(test.records, demands, strict=True):
                filed = record
                # The demanded signal is written in addition to the measured source.
                if demand is not None:
                    channels = {"demand": demand, **record.channels}
                    units = {"demand": record.units[record.source], **record.units}
                    filed = replace(record, channels=channels, units=units)
                # float32 represents 24-bit converter values exactly; a response curve has no
                # converter.
                dtype = np.float64 if np.isnan(record.fs) else np.float32
                write_hdf5(folder / f"{record.name}.h5", filed, dtype=dtype)
        _write_text(folder / "truth.json", json.dumps(campaign.truth, indent=2) + "\n")
        _write_text(target, _campaign_text(campaign))
    except OSError as error:
        raise RunError(
            f"Folder {folder} must be writable, but: {error}.",
            remedy="Free some space or choose another folder.",
        ) from error
    return target


def _check_folder(campaign: RigCampaign, folder: Path) -> None:
    """Raise an error if the folder contains a finished campaign or unrelated HDF5 files."""
    if (folder / "campaign.toml").exists():
        raise RunError(
            f"Folder {folder} must be new or empty, but contains a campaign.",
            remedy=f"Choose another folder, or remove {folder}.",
        )
    planned = {f"{record.name}.h5" for test in campaign.tests for record in test.records}
    strangers = sorted(path.name for path in folder.glob("*.h5") if path.name not in planned)
    if strangers:
        raise RunError(
            f"Folder {folder} must contain no other data, but contains {strangers[0]}.",
            why=f"The patterns in the campaign file would include {strangers[0]} as a repeat.",
            remedy="Choose an empty folder.",
        )


def _write_text(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def _campaign_text(campaign: RigCampaign) -> str:
    blocks = [f"{messages.HEAD}\n[campaign]\nname = {toml(campaign.name)}\n"]
    if stated := dict(campaign.assembly):
        blocks.append(_table("[assembly]", stated))
    if campaign.laws != DEFAULT_LAWS:
        blocks.append(_table("[joint]", {"laws": campaign.laws}))
    if campaign.structure is not None:
        blocks.append(_table("[structure]", dict(campaign.structure)))
    blocks += [_test_text(test) for test in campaign.tests]
    if stated := dict(campaign.settings):
        prior = stated.pop("prior", None)
        blocks.append(_table(f"{messages.IDENTIFY}\n[identify]", stated))
        if prior is not None:
            blocks.append(_table(f"{messages.PRIOR}\n[identify.prior]", prior))
    return "\n".join(blocks)


def _table(head: str, table: Mapping[str, Any]) -> str:
    """Return the text of a TOML table without keys whose value is None."""
    stated = [f"{key} = {toml(value)}" for key, value in table.items() if value is not None]
    return "\n".join([head, *stated]) + "\n"


def _test_text(test: Test) -> str:
    record, purpose = test.records[0], messages.PURPOSE.get(test.name.split("_")[0])
    table = {
        "name": test.name,
        "kind": test.kind,
        "files": f"{test.name}_*.h5",
        "level": test.level,
        "fs": record.fs if np.isfinite(record.fs) else None,
        "tones": test.tones_hz or None,
        "band": test.band_hz,
        "dwell": test.dwell if np.isfinite(test.dwell) else None,
        "settle": test.settle or None,
        "delay": test.delay or None,
        "periods": test.periods if test.periods > 1 else None,
        "run": test.run or None,
        "drive": test.drive or None,
        "locked_phase": test.locked_phase if test.locked_phase != -90.0 else None,
        "amplitude_std": test.amplitude_std or None,
        "channels": {role: role for role in record.channels},
        "units": {role: record.units[role] for role in record.channels},
    }
    return _table(f"# {purpose}\n[[test]]" if purpose else "[[test]]", table)

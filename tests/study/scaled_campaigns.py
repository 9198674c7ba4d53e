"""A short campaign of the rig and its images: the same motion in other units, turned or reordered.

Where time is stretched by c, lengths by s and masses by m, a quantity in kg^a m^b s^d is multiplied
by m^a s^b c^d; volts are not. Nothing that jbw says may depend on it but by this factor.
"""

import json
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from jbw.campaign.document import toml
from jbw.campaign.settings import Identify
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.oscillator import as_oscillator
from jbw.quantities import BY_NAME
from jbw.rig import measure
from jbw.rig.generator import Noise, Sweep
from jbw.rig.prescribed_motion import Growth, Held
from jbw.rig.presets import BURST_HZ, MODAL_MASS, RESONANCE_HZ, TRUTH, Plan, Preset
from jbw.units import powers_of

FS = 256.0
SWEEPS = tuple(
    Plan(name, "sweep", Sweep(10.0, 30.0, level, burst=4.0, fade=0.2, duration=6.0), 2)
    for name, level in (("sweep_weak", 1.5), ("sweep_strong", 6.0))
)
BURST = Sweep(BURST_HZ, BURST_HZ, 1.0, burst=3.0, fade=0.1, duration=8.0, settle=3.0)
DECAY = Plan("ringing", "decay", BURST, 2, band_hz=(15.0, 22.0))
CURVE = Plan("held_curve", "frf", Held(RESONANCE_HZ, 1e-3, dwell=4.0), 2)
PULL = Plan("pulled", "loop", Growth(1.0, 4e-3, duration=4.0), 2)
# Both edges of its band are lines of its records.
NOISE = Plan("random", "noise", Noise(0.15, 96.0, settle=8.0), 2, band_hz=(17.0, 20.5))
PLANS = (*SWEEPS, DECAY, CURVE, PULL, NOISE)
RIG = Preset("short", 1.0 / MODAL_MASS, 32.0, 2.0, PLANS, "force", 50e-6)
UNIT_OF_PARAMETER = {one.name: one.unit for one in quantities_of(laws_named(("bouc_wen", "cubic")))}
UNIT_OF_PARAMETER |= {"omega_n": "rad/s", "zeta": "1", "gain": "1/kg"}
AT_TRUTH = {
    name: float(value)
    for name, value in {**as_oscillator(TRUTH).parameters(), "gain": 1.0 / MODAL_MASS}.items()
}


@dataclass(frozen=True)
class Scale:
    """Factors of an image: of time, length and mass, and the sign of motion and force."""

    time: float = 1.0
    length: float = 1.0
    mass: float = 1.0
    sign: float = 1.0

    @property
    def is_exact(self):
        """Whether all factors are powers of two, by which no number is rounded."""
        return all(np.log2(x) % 1 == 0 for x in (self.time, self.length, self.mass))

    def of(self, unit):
        """What a number in this unit is multiplied by."""
        base = {"s": self.time, "m": self.length, "kg": self.mass, "V": 1.0, "A": 1.0, "rad": 1.0}
        base |= {"Hz": 1 / self.time, "N": self.mass * self.length / self.time**2}
        return float(np.prod([base[name] ** power for name, power in powers_of(unit).items()]))

    def parameters(self, theta):
        """The image of a point of the parameters."""
        return {name: value * self.of(UNIT_OF_PARAMETER[name]) for name, value in theta.items()}


@cache
def measured(*names, seed=0):
    """The campaign itself, or some of its tests, in newtons and without stated priors."""
    found = measure(RIG, seed=seed, fs=FS, tests=names or None)
    return replace(found, settings=Identify())


def record_in(record, scale):
    """The image of a record; a phase is that of the response to the force, and stays."""
    turned = {"frequency": 1.0, "phase": 1.0}
    if "phase" in record.channels:  # magnitudes
        turned |= dict.fromkeys(record.channels, 1.0)
    channels = {
        role: x * scale.of(record.units[role]) * turned.get(role, scale.sign)
        for role, x in record.channels.items()
    }
    return replace(record, fs=record.fs / scale.time, channels=channels)


def test_in(test, scale):
    """The image of a test."""
    unit = _level_unit(test)
    return replace(
        test,
        records=tuple(record_in(record, scale) for record in test.records),
        level=test.level * scale.of(unit),
        tones_hz=tuple(tone / scale.time for tone in test.tones_hz),
        band_hz=test.band_hz and tuple(edge / scale.time for edge in test.band_hz),
        dwell=test.dwell * scale.time,
        settle=test.settle * scale.time,
        delay=test.delay * scale.time,
    )


def _level_unit(test):
    """Of a plan's excitation: that of its source, of a displacement along prescribed motions."""
    return "m" if test.kind in ("loop", "frf") else "N"


def campaign_in(campaign, scale):
    """The image of a campaign, its prior too."""
    units = {one.name: one.unit for one in quantities_of(laws_named(campaign.laws))}
    stated = dict(campaign.settings)
    if "prior" in stated:
        units |= {name: BY_NAME[name].unit for name in stated["prior"] if name in BY_NAME}
        stated["prior"] = {
            name: tuple(bound * scale.of(units[name]) for bound in bounds)
            for name, bounds in stated["prior"].items()
        }
    if stated.get("fit_levels"):
        stated["fit_levels"] = [level * scale.of("N") for level in stated["fit_levels"]]
    mass = campaign.modal_mass and campaign.modal_mass * scale.mass
    tests = tuple(test_in(test, scale) for test in campaign.tests)
    return replace(campaign, tests=tests, settings=Identify.of(stated), modal_mass=mass)


def reordered(campaign):
    """Its tests and the repeats of each in the opposite order."""
    tests = [replace(test, records=test.records[::-1]) for test in campaign.tests[::-1]]
    return replace(campaign, tests=tuple(tests))


NAMES = {
    name: f'Prüfung {i} <{name[::-1]}> "a/b"' for i, name in enumerate(plan.name for plan in PLANS)
}


def renamed(campaign):
    """Its tests under names with slashes, brackets, quotes, umlauts and spaces."""
    tests = tuple(
        replace(
            test,
            name=NAMES[test.name],
            records=tuple(replace(one, name=NAMES[test.name]) for one in test.records),
        )
        for test in campaign.tests
    )
    return replace(campaign, tests=tests)


def with_names_back(answer):
    """An answer to the renamed campaign, as JSON reads it, with the names of the campaign."""
    text = json.dumps(answer, ensure_ascii=False).replace("\u2215", "/")  # of a stored group
    for name, other in NAMES.items():
        text = text.replace(json.dumps(other, ensure_ascii=False)[1:-1], name)
    return json.loads(text)


def write_campaign(campaign, folder):
    """Its files at full precision, and the campaign file, whose path is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["[campaign]", f"name = {toml(campaign.name)}"]
    if campaign.modal_mass is not None:
        lines.append(f"modal_mass = {toml(campaign.modal_mass)}")
    for number, test in enumerate(campaign.tests):
        record = test.records[0]
        for i, each in enumerate(test.records):
            write_hdf5(folder / f"t{number}_{i}.h5", Record(each.fs, each.channels, each.units))
        stated = {
            "name": test.name,
            "kind": test.kind,
            "files": [f"t{number}_{i}.h5" for i in range(len(test.records))],
            "level": test.level,
            "fs": record.fs if np.isfinite(record.fs) else None,
            "band": test.band_hz,
            "settle": test.settle or None,
            "channels": {role: role for role in record.channels},
            "units": dict(record.units),
        }
        said = (f"{key} = {toml(value)}" for key, value in stated.items() if value is not None)
        lines += ["", "[[test]]", *said]
    settings = dict(campaign.settings)
    lines += ["", "[identify]"]
    lines += [f"{key} = {toml(value)}" for key, value in settings.items() if value is not None]
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path

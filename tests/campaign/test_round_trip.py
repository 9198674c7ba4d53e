"""A campaign of every kind of test, made by the rig, through every format and back.

Each channel comes back to the precision of its format, and the same evidence is made from it.
"""

import json
import warnings
from dataclasses import replace

import jax
import numpy as np
import pytest

from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.measurement.files.sep005 import from_sep005, to_sep005
from jbw.measurement.kinds import KINDS
from jbw.observables.dataset import log_likelihood, unnamed
from jbw.rig import MIXED, Plan, measure, write
from jbw.rig.generator import Multisine, Noise, Steps, Sweep, Tone
from jbw.rig.prescribed_motion import Growth, Held, Locked, s_curve
from tests.campaign.written_formats import FORMATS, FULL_SCALE

pytestmark = pytest.mark.slow  # records of every kind are simulated and written eight times

PLANS = (
    Plan("noise", "noise", Noise(0.15, 32.0, 8.0), 2, band_hz=(17.0, 20.5)),
    Plan("multisine", "multisine", Multisine(0.5, 2.0, 16.0, 21.0, periods=2, settle=24.0), 1),
    Plan("tone", "tones", Tone(6.0, 12.0, duration=2.0, settle=16.0), 2),
    Plan("stepped", "stepped", Steps((18.0, 18.5, 19.0), 0.3, dwell=16.0), 1, settle=12.0),
    Plan("sweep", "sweep", Sweep(12.0, 28.0, 3.0, burst=2.0, fade=0.2, duration=3.0), 2),
    Plan("decay", "decay", Sweep(18.6, 18.6, 1.0, 2.0, 0.1, 5.0, settle=2.0), 1,
         band_hz=(15.0, 22.0)),
    Plan("pull", "loop", Growth(1.0, 4e-3, duration=2.0), 2),
    Plan("curve", "frf", Held((18.0, 18.5, 18.75, 19.0, 19.5), 1e-3, dwell=4.0), 2),
    Plan("backbone", "backbone", Locked((5e-4, 1e-3, 2e-3, 4e-3)), 2),
    Plan("s_curve", "curve", s_curve(18.5, (5e-4, 1e-3, 2e-3, 4e-3)), 2),
)  # fmt: skip
FIELDS = ("name", "kind", "level", "tones_hz", "band_hz", "settle", "periods", "run")
QUIETLY = pytest.mark.filterwarnings("ignore")  # of short records; that they come back is asked


@pytest.fixture(scope="module")
def campaign():
    return measure(replace(MIXED, name="every kind", plans=PLANS), seed=5)


@pytest.fixture(scope="module")
def score(campaign):
    """Terms of the log likelihood at the truth; compiled once for all formats."""
    truth = {**campaign.truth["joint"], "gain": campaign.truth["gain"]}
    compiled = jax.jit(log_likelihood)

    def of(tests):
        settings = Identify(substeps=1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            data = assemble(measured(tests, settings))
        return data.labels, np.asarray(compiled(truth, unnamed(data)))

    return of


@pytest.fixture(scope="module")
def expected(campaign, score):
    return score(campaign.tests)


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)


def table_of(test, form):
    """The [[test]] table that says what a test is and where its channels lie."""
    record = test.records[0]
    table = {
        "name": test.name,
        "kind": test.kind,
        "files": [f"{record.name}{form.suffix}" for record in test.records],
        "level": test.level,
        "channels": form.channels(record),
        "units": dict(record.units),
    }
    optional = {
        "fs": record.fs if np.isfinite(record.fs) else None,
        "tones": list(test.tones_hz),
        "band": list(test.band_hz or ()),
        "dwell": test.dwell if np.isfinite(test.dwell) else None,
        "settle": test.settle,
        "periods": test.periods if test.periods > 1 else None,
        "scale": {role: FULL_SCALE[role] for role in record.channels}
        if form.suffix == ".wav"
        else None,
    }
    table |= {key: value for key, value in optional.items() if value}
    return "[[test]]\n" + "\n".join(f"{key} = {toml(value)}" for key, value in table.items())


def written(campaign, form, folder):
    """The campaign in files of one format, and its campaign file; curves as npz where it must."""
    blocks = []
    for test in campaign.tests:
        chosen = form if form.curves or not test.traits.is_curve else FORMATS["npz"]
        for record in test.records:
            chosen.write(folder / f"{record.name}{chosen.suffix}", record)
        blocks.append(table_of(test, chosen))
    (folder / "campaign.toml").write_text("\n\n".join(blocks) + "\n")
    return folder / "campaign.toml"


def assert_same(found, expected, rtol):
    for test, same in zip(found, expected, strict=True):
        assert [getattr(test, f) for f in FIELDS] == [getattr(same, f) for f in FIELDS]
        assert test.dwell == same.dwell or np.isnan([test.dwell, same.dwell]).all()
        for record, other in zip(test.records, same.records, strict=True):
            assert record.fs == other.fs or np.isnan([record.fs, other.fs]).all()
            assert record.units == other.units
            assert record.channels.keys() == other.channels.keys()
            for role, samples in other.channels.items():
                np.testing.assert_allclose(record.channels[role], samples, rtol=rtol)


def test_the_campaign_has_every_kind(campaign, expected):
    assert {test.kind for test in campaign.tests} == set(KINDS)
    names, terms = expected
    # Two orders of the tone and of the steps, frequency and force of the backbone, phase and force
    # of the S-curve, and the scatter of the decays' frequencies.
    assert len(names) == 14
    assert len(terms) == 15
    assert np.isfinite(terms).all()


@QUIETLY
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_campaign_back(name, campaign, score, expected, tmp_path):
    form = FORMATS[name]
    if name in ("uff", "tdms"):
        pytest.importorskip({"uff": "pyuff", "tdms": "nptdms"}[name])
    loaded = load_campaign(written(campaign, form, tmp_path))
    assert_same(loaded.tests, campaign.tests, form.rtol)
    names, terms = score(loaded.tests)
    assert names == expected[0]
    # Nine digits of a tone leave its third harmonic, and so that term, six.
    np.testing.assert_allclose(terms, expected[1], rtol=5e-6 if form.rtol else 1e-12)


@QUIETLY
def test_the_rigs_own_files_give_it_back(campaign, score, expected, tmp_path):
    loaded = load_campaign(write(campaign, tmp_path))
    assert_same(loaded.tests, campaign.tests, 0.0)
    names, terms = score(loaded.tests)
    assert names == expected[0]
    np.testing.assert_array_equal(terms, expected[1])


@QUIETLY
def test_dictionaries_of_series_give_it_back(campaign, score, expected):
    """SEP-005 holds series in time; a response curve has none and stays what it is."""
    timed = [test for test in campaign.tests if not test.traits.is_curve]
    there_and_back = {
        test.name: tuple(
            from_sep005(to_sep005(record), name=record.name) for record in test.records
        )
        for test in timed
    }
    tests = [replace(t, records=there_and_back.get(t.name, t.records)) for t in campaign.tests]
    assert_same(tests, campaign.tests, 0.0)
    np.testing.assert_array_equal(score(tests)[1], expected[1])

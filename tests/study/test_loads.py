"""A run's draws under other loads: the golden joints as posteriors, closed forms, refusals."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made_runs import GAIN, JOINT, OMEGA_N, SILENT, ZETA, Z, a_test, a_tree, same, spread
from scipy.stats import norm

import jbw
import jbw.study.study as module
from jbw.errors import ConfigError, DataError, ModelError
from jbw.forced.equivalent import equivalent_motion
from jbw.forced.profiles import profile_of
from jbw.identification.discrepancy import NO_SCATTER, Discrepancy, Missed, Scatter
from jbw.study.loads import LOAD_DRAWS, Load, Member, SeenResponse, bands, response_of
from jbw.study.loads_in_time import _random
from jbw.study.loads_of_sines import _isolated
from jbw.study.study import Study

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_forced.json").read_text())
GOLDEN_JOINT = GOLDEN["parameters"]["bouc_wen"]
TAU = 2 * np.pi


def study_of(draws, **options):
    return Study(a_tree(draws, seen=[a_test(0.1)], **options), {})


@pytest.fixture(scope="module")
def golden_study():
    """The golden joint with gain 2, of which velocity was measured."""
    return study_of({**same(GOLDEN_JOINT), "gain": np.full(4, 2.0)})


def test_a_band_contains_a_further_draw_with_99_percent():
    """By the share of a normal distribution between the ends, over 5,000 sets of draws.

    That share has a standard deviation of 0.007 for 200 draws, and its mean one of 1e-4.
    """
    drawn = np.random.default_rng(0).standard_normal((LOAD_DRAWS, 5000))
    low, _, high = bands([drawn])
    assert np.mean(norm.cdf(high) - norm.cdf(low)) == pytest.approx(0.99, abs=4e-4)


def test_the_resonance_is_the_golden_one_in_what_was_measured(golden_study):
    golden = GOLDEN["sine"]["bouc_wen_folded"]
    found = golden_study.resonance([golden["level"] / 2], draws=4)
    assert found["frequency"].values[:, 0] == pytest.approx(golden["peak"]["hz"], rel=1e-5)
    velocity = TAU * golden["peak"]["hz"] * golden["peak"]["Y1"]
    assert found["peak"].values[:, 0] == pytest.approx(velocity, rel=1e-3)
    assert found["peak"].attrs["units"] == "m/s"
    assert found["level"].attrs["units"] == "V"
    assert found["jump_up"].values[:, 0] == pytest.approx(golden["folds"][1]["hz"], rel=3e-6)
    assert found["jump_down"].values[:, 0] == pytest.approx(golden["folds"][0]["hz"], rel=3e-6)
    assert found["folds"].values == [1.0]
    assert np.all(np.isnan(found["quality"].values))


def test_a_gaussian_gain_has_the_band_of_its_closed_form():
    found = study_of(spread()).resonance([0.1], draws=400)
    low, middle, high = found["peak"].values[:, 0]
    peak = GAIN * 0.1 / (2 * ZETA * OMEGA_N)  # of a velocity
    assert middle == pytest.approx(peak, rel=1e-4)
    # Quantiles of 400 draws at the tail: off by a tenth of the spacing of the last two.
    assert (high - low) / 2 == pytest.approx(Z * 0.01 * peak, rel=0.05)
    assert found.attrs["band"]


def test_levels_are_forces_where_a_modal_mass_is_stated():
    """Of free decays alone: half the motion of a force of the same number per kilogram."""
    joint = {name: np.full(4, value) for name, value in GOLDEN_JOINT.items()}
    peaks = {}
    for gain in (1.0, 0.5):
        study = Study(a_tree(joint, held={"gain": gain}), {})
        found = study.resonance([0.01], draws=4)
        peaks[found["level"].attrs["units"]] = float(found["peak"].sel(quantile=0.5).values[0])
    per_kilogram = Study(a_tree(joint, held={"gain": 1.0}), {}).resonance([0.005], draws=4)
    assert peaks["N"] == pytest.approx(float(per_kilogram["peak"].sel(quantile=0.5).values[0]))
    assert peaks["N"] < peaks["N/kg"]


def test_the_participation_is_that_which_a_run_on_a_base_identified(golden_study):
    on_base = a_test(0.1)
    on_base = replace(on_base, drive="base")
    draws = {**same(GOLDEN_JOINT), "gain": np.full(4, 1.4)}
    study = Study(a_tree(draws, seen=[on_base]), {})
    found = study.resonance([0.1], draws=4, drive="base")
    assert found.attrs["participation"] == pytest.approx(1.4)
    stated = study.resonance([0.1], draws=4, drive="base", participation=1.4)
    np.testing.assert_allclose(found["peak"].values, stated["peak"].values, rtol=1e-12)
    assert golden_study.resonance([0.1], draws=4, drive="base").attrs["participation"] == 1.0


def test_the_curve_has_what_sweeps_show(golden_study):
    level = GOLDEN["sine"]["bouc_wen_folded"]["level"] / 2
    found = golden_study.response_curve(level, (19.0, 20.5), draws=4)
    assert found["frequency"].dims == ("draw", "point")
    up, down = found["upward"].values[1], found["downward"].values[1]
    folds = GOLDEN["sine"]["bouc_wen_folded"]["folds"]
    freq_hz = found["freq"].values
    between = (freq_hz > folds[0]["hz"]) & (freq_hz < folds[1]["hz"])
    assert np.all(up[~between] == pytest.approx(down[~between], rel=1e-6))
    assert not np.all(found["stable"].values)
    near = np.argmin(np.abs(freq_hz - 19.4))
    joint = jbw.BoucWen(**GOLDEN_JOINT)
    motion = jbw.steady_state(joint, TAU * freq_hz[near], 2 * level)
    expected = TAU * freq_hz[near] * abs(motion[0])
    assert up[near] == pytest.approx(float(expected), rel=1e-4)


def test_a_moving_base_has_the_golden_acceleration(golden_study):
    golden = GOLDEN["sine"]["base_bouc_wen"]
    found = golden_study.resonance([golden["base_acceleration"]], drive="base", draws=4, unit="g")
    assert found["frequency"].values[1, 0] == pytest.approx(golden["hz"], rel=1e-5)
    gain = golden["transmissibility_first_harmonic"]
    largest = gain * golden["base_acceleration"] / 9.80665
    assert found["peak"].values[1, 0] == pytest.approx(largest, rel=1e-3)
    assert found["peak"].attrs["units"] == "g"
    assert found["level"].attrs["units"] == "m/s^2"


@pytest.mark.parametrize("participation", [1.0, -0.5])
def test_a_point_on_a_moving_base_moves_with_it_below_the_resonance(participation):
    """The closed transmissibility 1 + p s w^2 H, far from where its terms are in quadrature."""
    load, shape, level = Load(drive="base", participation=participation, shape=0.8), 0.8, 3.0
    omega = OMEGA_N * np.array([[0.5, 0.9, 1.5]])
    receptance = 1 / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    y = abs(participation) * level * receptance  # over the phase of the force |p| a_b
    seen = SeenResponse("acceleration", "mm/s^2", 1e3, "m/s^2")
    linear = equivalent_motion(jbw.Oscillator(OMEGA_N, ZETA))
    member = Member(linear, {}, np.array([[participation]]))
    found = response_of(member, load, seen, level, omega, y)
    expected = 1e3 * level * (1 + participation * shape * omega**2 * receptance)
    assert found == pytest.approx(expected, rel=1e-14)


def test_a_density_is_in_the_square_of_the_unit_of_its_response():
    """A density of one (m/s^2)^2/Hz over 4 Hz has an rms of 2 m/s^2, 2000 mm/s^2."""
    one = np.ones(1)
    freq_hz = np.linspace(10.0, 14.0, 5)
    unit = (TAU * freq_hz[None]) ** -2  # displacement per force of unit acceleration
    response = SimpleNamespace(
        transfer=lambda _: (unit, unit**2), largest=lambda _: 3 * one, frequency_hz=one, damping=one
    )
    seen = SeenResponse("acceleration", "mm/s^2", 1e3, "N")
    member = Member(equivalent_motion(jbw.Oscillator(OMEGA_N, ZETA)), {}, one[:, None])
    found = _random([(member, response)], Load(), seen, np.ones(5), freq_hz, 60.0)
    assert found["rms"] == pytest.approx(2000.0, rel=1e-14)
    assert found["psd"] == pytest.approx(1e6, rel=1e-14)


def test_a_limit_allows_the_level_whose_peak_it_is(golden_study):
    peak = GOLDEN["sine"]["bouc_wen_weak"]["peak"]
    level = GOLDEN["sine"]["bouc_wen_weak"]["level"] / 2
    limit = TAU * peak["hz"] * peak["Y1"]
    band = (peak["hz"] - 0.5, peak["hz"] + 0.5)
    found = golden_study.notch(10 * level, limit, band, draws=4)
    # The lowest allowed level is that of the resonance, between frequencies 0.004 Hz apart.
    assert found["allowed"].values[1].min() == pytest.approx(level, rel=5e-3)
    assert found["notched"].values.max() <= 10 * level
    golden = GOLDEN["sine"]["base_bouc_wen"]
    expected = golden["base_acceleration"]
    acceleration = golden["transmissibility_first_harmonic"] * expected
    base = golden_study.notch(1.0, acceleration, (19.8, 19.98), drive="base", draws=4)
    assert base["allowed"].values[1].min() == pytest.approx(expected, rel=5e-3)


def test_random_vibration_has_the_golden_rms(golden_study):
    golden = GOLDEN["random"]["bouc_wen_moderate"]
    rows = [(str(f), str(golden["psd"])) for f in golden["band_hz"]]
    found = golden_study.random(profile_of(rows, "(m/s^2)^2/Hz"), drive="base", draws=4)
    for name, key in (("rms", "rms_absolute_acceleration"), ("displacement", "rms_y")):
        mean, error = golden[key]
        assert found[name].values[1] == pytest.approx(mean, abs=max(3 * error, 3e-3 * mean))
    power = np.trapezoid(found["psd"].values[1], found["freq"].values)
    assert np.sqrt(power) == pytest.approx(found["rms"].values[1], rel=1e-6)
    assert 3.0 < found["peak_factor"].values[1] < 5.0


def test_a_shock_has_the_golden_maximum(golden_study):
    golden = GOLDEN["shock"]["bouc_wen_half_sine_11ms_20"]
    found = golden_study.shock("20 m/s^2, 11ms", drive="base", draws=4)
    largest = golden["absolute_acceleration_max"]
    assert found["largest"].values == pytest.approx(largest, rel=1e-5)
    assert found["displacement"].values == pytest.approx(golden["relative_y_max"], rel=1e-5)
    assert found["srs"].dims == ("quantile", "freq")


def test_the_joints_are_a_pytree(golden_study):
    joints = golden_study.joints(4)
    assert joints.omega_n.shape == (4,)
    assert float(joints.laws[0].alpha[0]) == GOLDEN_JOINT["alpha"]


def test_levels_beyond_the_fitted_are_said():
    """The response is ten times the displacement that was fitted."""
    level = 1e-3
    reached = study_of(same(GOLDEN_JOINT)).resonance([level], draws=4)["displacement"].values[1, 0]
    found = study_of(same(GOLDEN_JOINT), y_peak=reached / 10).resonance([level], draws=4)
    assert found["reach"].values[0] == pytest.approx(10.0)
    (sentence,) = jbw.warnings_of(found)
    assert "10 times" in sentence


def test_macroslip_that_no_fitted_test_reached_is_said():
    """The golden joint begins to slip as a whole at 1.14 mm, and the load moves it by 1.5 mm."""
    stated = GOLDEN["parameters"]["iwan4"]
    k_t, f_s, chi, beta = (stated[name] for name in ("k_t", "f_s", "chi", "beta"))
    largest = f_s * (1 + beta) / (k_t * (beta + (chi + 1) / (chi + 2)))  # Segalman (2005)
    lost = k_t * (1e-3 / largest) ** (1 + chi) / ((1 + beta) * (2 + chi))
    law = {"iwan_stiffness": k_t, "iwan_loss": lost, "iwan_chi": chi, "iwan_beta": beta}
    mode = {name: stated[name] for name in ("omega_n", "zeta")}
    tree = a_tree(same({**mode, **law}), seen=[a_test(0.1)], y_peak=1e-3)
    tree.attrs["laws"] = json.dumps(["iwan4"])
    sentences = jbw.warnings_of(Study(tree, {}).resonance([1.0 / GAIN], draws=4))
    assert any("macroslip" in sentence for sentence in sentences)


def test_a_branch_that_a_sweep_does_not_reach_is_said():
    seen = SeenResponse("velocity", "m/s", 1.0, "N")
    (sentence,) = _isolated([np.array([0.0, 1.0]), np.zeros(2)], 2.0, seen)
    assert "25 %" in sentence
    assert not _isolated([np.zeros(2)], 2.0, seen)


def test_a_band_that_cannot_be_stated_is_withheld(monkeypatch):
    """The fitted amplitudes are an octave apart, and the response is far above them."""
    missed = Missed(Scatter(1e-3, 0, 1e-3), NO_SCATTER)
    stated = Discrepancy(missed, missed, {}, 1e-6, 2e-6)
    plain = module.basis_of
    monkeypatch.setattr(module, "basis_of", lambda tree: replace(plain(tree), discrepancy=stated))
    found = study_of(same(GOLDEN_JOINT)).resonance([1e-3], draws=4)
    assert found["withheld"].values == [1.0]
    assert np.isnan(found["peak"].values[[0, 2], 0]).all()
    assert found["peak"].values[1, 0] > 0
    assert len(jbw.warnings_of(found)) == 1


def test_a_model_discrepancy_widens_the_band(monkeypatch):
    """A discrepancy of 1e-3 in frequency is a standard deviation of that of the peak."""
    missed = Missed(Scatter(1e-3), NO_SCATTER)
    stated = Discrepancy(missed, missed, {}, 1e-6, 1.0)
    plain = module.basis_of
    monkeypatch.setattr(module, "basis_of", lambda tree: replace(plain(tree), discrepancy=stated))
    found = study_of(same(SILENT, 400)).resonance([0.01], draws=400)
    low, middle, high = found["frequency"].values[:, 0]
    # Quantiles of 400 normal numbers at the tail.
    assert (high - low) / (2 * Z * middle) == pytest.approx(1e-3, rel=0.25)


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda s: s.resonance([-1.0]), ConfigError, "positive"),
        (lambda s: s.resonance([]), ConfigError, "positive"),
        (lambda s: s.response_curve(0.1, (20.0, 17.0)), ConfigError, "band"),
        (lambda s: s.resonance([0.1], draws=1), ConfigError, "draws"),
        (lambda s: s.resonance([0.1], drive="base", participation=0.0), ConfigError, "particip"),
        (lambda s: s.resonance([0.1], unit="kg"), ConfigError, "kg"),
        (lambda s: s.shock("20g,11ms"), ConfigError, "m/s"),
        (
            lambda s: s.random(profile_of([("1", "1"), ("5", "1")], "V^2/Hz")),
            ModelError, "power",
        ),
        (
            lambda s: s.random(profile_of([("5", "1"), ("80", "1")], "g^2/Hz")),
            ConfigError, r"\(V\)\^2/Hz",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused(golden_study, call, error, match):
    with pytest.raises(error, match=match):
        call(golden_study)


def test_decays_determine_no_gain():
    draws = {name: values for name, values in same(JOINT).items() if name != "gain"}
    with pytest.raises(DataError, match="gain"):
        study_of(draws).resonance([0.1], draws=4)


def test_a_further_mode_needs_its_gain():
    draws = {**same(JOINT), "omega_2": np.full(4, 200.0), "zeta_2": np.full(4, 0.01)}
    with pytest.raises(DataError, match="gain_ratio_2"):
        study_of(draws).resonance([0.1], draws=4)


def test_modes_outside_the_band_add_to_the_response():
    """A static term U of the modes above adds gain * level * U to the displacement."""
    upper = 3e-5
    plain = study_of(same(SILENT)).response_curve(0.1, (10.0, 17.0), draws=4)
    found = study_of({**same(SILENT), "residual_upper": np.full(4, upper)})
    found = found.response_curve(0.1, (10.0, 17.0), draws=4)
    omega = TAU * found["freq"].values
    receptance = 1 / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    expected = omega * GAIN * 0.1 * np.abs(receptance + upper)
    assert found["upward"].values[1] == pytest.approx(expected, rel=1e-5)
    assert np.all(found["upward"].values[1] > 1.05 * plain["upward"].values[1])


def test_a_turned_gain_turns_the_response_alone():
    draws = {**same(GOLDEN_JOINT), "gain": np.full(4, -2.0)}
    level = GOLDEN["sine"]["bouc_wen_weak"]["level"] / 2
    found = study_of(draws).resonance([level], draws=4)
    golden = GOLDEN["sine"]["bouc_wen_weak"]["peak"]
    assert found["frequency"].values[1, 0] == pytest.approx(golden["hz"], rel=1e-5)
    assert found["peak"].values[1, 0] == pytest.approx(TAU * golden["hz"] * golden["Y1"], rel=1e-3)


def test_several_laws_predict_each_by_its_share(monkeypatch):
    """Half of the draws are of a joint with a natural frequency 1 % higher."""
    plain = module.basis_of

    def of_both(tree):
        basis = plain(tree)
        higher = basis.posterior.assign(omega_n=1.01 * basis.posterior["omega_n"])
        return replace(basis, beside=((0.5, replace(basis, posterior=higher)),))

    monkeypatch.setattr(module, "basis_of", of_both)
    found = study_of(same(SILENT, 40)).resonance([0.01], draws=40)
    low, _, high = found["frequency"].values[:, 0]
    peak = OMEGA_N * np.sqrt(1 - 2 * ZETA**2) / TAU
    assert (low, high) == pytest.approx((peak, 1.01 * peak), rel=1e-5)
    with pytest.raises(ConfigError, match="several laws"):
        study_of(same(SILENT, 40)).joints(4)


def test_a_response_is_in_the_unit_of_its_records():
    test = a_test(0.1)
    (record,) = test.records
    stated = replace(record, provenance={"unit of velocity": "mm/s"})
    tree = a_tree(same(SILENT), seen=[replace(test, records=(stated,))])
    found = Study(tree, {}).resonance([0.01], draws=4)
    assert found["peak"].attrs["units"] == "mm/s"
    peak = 1e3 * GAIN * 0.01 / (2 * ZETA * OMEGA_N)
    assert found["peak"].values[1, 0] == pytest.approx(peak, rel=1e-4)


@pytest.mark.slow
def test_a_strong_third_harmonic_takes_eight():
    spring = {**same(SILENT), "cubic": np.full(4, 4e9)}
    tree = a_tree(spring, seen=[a_test(0.1)])
    tree.attrs["laws"] = json.dumps(["bouc_wen", "cubic"])
    study = Study(tree, {})
    weak, strong = (study.response_curve(level, (15, 25), draws=4) for level in (1e-4, 0.3))
    assert (weak.attrs["harmonics"], strong.attrs["harmonics"]) == (1, 8)


def test_the_spectrum_of_a_response_has_built_up_at_the_mode():
    """The response itself, as long as it rings, has the same largest value at the mode."""
    study = study_of(same(SILENT))
    study.tree.attrs["tests"] = json.dumps(
        {"fitted": {"kind": "sweep", "source": "m/s^2", "response": "acceleration"}}
    )
    found = study.shock("1 m/s^2,11ms", drive="base", draws=4)
    joint = jbw.forced.equivalent_motion(jbw.BoucWen(**SILENT))
    pulse = jbw.forced.classical_pulse(1.0, 0.011, "m/s^2")
    t = np.arange(int(100 * TAU / OMEGA_N * pulse.fs)) / pulse.fs
    source = np.interp(t, np.arange(len(pulse.samples)) / pulse.fs, pulse.samples, right=0.0)
    motion = jbw.simulate(joint.joint, -source[None], pulse.fs)
    absolute = np.asarray(motion.a)[0] + source
    expected = jbw.shock_spectrum(absolute, pulse.fs, found["freq"].values)
    # What the oscillator gains after 24 cycles.
    assert found["srs"].values[1] == pytest.approx(expected, rel=2e-3)

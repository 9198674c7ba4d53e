"""Steady verification against answers in closed form, and the two routes side by side."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from decays import OMEGA_N as DECAY_OMEGA_N
from decays import decay_test
from made_runs import a_tree

from jbw.identification.joint import draw_noise_std
from jbw.identification.paper.routes import compare_routes
from jbw.identification.paper_route import PaperRoute
from jbw.identification.procedure import Posteriors
from jbw.measurement.records import Record, Test
from jbw.observables import harmonic_groups as steady
from jbw.observables.dataset import Dataset
from jbw.observables.loops import Loops
from jbw.observables.residual_terms import has_own
from jbw.observables.steady import Points
from jbw.verification import groups
from jbw.verification.backbone import amplitude_verification
from jbw.verification.bands import errors
from jbw.verification.curves import curves_of, predict_curves
from jbw.verification.in_time import completed, reduced
from jbw.verification.predicted import NOT_KNOWN, Predicted, Source
from jbw.verification.predictive_basis import basis_of, scattered
from jbw.verification.reference_oscillators import of_run, references
from jbw.verification.steady_motion import predict_loop, predict_periods
from jbw.verification.verify import place

OMEGA_N, ZETA, GAIN = 120.0, 0.01, 0.5
SILENT = {"alpha": 1e-6, "delta": 1.0, "gamma": 1.0}  # a joint that hardly carries
LINEAR = {"omega_n": OMEGA_N, "zeta": ZETA, "gain": GAIN, **SILENT}
ALONE = {"omega_n": OMEGA_N, "zeta": ZETA, "gain": GAIN}, ()  # the same without a law
# The truth three times: bands of no width.
DRAWS = {name: np.full(3, value) for name, value in LINEAR.items()}


def source(draws, **references):
    """Draws to carry that come from a run which knows no noise."""
    return Source(basis_of(a_tree(draws, substeps=2)), draws, references)


def receptance(omega):
    return GAIN / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)


def held_curve(level, cubic=0.0):
    """An oscillator whose acceleration a controller holds: force over frequency."""
    freq = np.linspace(17.0, 21.0, 41)
    omega = 2 * np.pi * freq
    added = 0.75 * cubic * (level / omega**2) ** 2  # stiffness by one harmonic of the cubic force
    h = -(omega**2) / (1 / receptance(omega) + added / GAIN)
    channels = {
        "frequency": freq,
        "force": level / np.abs(h),
        "acceleration": np.full(41, level),
        "phase": np.angle(h),
    }
    units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
    return Test("frf", (Record(np.nan, channels, units),), f"held at {level:g} m/s^2", level=level)


def test_a_made_up_curve_is_met_at_its_truth():
    tests = [held_curve(level) for level in (1.0, 2.0)]
    compared = predict_curves(source(DRAWS, linear=ALONE), list(curves_of(tests).values()))
    for level, (found, peak, noise, _) in zip((1.0, 2.0), compared, strict=True):
        assert noise.std is None
        np.testing.assert_allclose(peak, level / (2 * np.pi * 17.0) ** 2)
        # The joint carries 1e-6 N/kg at most, of a force of 0.04 N/kg at the resonance.
        assert found.attrs["nrmse"] < 1e-4
        assert found.attrs["nrmse_linear"] < 1e-4
        assert "coverage" not in found.attrs  # one repeat tells no noise
        assert (found.attrs["quantity"], found.attrs["held"]) == ("force", "acceleration")
        omega = 2 * np.pi * found["freq"].values
        force = level / omega**2 / np.abs(receptance(omega))
        np.testing.assert_allclose(found["measured_magnitude"], force, rtol=1e-12)
        # The force leads the displacement by the angle of the dynamic stiffness: 0 to 180 degrees.
        lead = np.angle(1 / receptance(omega))
        np.testing.assert_allclose(found["measured_phase"], lead, atol=1e-12)
        np.testing.assert_allclose(found["model_phase"][1], lead, atol=1e-3)


def test_the_linear_reference_finds_a_linear_oscillator():
    groups = [steady.curve_group(held_curve(level)) for level in (1.0, 2.0)]
    data = Dataset.of([Points.of(groups)])
    known = {**LINEAR, "omega_n": 1.01 * OMEGA_N, "zeta": 2 * ZETA, "gain": 0.8 * GAIN}
    found, laws, _ = references(data, known)["linear"]
    assert laws == ()
    for name, truth in (("omega_n", OMEGA_N), ("zeta", ZETA), ("gain", GAIN)):
        assert found[name] == pytest.approx(truth, rel=1e-3)


def test_the_linear_reference_of_a_turned_channel_has_a_gain_below_zero():
    held = held_curve(1.0).records[0]
    phase = held.channels["phase"] + np.pi
    turned = Record(np.nan, {**held.channels, "phase": phase}, held.units)
    groups = [steady.curve_group(Test("frf", (turned,), "turned", level=1.0))]
    data, known = Dataset.of([Points.of(groups)]), {**LINEAR, "gain": -0.8 * GAIN}
    found = references(data, known)["linear"].parameters
    assert found["gain"] == pytest.approx(-GAIN, rel=1e-3)


def driven_curve(**ratio):
    """The same oscillator under a constant force."""
    freq = np.linspace(17.0, 21.0, 41)
    h = -((2 * np.pi * freq) ** 2) * receptance(2 * np.pi * freq)
    channels = {"frequency": freq, "force": np.ones(41), "acceleration": np.abs(h)}
    channels["phase"] = np.angle(h)
    units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
    record = Record(np.nan, channels, units, provenance=ratio)
    return Test("frf", (record,), "driven", level=1.0)


def test_every_group_of_steady_motion_has_the_unit_of_its_values():
    held, driven = steady.curve_group(held_curve(1.0)), steady.curve_group(driven_curve())
    ratio = steady.curve_group(driven_curve(ratio="response per N of force"))
    assert [one.unit for one in (held, driven, ratio)] == ["N", "m/s^2", "m/s^2/N"]
    assert Points.of([driven, driven]).groups.unit == "m/s^2"
    both = Points.of([held, driven])
    assert (both.groups.unit, both.groups.units) == ("", ("N", "m/s^2"))
    terms = np.zeros((1, 3, 2))
    draws = {name: np.full((1, 3), value) for name, value in LINEAR.items()}
    found = draw_noise_std(jax.random.key(0), draws, terms, Dataset.of([both]))
    attrs = found["noise_std_harmonics"][-1]
    assert "units" not in attrs
    assert attrs["group_units"] == ["N", "m/s^2"]


def test_the_cubic_reference_finds_a_cubic_oscillator():
    # 0.75 cubic y^2 is up to 17 % of omega_n^2 here; the third harmonic changes that by 1e-3 of it.
    groups = [steady.curve_group(held_curve(level, 1e11)) for level in (1.0, 2.0)]
    data = Dataset.of([Points.of(groups)])
    found = references(data, LINEAR, ("linear", "cubic"))
    assert found["cubic"].laws == ("cubic",)
    assert found["cubic"].parameters["cubic"] == pytest.approx(1e11, rel=0.01)
    assert found["cubic"].parameters["omega_n"] == pytest.approx(OMEGA_N, rel=1e-3)


def test_the_cubic_reference_of_runs_with_offsets_contains_the_linear_one():
    """Each level has a natural frequency of its own, up to seven half widths apart."""
    curves = [held_curve(level) for level in (1.0, 2.0, 3.0)]
    moved = [1.0, 1.01, 0.98]
    for curve, ratio in zip(curves, moved, strict=True):
        curve.records[0].channels["frequency"] *= ratio
    data = Dataset.of([Points.of([steady.curve_group(curve) for curve in curves])])
    scatter = np.array([0.02 * OMEGA_N, 1e-9])
    data = replace(data, scatters=jnp.asarray(scatter[None]), scatter=jnp.asarray(scatter))
    found = references(data, LINEAR, ("linear", "cubic"))
    for reference in found.values():
        shifts = [b[0] for b in reference.runs.values()]
        own = reference.parameters["omega_n"] + np.array(shifts)
        # A frequency axis that is stretched is a natural frequency that is: force over
        # acceleration stays as it was.
        np.testing.assert_allclose(own, OMEGA_N * np.array(moved), rtol=1e-3)
        assert reference.parameters["gain"] == pytest.approx(GAIN, rel=0.01)


def pushed():
    r"""A joint pushed once from rest: z = alpha / s (1 - exp(-s y)), s = gamma + delta."""
    y = np.linspace(0.0, 0.01, 801)
    z = 4000.0 / 400.0 * (1 - np.exp(-400.0 * y))
    force = ((OMEGA_N**2 - 4000.0) * y + z) / GAIN
    channels = {"displacement": y, "restoring_force": force}
    units = {"displacement": "m", "restoring_force": "N"}
    return Test("loop", (Record(100.0, channels, units),), "pushed", level=0.01)


def test_a_push_is_met_at_its_truth_and_costs_its_work():
    truth = {**LINEAR, "alpha": 4000.0, "delta": 300.0, "gamma": 100.0}
    draws = {name: np.full(3, value) for name, value in truth.items()}
    springs = references(Dataset.of(Loops.reduce([pushed()])), truth, ("linear", "cubic"))
    found = predict_loop(source(draws, **of_run(springs, None)), pushed()).dataset
    assert found.attrs["nrmse"] < 1e-12
    y, s = 0.01, 400.0
    work = (OMEGA_N**2 - 4000.0) * y**2 / 2 + 4000.0 / s * (y - (1 - np.exp(-s * y)) / s)
    # Trapezia of 801 points: (s h)^2 / 12 = 2e-6 of the curved part.
    np.testing.assert_allclose(found["model_work"], work / GAIN, rtol=2e-6)
    channels = pushed().records[0].channels
    y, force = channels["displacement"], channels["restoring_force"]
    slope = (force @ y) / (y @ y)  # least squares of a spring by hand
    left = np.linalg.norm(force - slope * y) / np.linalg.norm(force)
    assert found.attrs["nrmse_linear"] == pytest.approx(left, rel=1e-9)
    powers = np.stack([y / y[-1], (y / y[-1]) ** 3], axis=1)
    cubic = force - powers @ np.linalg.lstsq(powers, force)[0]
    left = np.linalg.norm(cubic) / np.linalg.norm(force)
    assert found.attrs["nrmse_cubic"] == pytest.approx(left, rel=1e-6)


@pytest.mark.slow  # the steady solver compiles for half a minute
def test_a_period_of_a_multisine_is_met_by_its_transfer_function():
    fs, size = 512.0, 512
    rng = np.random.default_rng(3)
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / fs)
    lines = np.where((omega > 30) & (omega < 300), np.exp(2j * np.pi * rng.random(257)), 0)
    u = np.fft.irfft(lines, size)
    y = np.fft.irfft(lines * receptance(omega), size)
    units = {"force": "N", "displacement": "m"}
    records = tuple(
        Record(fs, {"force": u, "displacement": y + noise}, units)
        for noise in 1e-3 * y.std() * rng.standard_normal((4, size))
    )
    test = Test("multisine", records, "periodic", level=1.0)
    found = predict_periods(source(DRAWS, linear=ALONE), test).dataset
    # The mean of four repeats of noise 1e-3 is off by 5e-4; 512 samples say so to 3 %.
    assert found.attrs["nrmse"] == pytest.approx(5e-4, rel=0.15)
    assert found.attrs["coverage"] > 0.97
    top = np.argmax(np.abs(lines * receptance(omega)))
    expected = 2 * np.abs(lines[top] * receptance(omega[top])) / size
    assert float(found["measured_spectrum"].max()) == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("start", [0, 64])
def test_own_constants_are_those_that_another_mode_adds(start):
    """A spring and a free mass: y = (U + L/omega^2) u, an acceleration that no model has."""
    fs, size, upper, lower = 512.0, 2048, 3e-6, 0.02
    rng = np.random.default_rng(3)
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / fs)
    lines = np.where((omega > 60) & (omega < 300), np.exp(2j * np.pi * rng.random(1025)), 0)
    u, squared = np.fft.irfft(lines, size), np.where(omega > 0, omega, np.inf) ** 2
    moved = np.fft.irfft(-(omega**2) * lines * (upper + lower / squared), size)
    other = rng.standard_normal(size)  # what the model says of the rest
    units = {"force": "N", "acceleration": "m/s^2"}
    record = Record(fs, {"force": u, "acceleration": moved + other}, units)
    facts = {"band_hz": (10.0, 45.0), "settle": start / fs, "residuals": "own"}
    test = Test("sweep", (record,), "wide", level=1.0, **facts)
    model = (other + np.array([[-1.0], [0.0], [1.0]]))[:, start:]
    basis, alone = source(DRAWS).basis, {"linear": (other - 2.0)[start:]}
    data = reduced(basis, test)
    found, others = completed(basis, data, model, alone)
    error = found[1] - (moved + other)[start:]
    # From a later sample on, what is driven leaks beyond its lines.
    assert np.linalg.norm(error) < (1e-6 if start == 0 else 0.05) * np.linalg.norm(moved)
    np.testing.assert_allclose(np.diff(found, axis=0), 1.0)  # all draws by the same
    np.testing.assert_allclose(others["linear"], found[1] - 2.0, atol=1e-9)  # 0 Hz is no line
    for none in ("auto", "none", "upper"):
        same = completed(basis, replace(data, residuals=none), model, alone)
        assert same[0] is model
        assert same[1] is alone
    two = replace(basis, posterior=basis.posterior.assign(omega_2=3 * basis.posterior["omega_n"]))
    for residuals, own in (("auto", True), ("own", True), ("none", False), ("upper", False)):
        several, _ = completed(two, replace(data, residuals=residuals), model, alone)
        np.testing.assert_array_equal(several, found if own else model)


def test_constants_are_a_tests_own_where_it_says_so_or_modes_are_several():
    for residuals, alone, of_several in (
        ("auto", False, True), ("own", True, True), ("none", False, False), ("upper", False, False)
    ):  # fmt: skip
        assert has_own(residuals, several_modes=False) == alone
        assert has_own(residuals, several_modes=True) == of_several


def test_coverage_is_that_of_a_gaussian():
    rng = np.random.default_rng(1)
    model = 1.0 + 0.3 * rng.standard_normal((400, 5000))
    measured = 1.0 + np.hypot(0.3, 0.4) * rng.standard_normal(5000)
    found = errors(measured, model, {}, 0.4)
    assert found["coverage"] == pytest.approx(0.99, abs=0.005)
    assert found["num_values"] == measured.size
    # 2.576 sqrt(0.3^2 + 0.4^2) over sqrt(1 + 0.25): of 5000 values 1 %, of 400 draws 0.1 %.
    assert found["half_width"] == pytest.approx(2.576 * 0.5 / np.sqrt(1.25), rel=0.04)
    wide = errors(measured, model, {}, 20.0)  # holds all and says nothing
    assert wide["coverage"] == 1.0
    assert wide["half_width"] > 40
    # Of the parameters alone, where the noise is not known: quantiles of a normal.
    alone = errors(measured, model, {}, None)["half_width"]
    assert alone == pytest.approx(2.576 * 0.3 / np.sqrt(1.25), rel=0.1)
    assert "nrmse_linear" not in found


def test_runs_scatter_draws_and_leave_damping_positive():
    draws = {name: np.full(4000, value) for name, value in LINEAR.items()}
    assert scattered(jax.random.key(0), draws, jnp.zeros(0)) is draws
    moved = scattered(jax.random.key(0), draws, jnp.array([0.5, 0.02]))
    # A standard deviation from 4000 draws has a relative error of 1.1 %.
    assert moved["omega_n"].std() == pytest.approx(0.5, rel=0.05)
    assert moved["zeta"].min() > 0
    np.testing.assert_array_equal(moved["gain"], draws["gain"])
    # An offset beyond no damping at all stops at a hundredth of the draw.
    np.testing.assert_allclose(moved["zeta"].min(), 0.01 * ZETA)


def test_amplitude_curves_are_those_of_a_cubic_oscillator():
    test, cubic = decay_test(states=((2.4e-3, 0.0),)), 3e8
    omega_n = DECAY_OMEGA_N
    draws = {**DRAWS, "omega_n": np.full(3, omega_n), "cubic": np.full(3, cubic)}
    found = amplitude_verification(test, 1, draws, ("bouc_wen", "cubic"))
    # By hand: the velocity of an amplitude y is omega y, omega^2 = omega_n^2 + 3/4 cubic y^2, of
    # which 3 % are the cubic force's here; viscous damping falls with the frequency.
    omega = 2 * np.pi * found["model_frequency"].values[1]
    y = found["amplitude"].values / omega
    assert 0.75 * cubic * y[-1] ** 2 > 0.03 * omega_n**2
    np.testing.assert_allclose(omega**2, omega_n**2 + 0.75 * cubic * y**2, rtol=1e-6)
    np.testing.assert_allclose(found["model_damping"][1], ZETA * omega_n / omega, rtol=1e-4)


def a_step(held, **moments):
    rng = np.random.default_rng(0)
    unit = rng.standard_normal((2, 200))
    unit = (unit - unit.mean()) / unit.std(ddof=1)
    variables = {n: (("chain", "draw"), mean + sd * unit) for n, (mean, sd) in moments.items()}
    posterior = xr.DataTree.from_dict({"/posterior": xr.Dataset(variables)})
    return SimpleNamespace(posterior=posterior, held=held, wall_s=2.0)


def test_the_routes_stand_side_by_side():
    steps = {
        "third_order_nuts": a_step({}, zeta=(0.01, 1e-4), alpha=(500.0, 10.0), delta=(300.0, 6.0)),
        "opening_nuts": a_step({"alpha": 500.0, "delta": 300.0}, gamma=(33.0, 0.1)),
        "joint": a_step({}, alpha=(510.0, 5.0), gamma=(32.4, 0.2)),
    }
    checks, joint = SimpleNamespace(wall_s=0.5), steps.pop("joint")
    draws = joint.posterior["posterior"].to_dataset()
    joint = SimpleNamespace(draws=draws, held={}, wall_s=1.5)
    found = compare_routes(None, Posteriors(joint, checks, paper=PaperRoute(steps=steps)))  # pyright: ignore
    gamma = found["parameters"]["gamma"]
    assert gamma["sd_ratio"] == pytest.approx(2.0)
    assert gamma["difference"] == pytest.approx(3.0)
    # The cut holds alpha at 500: its product with gamma scales by that alone.
    assert found["parameters"]["alpha_gamma"]["cut"]["sd"] == pytest.approx(50.0)
    assert found["wall_time_s"] == {"cut": 4.0, "joint": 2.0}
    said = " ".join(found["statements"])
    assert "standard deviation of gamma is 2 times that of Step 4" in said
    assert "the two means differ by 3 of these standard deviations" in said
    assert compare_routes(None, Posteriors(joint, checks)) == {}  # pyright: ignore


def test_a_name_with_a_slash_is_one_level_of_the_tree():
    path = place("verification/curve", "held at 5 m/s^2")
    assert path.count("/") == 3


def test_the_error_of_groups_end_to_end_is_their_root_mean_square(monkeypatch):
    """Of one value missed by 0.3 and three missed by 0.1 each."""
    parts = [
        Predicted(xr.Dataset({"x": ("value", np.zeros(n))}, attrs={"nrmse": x}), None, NOT_KNOWN)
        for n, x in ((1, 0.3), (3, 0.1))
    ]
    monkeypatch.setattr(groups, "predict_apart", lambda *_: iter([("a", p) for p in parts]))
    found = groups.predict_groups(None, None).dataset
    assert found.attrs["nrmse"] == pytest.approx(np.sqrt((0.09 + 3 * 0.01) / 4), rel=1e-14)
    assert found.sizes["value"] == 4


@pytest.mark.parametrize(
    ("model", "size"), [(np.full((3, 4), 2.0), 2.0), (np.full((3, 4), 2j), 2**0.5)]
)
def test_an_error_of_the_law_is_of_real_and_imaginary_parts_apart(model, size):
    """A tenth of a response, whose square the two parts of a complex one share."""
    source = Source(None, {}, model_error=0.1)
    assert source.std(NOT_KNOWN, model) == pytest.approx(0.1 * size, rel=1e-14)
    known = NOT_KNOWN._replace(std=0.3)
    assert source.std(known, model, 4) == pytest.approx(np.hypot(0.1 * size, 0.15), rel=1e-14)

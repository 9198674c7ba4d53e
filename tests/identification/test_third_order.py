"""Step 3 on the true oscillator: where the paper's closed form (31) leads."""

import dataclasses

import jax
import numpy as np
import pytest

import jbw
from jbw import rig
from jbw.campaign.settings import Identify
from jbw.identification.linear import PooledFit
from jbw.identification.paper import kernel, step3
from jbw.inference.fit.fitting import fit
from jbw.inference.space.box import box
from jbw.measurement.probing import ThirdOrder

OMEGA_N = 2 * np.pi * 18.8
PAPER = {name: rig.PRIOR[name] for name in step3.NAMES}
PROBING = (5.0, 5.5, 6.0, 6.5, 6.75)


def measured(golden, noise_std, repeats=8):
    """The golden oscillator's kernel at A = 10 N/kg, with noise of a given size."""
    rng = np.random.default_rng(0)
    kernels = []
    for case in golden["true_oscillator_steady"]["cases"]:
        if case["A"] == 10.0 and case["f_hz"] in PROBING:
            h3 = complex(*case["H3_exp"])
            noise = noise_std * (rng.normal(size=repeats) + 1j * rng.normal(size=repeats))
            kernels.append(a_kernel(case, h3 + noise, noise_std))
    return tuple(sorted(kernels, key=lambda k: k.omega))


def a_kernel(case, h3, noise_std):
    n = len(h3)
    return ThirdOrder(
        omega=2 * np.pi * case["f_hz"], h3=h3, amplitude=np.full(n, 10 + 0j), u_3=np.zeros(n) + 0j,
        y_1=np.full(n, complex(*case["Y1"])), y_3=np.full(n, complex(*case["Y3"])),
        y_peak=np.full(n, case["ymax"]), source="removed", source_ratio=0.0, std=noise_std,
        std_expected=noise_std, covariance=np.eye(2) * noise_std**2 / n, above_noise=True, notes=(),
    )  # fmt: skip


@pytest.fixture(scope="module")
def data(golden):
    return kernel.reduce(measured(golden, 1e-11), OMEGA_N)


def test_five_probing_frequencies_are_in_the_golden_numbers(data):
    assert len(data.omega) == len(PROBING)


def test_the_closed_form_agrees_with_the_golden_model(golden):
    model = golden["bayes"]["eq31_model"]
    n = len(model["f_hz"])
    found = kernel.KernelData(
        omega=2 * np.pi * np.array(model["f_hz"]), mean=np.zeros(n) + 0j, within=np.ones(n),
        num_repeats=np.ones(n), noise_std=np.ones(n), y_peak=np.array(model["Y"]),
        omega_n=np.asarray(model["omega_n"]),
    )  # fmt: skip
    theta = {name: np.asarray(model[name]) for name in ("zeta", "alpha", "delta")}
    golden_h3 = np.array([complex(*h) for h in model["H3"]])
    # The golden numbers are exact to 1e-13 relative.
    np.testing.assert_allclose(kernel.predict(theta, found), golden_h3, rtol=1e-12)


def test_the_fit_runs_into_the_corner_that_the_theory_found(data):
    """Section 6, last row: alpha = 424 on the edge, delta = 379, zeta pulled to 0.50 %."""
    # The row holds for one noise level at all frequencies.
    level = dataclasses.replace(data, noise_std=np.full(5, 1e-10))
    best = fit(kernel.residual, box(PAPER), level, starts=16, key=jax.random.key(0))
    assert best.at_bound == {"alpha": "lower"}
    assert best.theta["delta"] == pytest.approx(379, abs=1)
    assert best.theta["zeta"] == pytest.approx(0.0050, abs=1e-4)  # quoted to two digits
    chi_square, dof = best.chi_square
    assert chi_square / dof > 5  # (31) is wrong by up to 12 % on the true oscillator
    assert "alpha*delta" in best.weak.text


@pytest.mark.release  # test_calibration.py has it fail
def test_the_papers_chain_does_not_mix_and_nuts_says_where_it_stands(data):
    prior = box(PAPER)
    best = fit(kernel.residual, prior, data, starts=16, key=jax.random.key(0))
    steps = step3.third_order_steps(
        jax.random.key(1), step3.KernelFit((), data, best, prior), Identify()
    )
    assert set(steps) == {"third_order_nuts", "third_order_paper", "third_order_walk"}
    failed = {
        name: {f.code for f in step.verdict.findings if f.status == "failed"}
        for name, step in steps.items()
    }
    assert {"r_hat", "ess_bulk"} <= failed["third_order_paper"]
    assert failed["third_order_nuts"] >= {"chi_square", "unidentified"}
    assert not failed["third_order_nuts"] & {"r_hat", "ess_bulk", "ess_tail", "divergences"}
    paper = steps["third_order_paper"].posterior["posterior"].to_dataset()
    assert paper.sizes["draw"] == 765  # 850 draws, the first tenth burnt in
    assert any("alpha*delta" in sentence for sentence in steps["third_order_nuts"].statements)


def test_measured_kernels_take_the_gain_out(golden):
    """The kernel per newton is that per volt over the cube of the gain, eq. (30)."""
    from jbw.measurement.records import Record, Test

    case = next(c for c in golden["true_oscillator_steady"]["cases"] if c["f_hz"] == 6.0)
    fs, omega = 1024.0, 2 * np.pi * case["f_hz"]
    t = np.arange(16384) / fs
    y = sum(
        np.real(complex(*case[key]) * np.exp(1j * n * omega * t))
        for n, key in ((1, "Y1"), (3, "Y3"), (5, "Y5"))
    )
    gain = 15.0
    channels = {"input": case["A"] / gain * np.cos(omega * t), "displacement": y}
    record = Record(fs, channels, {"input": "V", "displacement": "m"})
    test = Test("tones", (record, record), "tone", 0.6, (case["f_hz"],))
    linear = PooledFit(
        np.array([OMEGA_N, 0.00444, gain]), np.eye(3), np.zeros(3), np.ones(3), np.ones(3), 2
    )
    (found,) = step3.measured_kernels((test,), linear)
    # A pure tone through a least-squares fit: exact to the rounding of the subtraction of Y1.
    np.testing.assert_allclose(found.h3.mean(), complex(*case["H3_exp"]), rtol=1e-6)


def test_the_sources_own_harmonic_leaves_the_kernel_of_a_clean_source():
    """A source 60 dB clean, through an independent integration of the oscillator."""
    from scipy.integrate import solve_ivp

    from jbw.measurement.records import Record, Test

    zeta, alpha, delta, gamma = 0.00444, 497.4, 340.2, 32.8
    hz, fs, amplitude = 6.0, 512.0, 10.0
    omega = 2 * np.pi * hz

    def measured_kernel(third):
        def force(t):
            return amplitude * (np.cos(omega * t) + third * np.cos(3 * omega * t + 0.7))

        def rates(t, state):
            y, v, z = state
            a = force(t) - 2 * zeta * OMEGA_N * v - (OMEGA_N**2 - alpha) * y - z
            return v, a, alpha * v - gamma * abs(v) * z - delta * v * abs(z)

        # The free motion has died to exp(-0.00444 * 118 * 25) = 2e-6 of itself after 25 s.
        t = np.arange(25 * fs, 35 * fs) / fs
        y = solve_ivp(rates, (0, t[-1]), np.zeros(3), "LSODA", t, rtol=1e-8, atol=1e-11).y[0]
        channels = {"input": force(t), "displacement": y}
        record = Record(fs, channels, {"input": "N/kg", "displacement": "m"})
        test = Test("tones", (record, record), "tone", 10.0, (hz,))
        linear = PooledFit(
            np.array([OMEGA_N, zeta, 1.0]), np.eye(3), np.zeros(3), np.ones(3), np.ones(3), 2
        )
        (found,) = step3.measured_kernels((test,), linear)
        return found

    clean, dirty = measured_kernel(0.0), measured_kernel(1e-3)
    assert dirty.source_ratio > 0.5
    # The mean slope is the first order of what the joint does at 3 omega, and the correction as
    # large as the kernel itself: it leaves 0.8 %, the receptance of Step 2 alone 8 %.
    np.testing.assert_allclose(dirty.h3.mean(), clean.h3.mean(), rtol=0.025)


def test_the_error_of_the_closed_form_is_the_one_that_is_stated(golden):
    """12 % and 8 degrees at the paper's frequencies and 0.8 mm, 25 degrees at omega_n / 3."""
    ratios = {}
    for case in golden["true_oscillator_steady"]["cases"]:
        if case["A"] == 10.0:
            y_peak = abs(complex(*case["Y1"]))
            for variant in ("printed", "least_squares"):
                closed = complex(jbw.h3(rig.TRUTH, 2 * np.pi * case["f_hz"], y_peak, variant))
                ratios[variant, case["f_hz"]] = complex(*case["H3_exp"]) / closed
    for variant in ("printed", "least_squares"):
        probed = np.array([ratios[variant, f_hz] for f_hz in PROBING])
        # The stated numbers have two digits, and one.
        assert np.max(np.abs(np.abs(probed) - 1)) == pytest.approx(0.12, abs=0.005)
        assert np.max(np.abs(np.angle(probed, deg=True))) == pytest.approx(8, abs=0.5)
        assert np.angle(ratios[variant, 6.25], deg=True) == pytest.approx(-25, abs=0.5)

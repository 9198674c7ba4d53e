"""Other conventions against their own formulas, written out here, and against published numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.errors import ModelError
from jbw.oscillator.conventions import (
    BaberNoori,
    Benchmark,
    conversions,
    from_baber_noori,
    from_benchmark,
    to_baber_noori,
    to_benchmark,
)
from jbw.oscillator.laws.hysteresis import hysteresis_rate
from jbw.oscillator.laws.springs import Cubic
from jbw.oscillator.oscillator import BoucWen

PROPERTY = settings(deadline=None, max_examples=50, derandomize=True)
NAMES = ("omega_n", "zeta", "alpha", "delta", "gamma", "nu")
SIZES = st.floats(0.01, 100.0)


@st.composite
def joints(draw):
    omega_n = draw(st.floats(10.0, 1000.0))
    share = draw(st.floats(0.01, 0.95))
    delta, gamma = draw(st.floats(-500.0, 500.0)), draw(st.floats(0.0, 500.0))
    nu = draw(st.sampled_from([1.0, 1.5, 2.0]))
    return BoucWen(omega_n, 0.01, share * omega_n**2, delta, gamma, nu=nu)


def same(one, other):
    for name in NAMES:
        # Powers and quotients of a few numbers: some roundings each.
        assert float(getattr(one, name)) == pytest.approx(float(getattr(other, name)), rel=1e-12)


def test_the_benchmarks_published_parameters():
    published = Benchmark(2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1)
    joint = from_benchmark(published)
    assert joint.omega_n == pytest.approx(np.sqrt(5e4))  # 35.59 Hz
    assert joint.zeta == pytest.approx(0.01118, rel=1e-3)
    assert (joint.alpha, joint.delta, joint.gamma) == pytest.approx((25_000, -1100, 800))
    assert to_benchmark(joint, 2.0, beta=1e3) == pytest.approx(published)


@PROPERTY
@given(joints(), SIZES, SIZES)
def test_there_and_back(joint, mass, beta):
    same(joint, from_baber_noori(to_baber_noori(joint, mass)))
    same(joint, from_benchmark(to_benchmark(joint, mass, beta)))


@PROPERTY
@given(joints(), SIZES, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_each_law_moves_its_z_as_ours_does(joint, mass, v, part):
    force = part * joint.alpha * 1e-3  # N/kg, a slip of a millimetre
    rate = float(hysteresis_rate(joint, v, force))
    close = {"rel": 1e-10, "abs": 1e-12 * float(joint.alpha)}
    b = to_baber_noori(joint, mass)
    z = force / joint.alpha
    dz = v - b.beta * abs(v) * abs(z) ** b.n * np.sign(z) - b.gamma * v * abs(z) ** b.n
    assert (1 - b.ratio) * b.stiffness / mass * dz == pytest.approx(rate, **close)
    m = to_benchmark(joint, mass, beta=7.0)
    z = mass * force
    dz = m.alpha * v - m.beta * (
        m.gamma * abs(v) * abs(z) ** m.nu * np.sign(z) + m.delta * v * abs(z) ** m.nu
    )
    assert dz / mass == pytest.approx(rate, **close)


@PROPERTY
@given(joints(), SIZES, st.floats(1e-4, 1.0), st.floats(-1.0, 1.0))
def test_opensees_reads_the_same_tangent(joint, mass, dy, part):
    (material,) = conversions(joint, mass)["Bouc-Wen-Baber-Noori, OpenSees"].materials
    assert material.kind == "BoucWen"
    ratio, k_0, n, gamma, beta, a_0, *degradation = material.arguments
    assert degradation == [0.0, 0.0, 0.0]
    z = part * 1e-3
    slope = a_0 - abs(z) ** n * (gamma + beta * np.sign(dy * z))  # as in its source code
    rate = float(hysteresis_rate(joint, dy, joint.alpha * z))
    close = {"rel": 1e-10, "abs": 1e-12 * float(joint.alpha)}
    assert ratio == 0.0  # the spring stands beside it
    assert k_0 / mass * slope * dy == pytest.approx(rate, **close)


def test_what_cannot_be_said_in_their_letters_is_refused():
    joint = BoucWen(118.0, 0.004, 497.0, 340.0, 33.0)
    with pytest.raises(ModelError, match="`mass` must be positive, but it is 0"):
        to_baber_noori(joint, 0.0)
    with pytest.raises(ModelError, match="`beta` must be positive"):
        to_benchmark(joint, 1.0, beta=-1.0)
    with pytest.raises(ModelError, match="`restoring` must be None"):
        to_baber_noori(BoucWen(118.0, 0.004, 497.0, 340.0, 33.0, restoring=Cubic(1e9)), 1.0)
    with pytest.raises(ModelError, match="1 - ratio"):
        from_baber_noori(BaberNoori(1.0, 0.1, 1e4, 1.0, 30.0, 300.0))

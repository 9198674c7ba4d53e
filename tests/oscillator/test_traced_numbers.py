"""Every public function of the oscillator under jit: which numbers are traced changes no result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from known_laws import ODD, THETA, law_of
from tiers import standing_for_all

import jbw
from jbw.errors import ConfigError

JOINT = {"omega_n": 118.0, "zeta": 0.005, "alpha": 497.4, "delta": 340.0, "gamma": 33.0}
CUBIC, FS = 2e7, 256.0
INPUT = 5.0 * np.sin(2 * np.pi * 18.0 * np.arange(64) / FS)
SPECTRUM = np.array([1e-3 + 2e-4j, 1e-5 - 3e-6j])
SHAPE = np.array([0.3, -0.2, 1.0])
MOTION = 1e-3 * SHAPE
SECOND = np.array([210.0, 0.006, -1.7, -1.1, 0.7, 0.4])


def slipping(j):
    return jbw.BoucWen(**j)


def both(j, cubic):
    """Two laws beside each other."""
    law = jbw.laws.BoucWenLaw(j["alpha"], j["delta"], j["gamma"])
    return jbw.Oscillator(j["omega_n"], j["zeta"], (law, jbw.Cubic(cubic)))


def cubed(cubic, y):
    return cubic * jnp.sin(y) ** 3


def beside(j, cubic):
    """A smooth force of the caller's own, a pytree of its number."""
    return jbw.BoucWen(**j, restoring=Partial(cubed, cubic))


def structure(j, m):
    """Two modes, the second of the numbers m."""
    first = jnp.array([j["omega_n"], j["zeta"], 1.0, 1.0, 1.0, 1.0])
    law = jbw.laws.BoucWenLaw(j["alpha"], j["delta"], j["gamma"])
    return jbw.Structure(*jnp.stack([first, jnp.asarray(m)], 1), (law,))


def simulated(j, fs, u, **options):
    return jbw.simulate(slipping(j), u, fs, **options)


# Public name, and what is computed, to the function of all its numbers and the numbers.
CASES = {
    "h1": (lambda j, w: jbw.h1(w, j["omega_n"], j["zeta"]), 40.0),
    "h3": (lambda j, w, y: jbw.h3(slipping(j), w, y), 40.0, 1e-3),
    "third_harmonic": (lambda j, w, y: jbw.third_harmonic(slipping(j), w, y), 40.0, 1e-3 + 1e-4j),
    "smoothing": (lambda j, y: jbw.smoothing(slipping(j), y), 1e-3),
    "smoothing, open": (lambda j, y, o: jbw.smoothing(slipping(j), y, y_open=o), 1e-3, 1e-5),
    "hysteresis_map": (lambda j, z, dy: jbw.hysteresis_map(slipping(j), z, dy), 0.1, -1e-3),
    "hysteresis_rate": (lambda j, v, z: jbw.hysteresis_rate(slipping(j), v, z), 0.1, 0.2),
    "steady_loop": (lambda j, y: jbw.steady_loop(slipping(j), y), 1e-3),
    "backbone": (lambda j, y: jbw.backbone(slipping(j), y), 1e-3),
    "Oscillator, backbone": (lambda j, c, y: jbw.backbone(both(j, c), y), CUBIC, 1e-3),
    "Oscillator, loop": (lambda j, c, y: both(j, c).loop(y), CUBIC, 1e-3),
    "Oscillator, force_along": (
        lambda j, c, y: both(j, c).force_along(jnp.asarray(y)), CUBIC, MOTION,
    ),
    "BoucWen, k": (lambda j: slipping(j).k,),
    "Cubic": (lambda j, c, y: jbw.Cubic(c)(y) / j["omega_n"], CUBIC, 1e-3),
    "Polynomial": (lambda j, c, y: jbw.Polynomial((None, c))(y) / j["omega_n"], CUBIC, 1e-3),
    "steady_cycle": (lambda j, q, w: jbw.steady_cycle(slipping(j), q, w, 16), SPECTRUM, 117.0),
    "steady_state": (lambda j, w, a: jbw.steady_state(slipping(j), w, a, 2), 117.0, 0.05),
    "steady_state, laws": (
        lambda j, c, w, a: jbw.steady_state(both(j, c), w, a, 2), CUBIC, 117.0, 0.05,
    ),
    "steady_state, restoring": (
        lambda j, c, w, a: jbw.steady_state(beside(j, c), w, a, 2), CUBIC, 117.0, 0.05,
    ),
    "frequency_response": (
        lambda j, w, a: jbw.frequency_response(slipping(j), w, a, 2),
        np.array([110.0, 117.0]), np.array([0.02, 0.05]),
    ),
    "dimensionless": (lambda j, w, a: jbw.dimensionless(slipping(j), w, a), 117.0, 0.05),
    "simulate": (simulated, FS, INPUT),
    "Structure": (lambda j, m, fs, u: jbw.simulate(structure(j, m), u, fs), SECOND, FS, INPUT),
    "Structure, steady_state": (
        lambda j, m, w, a: jbw.steady_state(structure(j, m), w, a, 2), SECOND, 117.0, 0.05,
    ),
    "Structure, backbone": (
        lambda j, m, x: jbw.backbone(structure(j, m), x, num_harmonics=2), SECOND, 1e-3,
    ),
    "simulate, initial": (
        lambda j, fs, u, y, v, z: simulated(j, fs, u, initial=(y, v, z)), FS, INPUT, 1e-3, 0.1, 0.2,
    ),
    "simulate, periodic": (
        lambda j, fs, u: simulated(j, fs, u, periodic=True, hold="band_limited"), FS, INPUT,
    ),
    "simulate, function": (
        lambda j, fs, w: simulated(j, fs, lambda t: jnp.sin(w * t), num_samples=8), FS, 110.0,
    ),
}  # fmt: skip
# What has no number to trace: data, files, studies, or a class that is used above; and `shooting`,
# whose steps adapt to rounding and which has derivatives in forward mode alone.
ELSEWHERE = {
    # Loads of a study, read and made by NumPy.
    "Pulse", "RandomProfile", "forced", "profile_of", "read_profile", "shock_spectrum",
    # Models in matrices are reduced once, by NumPy and SciPy.
    "Joint", "MatrixModel", "ReducedModel", "energy_shares", "joint_separability", "joint_starts",
    "matrix_model", "read_matrices", "reduce",
    "Attachment", "Campaign", "ConfigError", "DataError", "JbwError", "ModelError", "Record",
    "Response", "RunError", "Study", "Test", "attached", "citation", "compare", "compare_laws",
    "conventions", "draw_backbones", "enable_x64", "excitation", "paper", "shooting",
    "fit_attachment", "fit_modes", "fleet_of", "frf", "from_sep005", "harmonics",
    "identifiability", "identify", "identify_many", "laws", "line_fit", "load_campaign",
    "load_study", "new_backbone", "new_prediction", "new_units", "one_stage", "plan_tests", "pool",
    "numpyro_model", "plots", "population_of", "read", "read_fleet", "record_frf", "rig",
    "sampling", "sbc", "steps", "structure_of", "third_order_kernel", "to_sep005", "updated",
    "warnings_of", "write_fleet", "write_uff",
}  # fmt: skip
# Have as many points, or pairs, as their numbers ask for.
REFUSES = {"internal_resonances", "response_curve"}


def test_every_public_name_stands_here():
    covered = {name.partition(",")[0] for name in CASES}
    assert covered | ELSEWHERE | REFUSES == {*jbw.__all__}


def compared(found, expected):
    """Equal to 1e-12 of the largest number of each leaf.

    Below 1e-14 is round-off: what a steady period leaves of itself, some 1e-13, is made of it.
    """
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    for one, other in pairs:
        assert one.shape == np.shape(other)
        size = np.max(np.abs(np.asarray(other)))
        assert np.isfinite(size)
        np.testing.assert_allclose(one, other, rtol=0, atol=max(1e-12 * size, 1e-14))


# What takes long to compile: the quickest of each kind in every run of the tests.
LONG = {
    "Structure", "Structure, backbone", "Structure, steady_state", "frequency_response",
    "simulate, function", "simulate, initial", "simulate, periodic",
    "steady_state, laws", "steady_state, restoring",
}  # fmt: skip


# The same solver under another wrapper, which another case or test takes through it.
AGAIN = {
    "Structure, backbone", "simulate, periodic", "steady_state", "steady_state, restoring",
}  # fmt: skip
# Of slopes also what test_adjoint.py and test_structure.py hold against differences.
SLOPE_AGAIN = AGAIN | {
    "Structure", "frequency_response", "simulate, function", "simulate, initial",
}  # fmt: skip


def in_tiers(long, again):
    def marks(name):
        return pytest.mark.release if name in again else pytest.mark.slow if name in long else ()

    return [pytest.param(name, marks=marks(name)) for name in CASES]


@pytest.mark.parametrize("name", in_tiers(LONG, AGAIN))
def test_numbers_may_be_traced_or_constants(name):
    """All of them traced, none, and all but the joint's."""
    function, *numbers = CASES[name]
    expected = function(JOINT, *numbers)
    compared(jax.jit(function)(JOINT, *numbers), expected)
    compared(jax.jit(lambda: function(JOINT, *numbers))(), expected)
    if numbers and name not in LONG:
        compared(jax.jit(lambda *rest: function(JOINT, *rest))(*numbers), expected)


@pytest.mark.parametrize(  # with pinching it is the same law and more
    "name", standing_for_all(ODD, *{*ODD} - {"bwbn"})
)
def test_the_numbers_of_every_law_may_be_traced_or_constants(name):
    def moved(theta, y):
        joint = jbw.Oscillator(118.0, 0.005, (law_of(name, theta),))
        return jbw.backbone(joint, y), joint.force_along(y * SHAPE)

    expected = moved(THETA[name], 3e-3)
    compared(jax.jit(moved)(THETA[name], 3e-3), expected)
    compared(jax.jit(lambda: moved(THETA[name], 3e-3))(), expected)


def power(function):
    """Sum of the squares of all that a function of (joint, numbers) returns, each by its size."""

    def total(free, sizes):
        leaves = jax.tree.leaves(function(free[0], *free[1:]))
        pairs = zip(leaves, sizes, strict=True)
        return sum(jnp.sum(jnp.abs(leaf / size) ** 2) for leaf, size in pairs)

    return total


@pytest.mark.parametrize("name", in_tiers(LONG | {"simulate"}, SLOPE_AGAIN))
def test_the_gradient_by_every_number_is_the_slope(name):
    """Along one direction that changes all numbers, against a central difference."""
    function, *numbers = CASES[name]
    # The residual of a periodic record is round-off, which has no slope.
    leaves = jax.tree.leaves(jax.jit(function)(JOINT, *numbers))  # by the program of the test above
    sizes = [max(float(np.max(np.abs(x))), 1e-9) for x in leaves]
    free = jax.tree.map(np.asarray, (JOINT, *numbers))
    total = jax.jit(jax.value_and_grad(power(function)))
    _, slopes = total(free, sizes)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slopes))
    way = jax.tree.map(lambda x: 1e-5 * x, free)
    ahead, behind = (
        jax.tree.map(lambda x, d, s=sign: np.asarray(x + s * d), free, way) for sign in (1, -1)
    )
    expected = float(total(ahead, sizes)[0] - total(behind, sizes)[0]) / 2
    # Of a complex number jax has the slope by its conjugate.
    parts = jax.tree.map(lambda g, d: np.sum(np.real(g * d)), slopes, way)
    scale = float(sum(abs(part) for part in jax.tree.leaves(parts)))
    # Third differences of 1e-5, and the round-off of two values of order one over them.
    assert float(sum(jax.tree.leaves(parts))) == pytest.approx(expected, abs=1e-6 * scale + 1e-10)


def test_a_curve_of_unknown_length_says_that_it_cannot_be_traced():
    def curve(stop):
        return jbw.response_curve(slipping(JOINT), 110.0, stop, 0.05).omega

    for transform in (jax.jit, jax.grad):
        with pytest.raises(ConfigError, match="cannot be traced"):
            transform(curve)(112.0)
    with pytest.raises(ConfigError, match="`frequency_response`"):
        jax.jit(lambda: curve(112.0))()


def test_checks_stay_at_the_door_for_constants():
    """Under jit, what is known is still looked at."""
    with pytest.raises(ConfigError, match="y_peak"):
        jax.jit(lambda: jbw.backbone(slipping(JOINT), -1.0))()
    even = jbw.BoucWen(**JOINT, restoring=lambda y: 1e6 * jnp.cos(y))
    with pytest.raises(jbw.ModelError, match="odd force"):
        jax.jit(lambda w: jbw.steady_state(even, w, 0.05))(117.0)


@pytest.mark.slow
def test_a_force_may_hold_a_traced_number_in_itself():
    """Which no check can look at; derivatives need a pytree."""

    def response(cubic):
        joint = jbw.BoucWen(**JOINT, restoring=lambda y: cubed(cubic, y))
        return jbw.steady_state(joint, 117.0, 0.05, 2)

    compared(jax.jit(response)(CUBIC), response(CUBIC))

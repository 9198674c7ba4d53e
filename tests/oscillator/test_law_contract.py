"""What holds for every law of the register, and for one that the tests define."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from guests import Bilinear
from known_laws import THETA, compiled, law_of
from tiers import standing_for_all

import jbw
from jbw.errors import ConfigError
from jbw.oscillator.law import Scales
from jbw.oscillator.laws import (
    LAWS,
    law_named,
    laws_named,
    register,
    same_by_construction,
)
from jbw.oscillator.oscillator import Oscillator, oscillator_of, prior_of

SCALES = Scales(omega_n=118.0, zeta=0.005, y_peak=4e-3)
FS = 1024.0
TIME = np.arange(256) / FS
POINTS = 4000  # of a path that every law is moved along
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)


@pytest.fixture(params=[*THETA])
def law(request):
    """One of every kind, of the register or of the tests."""
    return law_of(request.param)


# Compiling takes a second a law: the quickest in every run of the tests.
AT_ONCE = {"bouc_wen", "cubic"}


def in_tiers(names):
    """Names of laws, of which those that are not quick to compile wait for the slow tier."""
    return [n if n in AT_ONCE else pytest.param(n, marks=pytest.mark.slow) for n in names]


# A smooth force and sliders with kinks; the paper's law and Iwan's have golden numbers.
@pytest.fixture(params=standing_for_all(THETA, "cubic", "jenkins_3"))
def compiled_law(request):
    """One of every kind, where a test compiles long programs."""
    return law_of(request.param)


def oscillator(law):
    return jax.tree.map(lambda x: jnp.asarray(x, float), Oscillator(118.0, 0.01, (law,)))


@compiled
def stiffness_and_loop(law, y):
    return law.stiffness(), law.loop(y)


@compiled
def along(law, y, memory, v):
    """The memory behind a path, and the force at each of its points under v."""

    def onward(memory, move):
        start, end, v = move
        memory = law.move(start, memory, end - start)
        return memory, law.force(end, v, memory)

    first = law.force(y[0], v[0], memory)
    behind, force = jax.lax.scan(onward, memory, (y[:-1], y[1:], v[1:]))
    return behind, jnp.append(first, force)


@compiled
def tip_and_fundamental(law, y_peak):
    """The memory at the tip of a loop, and the first harmonic of its force over the amplitude."""
    first = law.harmonics(jnp.array([y_peak, 0.0], complex), 2)[0]
    return law.at_tip(y_peak), first / y_peak + law.stiffness()


@compiled
def tone_and_slope(joint, omega, amplitude):
    """Harmonics under a tone, and the slope of the first one's size by the tone's amplitude."""

    def size(amplitude):
        harmonics = jbw.steady_state(joint, omega, amplitude)
        return jnp.abs(harmonics[0]), harmonics

    (_, harmonics), slope = jax.value_and_grad(size, has_aux=True)(amplitude)
    return harmonics, slope


def test_every_law_of_the_register_stands_in_this_contract():
    assert {*LAWS} <= {*THETA}


def test_the_table_is_complete(law):
    assert [*law.names()] == [*law.parameters()]
    for quantity in law.table:
        assert quantity.name
        assert quantity.symbol
        assert quantity.unit
        assert quantity.meaning
    for coordinates in law.coordinates.values():
        point = coordinates.from_parameters({**law.parameters(), "omega_n": 118.0})
        again = law.build(point)
        np.testing.assert_allclose(jax.tree.leaves(again), jax.tree.leaves(law), rtol=1e-14)
        assert {*coordinates.names} == {quantity.name for quantity in coordinates.table}
    for product in law.products:
        assert product.quantity.unit
        assert product.powers.keys() <= {*law.names()}


@pytest.mark.parametrize(
    ("name", "y"),
    # Of a gap beyond its contact, where only the element's losses are of second order.
    [
        ("bouc_wen", 1e-7),
        ("bouc_wen_nu", 1e-9),
        ("masing_exponential", 1e-7),
        ("gap_series", 6e-4 + 1e-8),
    ],
)
def test_weak_motion_knows_the_products_alone(name, y):
    law = law_of(name)
    first, *others = [key for key in law.names() if any(key in one.powers for one in law.products)]
    own = law.parameters()
    traded = {first: 1.5 * own[first]} | {key: own[key] / 1.5 for key in others}
    other = type(law).build({**own, **traded})
    for product in law.products:
        assert product.of(other.parameters()) == pytest.approx(product.of(own), rel=1e-14)
    pair = law, other
    stiffness, loops = zip(*(stiffness_and_loop(one, y) for one in pair), strict=True)
    # To the next order in the amplitude.
    assert float(loops[0].damping) == pytest.approx(float(loops[1].damping), rel=1e-3)
    if name != "gap_series":
        lost = [float(a) - float(b.stiffness) for a, b in zip(stiffness, loops, strict=True)]
        assert lost[0] == pytest.approx(lost[1], rel=1e-3)


def test_the_prior_is_inside_the_limits(law):
    bounds = law.prior(SCALES)
    assert {*bounds} == {*law.names()}
    for quantity in law.table:
        low, high = bounds[quantity.name]
        assert low < high
        assert quantity.least is None or low >= quantity.least
    upper = law.build({name: high for name, (_, high) in bounds.items()})
    assert upper.stiffness() < SCALES.omega_n**2


def test_a_batch_is_its_members(law):
    """As the draws of a posterior are: an array for every parameter."""
    pair = [law, jax.tree.map(lambda x: 1.1 * x, law)]
    both = jax.tree.map(lambda *x: np.array(x, float), *pair)
    alone, loops = zip(*(stiffness_and_loop(one, 3e-3) for one in pair), strict=True)
    stiffness, loop = stiffness_and_loop(both, 3e-3)
    np.testing.assert_allclose(stiffness, alone, rtol=1e-12)
    np.testing.assert_allclose(loop.stiffness, [one.stiffness for one in loops], rtol=1e-10)
    damping = [one.damping for one in loops]
    np.testing.assert_allclose(loop.damping, damping, rtol=1e-10, atol=1e-9)


def test_no_motion_leaves_rest(law):
    after = law.move(1e-3, law.at_rest(), 0.0)
    assert all(x == 0.0 for x in jax.tree.leaves(after))


@pytest.mark.parametrize("name", in_tiers(THETA))
def test_no_force_leaves_rest(name):
    # Of the length and substeps of the gradients' record, whose program it is.
    still = jbw.simulate(oscillator(law_of(name)), np.zeros(len(INPUT)), FS, substeps=2)
    assert np.all(np.asarray(still.y) == 0.0)
    assert np.all(np.asarray(still.z) == 0.0)


def test_stiffness_is_the_slope_at_rest(law):
    dy = 1e-15  # laws of sliders without a least slip soften by a broken power of y
    before, after = law.at_rest(), law.move(0.0, law.at_rest(), dy)
    slope = (law.force(dy, 1.0, after) - law.force(0.0, 1.0, before)) / dy
    np.testing.assert_allclose(slope, law.stiffness(), rtol=1e-6, atol=1e-6)


def test_a_move_is_the_sum_of_its_parts_and_the_force_is_continuous(law):
    step, slow = 7e-5, np.ones(POINTS + 1)
    apart, at_once = np.zeros((2, POINTS + 1))  # at rest, to be of the length of the loop's path
    apart[-51:], at_once[-1] = step * np.arange(51), 50 * step
    whole, _ = along(law, at_once, law.at_rest(), slow)
    memory, force = along(law, apart, law.at_rest(), slow)
    np.testing.assert_allclose(jax.tree.leaves(memory), jax.tree.leaves(whole), rtol=1e-10)
    steepest = max(float(law.stiffness()), 3 * 2e7 * (50 * step) ** 2)
    assert np.max(np.abs(np.diff(force))) <= 1.001 * steepest * step


def test_the_loops_energy_is_the_area_of_the_path(law):
    law = law.undamaged() if law.degrades else law  # otherwise each cycle changes it
    y_peak = 3.5e-3
    theta = np.linspace(0.0, 2 * np.pi, POINTS + 1)
    y = y_peak * np.cos(theta)
    like, first = tip_and_fundamental(law, y_peak)
    slow = 1e-6 * np.append(1.0, np.diff(y))
    closed, force = along(law, y, like, slow)
    np.testing.assert_allclose(
        jax.tree.leaves(closed), jax.tree.leaves(like), rtol=1e-9, atol=1e-12
    )
    area = np.trapezoid(force, y)
    _, loop = stiffness_and_loop(law, y_peak)
    np.testing.assert_allclose(loop.energy(y_peak), area, rtol=1e-4, atol=1e-9)
    # The generic harmonics: a grid of 512 points, an error of its second power.
    expected = complex(loop.stiffness, loop.damping)
    assert abs(complex(first) - expected) <= 1e-4 * abs(expected)


def test_gradients_are_central_differences(compiled_law):
    law = compiled_law
    start = oscillator(law)
    leaves, tree = jax.tree.flatten(start)

    def misfit(joint):
        return jnp.sum(jbw.simulate(joint, INPUT, FS, substeps=2).v ** 2)

    found = jax.tree.leaves(jax.grad(misfit)(start))
    for index, value in enumerate(leaves):
        pair = []
        for sign in (1.0, -1.0):
            moved = [*leaves]
            moved[index] = value * (1.0 + sign * 1e-6)
            pair.append(float(misfit(jax.tree.unflatten(tree, moved))))
        difference = (pair[0] - pair[1]) / (2e-6 * value)
        scale = float(misfit(start)) / value
        assert abs(found[index] - difference) <= 1e-6 * abs(difference) + 1e-8 * scale


@pytest.mark.slow  # seconds of compiling; test_steady.py has golden steady states
def test_the_steady_state_is_that_of_a_periodic_record(compiled_law):
    law = compiled_law
    if law.name == "square":
        pytest.skip("its force is even: refused, as tests/oscillator/test_even_spring.py shows")
    if law.degrades:
        pytest.skip("no motion is steady: tests/oscillator/test_bwbn.py has its limit")
    joint, omega = oscillator(law), 112.0
    harmonics, slope = tone_and_slope(joint, omega, 4.0)
    phase = 2 * np.pi * np.arange(64) / 64
    record = jbw.simulate(
        joint, 4.0 * np.cos(phase), 64 * omega / (2 * np.pi),
        hold="band_limited", periodic=True, substeps=4,
    )  # fmt: skip
    first = 2 * np.mean(np.asarray(record.y) * np.exp(-1j * phase))
    # What eight harmonics leave. A law that says only its move yields between the generic step's
    # ends, which costs its first order in time: 2.8e-4, 1.4e-4, 7e-5 with 4, 8, 16 substeps here,
    # while its harmonics are within 2e-6 of the same law's among the sliders.
    tolerance = 4e-4 if law.name == "bilinear" else 3e-5
    assert abs(first / complex(harmonics[0]) - 1) < tolerance
    if law.name == "bilinear":
        slider = oscillator(law_named("jenkins").of(THETA["jenkins"]))
        exact = complex(jbw.steady_state(slider, omega, 4.0)[0])
        assert abs(complex(harmonics[0]) / exact - 1) < 1e-5
    near = [abs(complex(tone_and_slope(joint, omega, a)[0][0])) for a in (4.0004, 3.9996)]
    np.testing.assert_allclose(slope, (near[0] - near[1]) / 8e-4, rtol=1e-3)
    found = compiled(jbw.backbone)(joint, np.array([0.0, 3e-3]))
    assert np.all(np.isfinite(np.asarray(found.omega)))
    assert found.omega[0] == pytest.approx(118.0)


@pytest.mark.parametrize("name", ["bwbn", "bwbn_pinching"])
def test_a_steady_loop_of_a_law_that_wears_is_that_before_damage(name):
    law, y_peak = law_of(name), 3.5e-3
    worn, fresh = (stiffness_and_loop(one, y_peak) for one in (law, law.undamaged()))
    np.testing.assert_array_equal(np.array(worn[1]), np.array(fresh[1]))
    tips = [tip_and_fundamental(one, y_peak) for one in (law, law.undamaged())]
    np.testing.assert_allclose(tips[0][0], [tips[1][0], 0.0])
    assert complex(tips[0][1]) == pytest.approx(complex(tips[1][1]), rel=1e-12)


def test_laws_stand_beside_each_other():
    theta = {"omega_n": 118.0, "zeta": 0.01}
    for name in ("bouc_wen", "cubic", "jenkins_3"):
        theta |= THETA[name]
    joint = oscillator_of(theta, ("bouc_wen", "cubic", "jenkins_3"))
    assert joint.parameters() == theta
    apart = [oscillator_of(theta, (name,)) for name in ("bouc_wen", "cubic", "jenkins_3")]
    y = jnp.array([0.0, 1e-3, 3e-3, -2e-3])
    beside = sum(one.force_along(y) - one.k * y for one in apart)
    np.testing.assert_allclose(joint.force_along(y) - joint.k * y, beside, rtol=1e-12)
    coarse, fine = (jbw.simulate(joint, INPUT, FS, substeps=n).y for n in (1, 4))
    assert np.max(np.abs(coarse - fine)) < 1e-6 * np.max(np.abs(fine))
    assert {*prior_of(("bouc_wen", "jenkins_3"), SCALES)} == {
        *THETA["bouc_wen"], *THETA["jenkins_3"]
    }  # fmt: skip


def test_laws_that_no_motion_tells_apart_are_named():
    assert same_by_construction(("iwan4", "cubic", "bouc_wen")) is None
    assert "depends only on the sum of the virgin" in str(
        same_by_construction(("iwan4", "jenkins_2"))
    )
    assert "with an exponent of 1" in str(same_by_construction(("bouc_wen_nu", "bouc_wen")))
    # It is so: the forces of two Masing laws along any path are those of one of the sum.
    y = jnp.array([0.0, 2e-3, -1e-3, 3e-3, 0.5e-3, 4e-3])
    together = Oscillator(118.0, 0.01, (law_of("jenkins"), law_of("bilinear")))
    k, slip = THETA["jenkins"]["stiffness_1"], THETA["jenkins"]["slip_1"]
    one = Oscillator(
        118.0, 0.01, (law_named("jenkins_1").build({"stiffness_1": 2 * k, "slip_1": slip}),)
    )
    own, other = (each.force_along(y) - each.k * y for each in (one, together))
    np.testing.assert_allclose(own, other, atol=1e-9)


def test_the_register_refuses_what_it_does_not_know():
    with pytest.raises(ConfigError, match="did you mean `bouc_wen`"):
        law_named("boucwen")
    with pytest.raises(ConfigError, match="named twice"):
        laws_named(("cubic", "cubic"))
    with pytest.raises(ConfigError, match="share the parameter `stiffness_1`"):
        laws_named(("jenkins_2", "jenkins_3"))
    with pytest.raises(ConfigError, match="must be a subclass of `Law`"):
        register(dict)
    assert law_named("jenkins_2") is law_named("jenkins_2")
    try:
        assert law_named(register(Bilinear).name) is Bilinear
    finally:
        LAWS.pop("bilinear", None)

"""Spectrum, products and box against closed forms and quadrature."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.stats import truncnorm

from jbw.errors import ConfigError
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.identifiability import box_sensitivity, contraction, sensitivity_statements
from jbw.inference.fit.profiles import Information, QuantityInformation, information, statements
from jbw.inference.space.box import Product, alone, box, log_prior_of, prior_of
from jbw.report.messages import identified

AB = Product("a_b", "a*b", {"a": 1.0, "b": 1.0}, ("a", "b"))


def linear(theta, data):
    design, values = data
    return design @ jnp.stack(list(theta.values())) - values


def of_product(theta, data):
    return data * theta["a"] * theta["b"] - 6 * data


def fitted_product():
    bounds = box({"a": (1.0, 4.0), "b": (1.0, 9.0)})
    best = costly_fit(of_product, bounds, jnp.full(25, 10.0), starts={"a": 2.0, "b": 3.0})
    return best, bounds


def test_spectrum_of_a_linear_gaussian_problem():
    design = jnp.array([[2.0, 1.0, 0.0], [0.0, 3.0, 1.0], [1.0, 0.0, 0.5], [0.3, 0.2, 4.0]])
    bounds = box({"p": (-1.0, 1.0), "q": (-2.0, 2.0), "r": (-0.5, 0.5)})
    data = (design, design @ jnp.array([0.1, 0.3, -0.2]))
    best = costly_fit(linear, bounds, data, starts={"p": 0.0, "q": 0.0, "r": 0.0})
    found = information(best, bounds)
    prior = np.diag(np.array([2.0, 4.0, 1.0]) / np.sqrt(12))
    fisher = np.asarray(design.T @ design)
    expected = np.sort(np.linalg.eigvalsh(prior @ fisher @ prior))[::-1]
    np.testing.assert_allclose([d.information for d in found.directions], expected, rtol=1e-10)
    np.testing.assert_allclose(
        [d.ratio for d in found.directions], 1 / np.sqrt(1 + expected), rtol=1e-10
    )
    # Posterior of a Gaussian prior of the box's variance.
    covariance = np.linalg.inv(fisher + np.linalg.inv(prior @ prior))
    for i, name in enumerate("pqr"):
        sd = np.sqrt(covariance[i, i])
        assert found.known[name].sd == pytest.approx(sd, rel=1e-10)
        assert found.known[name].ratio == pytest.approx(sd / prior[i, i], rel=1e-10)


def test_a_product_is_known_and_its_factors_are_not():
    best, bounds = fitted_product()
    found = information(best, bounds, [AB])
    strong, none = found.directions
    # r = 10 (a b - 6), 25 times: d r / d log(ab) = 60, so 300 in all.
    assert strong.text in ("a*b", "b*a")
    assert strong.sd == pytest.approx(1 / 300, rel=1e-3)
    assert none.information == pytest.approx(0.0, abs=1e-6 * strong.information)
    assert none.ratio == pytest.approx(1.0, abs=1e-6)
    assert found.known["a_b"].relative == pytest.approx(1 / 300, rel=1e-3)
    assert found.known["a_b"].value == pytest.approx(6.0, rel=1e-6)
    # Along a b = const both vary by sa sb / hypot(sa, sb) in logarithms.
    lower, upper = np.array([1.0, 1.0]), np.array([4.0, 9.0])
    grid = lower + (upper - lower) * (np.arange(200_000)[:, None] + 0.5) / 200_000
    sa, sb = np.std(np.log(grid), axis=0)
    assert found.known["a"].relative == pytest.approx(sa * sb / np.hypot(sa, sb), rel=1e-4)
    product = found.known["a_b"]
    times = found.known["a"].relative / product.relative
    assert set(statements(found, [AB])) >= {
        identified.directions(1, 2),
        identified.grade("known", [identified.with_error("a*b", 6.0, 0.02, 1 / 300)]),
        identified.tie("a*b", times),
    }


def test_a_bound_at_zero_takes_a_logarithm_only_where_the_data_tell_it_from_zero():
    def residual(theta, data):
        return jnp.array([data * (theta["c"] - 0.5)])

    bounds = box({"c": (0.0, 1.0)})
    for weight, prior_sd in ((100.0, 1.0), (1.0, 1 / np.sqrt(12))):
        best = costly_fit(residual, bounds, jnp.asarray(weight), starts={"c": 0.4})
        row = information(best, bounds).known["c"]
        slope = 0.5 * weight if weight == 100 else weight
        expected = 1 / np.sqrt(1 + (slope * prior_sd) ** 2)
        assert row.ratio == pytest.approx(expected, rel=1e-6)


def test_nothing_measured_leaves_every_direction_to_the_prior():
    bounds = box({"a": (1.0, 4.0), "b": (1.0, 9.0)})
    best = costly_fit(of_product, bounds, jnp.zeros(3), starts={"a": 2.0, "b": 3.0})
    found = information(best, bounds, [AB])
    assert [d.ratio for d in found.directions] == [1.0, 1.0]
    assert identified.grade("unknown", ["a", "b", "a*b"]) in statements(found, [AB])


@pytest.mark.parametrize(
    "powers", [{"a": 1.0, "b": 1.0}, {"a": 1.0, "b": -1.0}, {"a": 1.0, "b": 2.0}]
)
def test_prior_of_a_product_against_quadrature(powers):
    bounds = {"a": (2.0, 5.0), "b": (0.5, 4.0)}

    def moment(n):
        area = 3.0 * 3.5
        return dblquad(
            lambda b, a: (a ** powers["a"] * b ** powers["b"]) ** n / area, 2.0, 5.0, 0.5, 4.0
        )[0]

    mean, sd = prior_of(Product("p", "p", powers), box(bounds))
    assert mean == pytest.approx(moment(1), rel=1e-9)
    assert sd == pytest.approx(np.sqrt(moment(2) - moment(1) ** 2), rel=1e-8)


def test_a_quotient_by_a_box_from_zero_has_no_prior_variance():
    bounds = box({"a": (1.0, 2.0), "b": (0.0, 1.0)})
    quotient = Product("q", "a/b", {"a": 1.0, "b": -1.0})
    assert prior_of(quotient, bounds)[1] == np.inf
    draws = {"a": np.linspace(1.0, 2.0, 9), "b": np.linspace(0.1, 1.0, 9)}
    assert np.isnan(contraction(draws, bounds, [quotient])["q"])


def test_logarithm_of_a_product_against_quadrature():
    powers = {"a": 1.0, "b": -2.0}

    def moment(n):
        return quad_of(lambda a: (np.log(a)) ** n, 2.0, 5.0), quad_of(
            lambda b: np.log(b) ** n, 0.5, 4.0
        )

    variances = [second - first**2 for first, second in zip(moment(1), moment(2), strict=True)]
    expected = np.sqrt(variances[0] + 4 * variances[1])
    bounds = box({"a": (2.0, 5.0), "b": (0.5, 4.0)})
    assert log_prior_of(Product("q", "q", powers), bounds) == pytest.approx(expected, rel=1e-9)
    one = Product("b", "b", {"b": 1.0})
    assert log_prior_of(one, box({"b": (0.0, 7.0)})) == 1.0


def quad_of(function, lower, upper):
    return quad(function, lower, upper)[0] / (upper - lower)


def test_a_factor_known_to_a_third_in_a_box_of_decades_is_not_taken_for_known():
    bounds = box({"share": (0.002, 0.9), "softening": (0.0, 50.0)})
    quotient = Product("delta", "delta", {"softening": 1.0, "share": -1.0})
    share = np.random.default_rng(0).uniform(0.002, 0.9, 100_000)
    draws = {"share": share, "softening": 13.0 + 0.1 * np.sin(np.arange(100_000))}
    found = contraction(draws, bounds, [quotient, *map(alone, bounds.names)])
    # Of the variances of the logs, 1 of softening and 0.94 of share, the latter is left.
    variance = log_prior_of(alone("share"), bounds) ** 2
    assert found["delta"] == pytest.approx(1 / (1 + variance), abs=0.02)
    assert found["share"] == pytest.approx(0.0, abs=0.03)
    assert found["softening"] > 0.999


def test_a_product_of_strangers_is_refused():
    with pytest.raises(ConfigError, match="names b"):
        prior_of(AB, box({"a": (1.0, 2.0)}))


def test_contraction_of_a_product_of_which_nothing_is_known_is_zero():
    bounds = box({"a": (1.0, 4.0), "b": (1.0, 9.0)})
    rng = np.random.default_rng(0)
    draws = {"a": rng.uniform(1, 4, 100_000), "b": rng.uniform(1, 9, 100_000)}
    # A variance of 1e5 draws is right to about 0.5 %.
    assert contraction(draws, bounds, [AB])["a_b"] == pytest.approx(0.0, abs=0.03)
    known = {"a": draws["a"], "b": 6 / draws["a"]}
    assert contraction(known, bounds, [AB])["a_b"] == pytest.approx(1.0, abs=1e-12)


def test_cutting_a_uniform_and_a_truncated_normal():
    bounds = box({"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)})
    # Quantiles in the middles of equal probabilities: moments are right to 1e-5.
    p = (np.arange(100_000) + 0.5) / 100_000
    lower, upper = (0.0 - 0.25) / 0.2, (1.0 - 0.25) / 0.2
    normal = truncnorm(lower, upper, 0.25, 0.2)
    cut = truncnorm((0.1 - 0.25) / 0.2, upper, 0.25, 0.2)
    narrow = 0.5 + 0.02 * np.sin(np.arange(100_000))
    draws = {"a": p, "b": np.random.default_rng(0).permutation(normal.ppf(p)), "c": narrow}
    found = box_sensitivity(draws, bounds)
    assert found["a"].shift == pytest.approx(0.05 * np.sqrt(12), rel=1e-3)
    assert found["b"].shift == pytest.approx((cut.mean() - normal.mean()) / normal.std(), rel=1e-3)
    assert (found["b"].box, found["b"].end) == ("b", "lower")
    assert found["c"].shift < 0.02  # nothing of it is cut; others' cuts move it by chance alone
    following = [
        identified.follows_bound(name, found[name].shift, "lower bound of " + name) for name in "ab"
    ]
    assert sensitivity_statements(found) == [identified.box_sensitivity(following)]
    assert sensitivity_statements({"c": found["c"]}) == [identified.box_sensitivity([])]


def test_a_narrow_posterior_follows_a_bound_only_if_it_leans_on_it():
    bounds = box({"a": (0.0, 1.0)})
    p = (np.arange(100_000) + 0.5) / 100_000
    away = box_sensitivity({"a": 0.05 + 0.005 * truncnorm(-4, 4).ppf(p)}, bounds)
    assert away["a"].shift == 0.0
    half = truncnorm(0.0, 200.0, 0.0, 0.005)
    cut = truncnorm(0.8 * half.std() / 0.005, 200.0, 0.0, 0.005)
    leaning = box_sensitivity({"a": half.ppf(p)}, bounds)["a"]
    assert leaning.shift == pytest.approx((cut.mean() - half.mean()) / half.std(), rel=2e-3)
    assert (leaning.box, leaning.end) == ("a", "lower")


@pytest.mark.parametrize(
    ("relative", "ratio", "grade", "shown"),
    [
        (0.03, 0.1, "known", "p (3 %)"),
        (0.3, 0.1, "roughly", "p (30 %)"),
        (3.0, 0.1, "hardly", "p (2 +- 6)"),  # though far narrower than its box
        (0.6, 0.5, "hardly", "p (60 %)"),
        (0.03, 0.9, "unknown", "p"),
    ],
)
def test_how_well_a_parameter_is_identified(relative, ratio, grade, shown):
    row = QuantityInformation("p", 2.0, 2.0 * relative, ratio)
    found = Information(("p",), (), {"p": row})
    assert statements(found) == [identified.directions(0, 0), identified.grade(grade, [shown])]


def test_a_direction_is_named_by_all_factors_that_it_is_known_with():
    """b is 6/a, and a is its prior, of 3 %: b to 1.7 %, a*b to 0.33 %, though a moves it little."""
    bounds = box({"a": (1.94, 2.06), "b": (0.1, 100.0)})
    best = costly_fit(of_product, bounds, jnp.full(25, 10.0), starts={"a": 2.0, "b": 3.0})
    found = information(best, bounds, [AB])
    strong = found.directions[0]
    assert abs(strong.loadings[0]) < 0.3 * abs(
        strong.loadings[1]
    )  # in prior deviations a is slight
    assert strong.text == "b*a"
    assert strong.sd == pytest.approx(1 / 300, rel=1e-2)  # the prior of b adds 1e-6 of its own
    a = np.linspace(1.94, 2.06, 100_001)
    assert found.known["b"].relative == pytest.approx(
        np.hypot(np.std(np.log(a)), 1 / 300), rel=1e-2
    )

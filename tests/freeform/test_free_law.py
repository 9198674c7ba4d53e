"""The law without a form: its likelihood, its draws, and what readings of known joints say."""

import numpy as np
import pytest

from jbw.errors import ConfigError, DataError
from jbw.freeform.free_law import FreeLaw, free_law
from jbw.freeform.posterior import posterior_of
from jbw.freeform.prior import iwan_prior
from jbw.freeform.rows import rows_of
from jbw.freeform.sliders import grid_for, loss_share, stiffness_share
from jbw.freeform.tempering import _Swarm, _trajectory, temper
from jbw.measurement.readings.statement import RecordTable

HZ, ZETA, OWN = 100.0, 2e-3, 3e-5
HALF_WIDTHS = np.geomspace(1e-3, 3.0, 400)


def truth(y, rule=1.0):
    """Frequency and damping of sliders of uniform density; `rule` scales the loss alone."""
    w = 0.02 * np.gradient(HALF_WIDTHS)
    y = np.asarray(y)[:, None]
    omega_sq = 1 - (1 - stiffness_share(y, HALF_WIDTHS)) @ w
    loss = 2 * ZETA * np.sqrt(omega_sq) + rule * loss_share(y, HALF_WIDTHS) @ w
    return HZ * np.sqrt(omega_sq), loss / (2 * omega_sq)


def tables(seed=0, rule=1.0, own=OWN, count=5):
    """Readings of records, with the errors that they state."""
    rng = np.random.default_rng(seed)
    made = []
    for top in np.linspace(0.5, 1.0, count):
        y = top * np.geomspace(0.1, 1.0, 12)
        hz, zeta = truth(y, rule)
        covariances = np.diag((3e-3 * zeta * hz) ** 2), np.diag((0.01 * zeta) ** 2)
        noise = [rng.multivariate_normal(np.zeros(12), c) for c in covariances]
        shifted = (hz + noise[0]) * (1 + own * rng.standard_normal())
        made.append(RecordTable(y, shifted, zeta + noise[1], *covariances))
    return made


@pytest.fixture(scope="module")
def law():
    return free_law(tables(), named=False, seed=1, num_particles=200)


def test_the_likelihood_is_that_of_the_whole_covariance():
    """Terms and offsets integrated out agree with a dense Gaussian of everything."""
    rows = rows_of(tables(count=3))
    posterior = posterior_of(rows, "power", ("cubic",))
    scale = 2.0 * (np.ptp(rows.stiffness) + rows.loss.max())
    theta = np.array([[-8.0, 1.0, np.log(4e-3), np.log(3e-5)], [-7.5, 0.8, np.log(3e-3), -12.0]])
    num = len(rows.y)
    found, dense = posterior.log_likelihood(theta), []
    for row in theta:
        w = posterior.prior.strengths(row[None, :-1])
        made = np.concatenate([
            -rows.grid.softening(rows.y) @ w.of_stiffness[0],
            rows.grid.loss(rows.y) @ w.of_loss[0] + w.viscous[0] * rows.omega,
        ])  # fmt: skip
        cubic = np.concatenate([(rows.y / rows.y.max()) ** 2, np.zeros(num)])
        stiff = np.concatenate([np.ones(num), np.zeros(num)])
        covariance = (
            rows.covariance + np.exp(2 * row[-1]) * rows.own @ rows.own.T
            + scale**2 * np.outer(cubic, cubic)
        )  # fmt: skip
        information = float(stiff @ np.linalg.solve(covariance, stiff))
        left = rows.values - made
        left = left - stiff * float(stiff @ np.linalg.solve(covariance, left)) / information
        squares = left @ np.linalg.solve(covariance, left)
        volume = np.linalg.slogdet(covariance)[1] + np.log(information)
        dense.append(-0.5 * (squares + volume + (2 * num - 1) * np.log(2 * np.pi)))
    # The condition of the covariance is 1e10: 1e-6 of the squares.
    np.testing.assert_allclose(found, dense, rtol=1e-4)


def test_rows_have_the_covariance_of_their_definition():
    """Stiffness is (2 pi f)^2 and loss 2 zeta (2 pi f)^2, over one unit: slopes by hand."""
    tops = tables(count=2)
    rows = rows_of(tops)
    picked = [[0, 3, 7, 11]] * 2
    hz, zeta = (
        np.concatenate([getattr(t, name)[p] for t, p in zip(tops, picked, strict=True)])
        for name in ("hz", "zeta")
    )
    omega_sq = (2 * np.pi * hz) ** 2
    assert rows.unit == pytest.approx(omega_sq.mean(), rel=1e-14)
    assert rows.loss == pytest.approx(2 * zeta * omega_sq / rows.unit, rel=1e-14)
    by_hz, by_zeta = 2 * omega_sq / hz / rows.unit, 2 * omega_sq / rows.unit
    slopes = np.block([
        [np.diag(by_hz), np.zeros((8, 8))], [np.diag(2 * zeta * by_hz), np.diag(by_zeta)]
    ])  # fmt: skip
    errors = (3e-3 * zeta * hz) ** 2 + (1e-6 * hz) ** 2, (0.01 * zeta) ** 2 + (3e-3 * zeta) ** 2
    expected = slopes @ np.diag(np.concatenate(errors)) @ slopes.T
    # Tables state the errors of the true damping, which readings of 1 % miss by 3 % at the most.
    assert rows.covariance / rows.inflation == pytest.approx(expected, rel=0.1)
    # A relative change of a record's frequency changes its omega^2 by twice as much.
    assert rows.own[:8].sum(axis=1) == pytest.approx(2.0)


def test_the_curve_of_viscous_damping_alone_has_its_ratio():
    table = tables(count=1)[0]._replace(hz=np.full(12, HZ), zeta=np.full(12, ZETA))
    posterior = posterior_of(rows_of([table]), "linear")
    draw = np.array([[np.log(2 * ZETA), -20.0]])
    hz, zeta = posterior.curves(draw, [0.1, 2.0], np.random.default_rng(0))
    # The linear coefficient is drawn within the errors of the readings, 2e-6 of the frequency.
    assert hz[0] == pytest.approx([HZ, HZ], rel=2e-5)
    assert zeta[0] == pytest.approx([ZETA, ZETA], rel=2e-5)


def test_iwans_law_ends_within_the_bin_of_its_largest_half_width():
    grid = grid_for(0.1, 1.0)
    cut = grid.log_d[20] + 0.25 * grid.width  # three quarters of the bin lie below
    strengths = iwan_prior(grid, 0.0).strengths(np.array([[-3.0, 0.0, 0.0, cut, -60.0]]))
    share = strengths.of_stiffness[0] / np.exp(-3.0)
    assert share[18:23] == pytest.approx([1.0, 1.0, 0.75, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("prior", ["free", "loose", "iwan4"])
def test_slopes_are_those_of_the_likelihood(prior):
    posterior = posterior_of(rows_of(tables()), prior, ("cubic", "quadratic_damping"))
    rng = np.random.default_rng(2)
    theta = posterior.mean + 0.2 * posterior.sd * rng.standard_normal((2, len(posterior.mean)))
    _, slopes = posterior.with_slopes(theta)
    steps = 1e-5 * np.eye(theta.shape[1])
    central = [
        (posterior.log_likelihood(theta + h) - posterior.log_likelihood(theta - h)) / 2e-5
        for h in steps
    ]
    # Central differences are exact to 1e-9 of the largest; the slopes of few parameters are
    # one-sided differences themselves, to 1e-5.
    scale = np.abs(slopes).max()
    np.testing.assert_allclose(slopes, np.transpose(central), atol=1e-4 * scale)


def test_draws_and_evidence_of_a_gaussian_are_exact():
    """A likelihood N(1, 0.1) of the first of ten parameters, against the closed form."""

    def likelihood(theta):
        left = (theta[:, 0] - 1.0) / 0.1
        slopes = np.zeros_like(theta)
        slopes[:, 0] = -left / 0.1
        return 7.0 - 0.5 * left**2, slopes

    drawn = temper(likelihood, np.zeros(10), np.ones(10), np.random.default_rng(0), 1000)
    variance = 1 / (1 + 1 / 0.1**2)
    exact = 7.0 + 0.5 * np.log(variance) - 0.5 / (1 + 0.1**2)
    # A thousand particles: 0.04 nats, and 3 % of the standard deviation, one standard deviation.
    assert drawn.log_evidence == pytest.approx(exact, abs=0.2)
    assert drawn.theta[:, 0].mean() == pytest.approx(100 * variance, abs=0.2 * variance**0.5)
    assert drawn.theta[:, 0].std() == pytest.approx(variance**0.5, rel=0.12)
    assert drawn.theta[:, 1:].std() == pytest.approx(1.0, rel=0.05)


def test_a_trajectory_keeps_the_energy_to_the_square_of_its_step():
    """Leapfrog's steps are symmetric: of a Gaussian hardly a short trajectory is refused."""

    def density(z):
        return _Swarm(z, -0.5 * np.sum((2 * z) ** 2, axis=1), -4 * z)

    rng = np.random.default_rng(0)
    swarm = density(rng.standard_normal((500, 10)) / np.sqrt(5))
    accepted = [_trajectory(swarm, density, 1.0, np.eye(10), h, rng)[1] for h in (0.1, 0.025)]
    # A quarter of the step leaves a sixteenth of the refusals.
    assert 1 - accepted[0] < 0.02
    assert 1 - accepted[1] < (1 - accepted[0]) / 8


@pytest.mark.parametrize(
    ("nats", "rule"), [(5.0, "broken"), (4.9, "open"), (-4.9, "open"), (-5.0, "holds")]
)
def test_masings_rule_is_called_from_five_nats(nats, rule):
    assert FreeLaw(rows_of(tables(count=1)), {}, nats, {}).rule == rule


def test_bands_contain_the_truth_and_widen_where_no_readings_are(law):
    at = np.array([0.02, 0.1, 0.3, 1.0, 1.5, 3.0])
    for band, true in zip(law.bands(at), truth(at), strict=True):
        assert np.all((band[0] <= true) & (true <= band[2]))
    width = np.diff(law.bands(at)[1][::2], axis=0)[0]
    assert width[4] > 3 * width[3]
    assert width[5] > 2 * width[4]


def test_no_law_of_masing_has_less_damping_than_the_bound(law):
    at = np.array([0.1, 0.5, 1.0, 1.5, 3.0])
    least = law.least_damping(at)
    assert np.all(least <= truth(at)[1])
    assert least[2] > 0.9 * truth(at[2:3])[1][0]  # within the readings the bound is close


def test_masings_rule_is_not_doubted_where_it_holds(law):
    assert law.rule != "broken"


def test_masings_rule_is_called_broken_where_the_loss_is_half_of_its():
    broken = free_law(tables(rule=0.4), named=False, seed=1, num_particles=150)
    assert broken.rule == "broken"
    assert broken.masing > 5


def test_the_scatter_between_records_is_learned(law):
    assert law.scatter == pytest.approx(OWN, rel=0.8)  # of five records
    none = free_law(tables(own=0.0), named=False, num_particles=150)
    # Readings tell 3e-3 zeta / sqrt(4) = 3e-6 of a record's frequency.
    assert none.scatter < 1e-5


def test_named_laws_stand_beside_it():
    named = free_law(tables(), seed=3, num_particles=120)
    assert {"linear", "masing_power", "iwan4 + cubic", "free", "loose"} <= set(named.log_evidence)
    assert named.log_evidence["linear"] < named.log_evidence["free"] - 20
    # The truth is a power law: it has the most evidence, within what the particles tell.
    assert named.log_evidence["masing_power"] > max(named.log_evidence.values()) - 4


def test_too_few_readings_are_refused_with_their_number():
    few = [table._replace(**{n: getattr(table, n)[:2] for n in ("y", "hz", "zeta")},
                          hz_covariance=table.hz_covariance[:2, :2],
                          zeta_covariance=table.zeta_covariance[:2, :2])
           for table in tables(count=1)]  # fmt: skip
    with pytest.raises(DataError, match="4 amplitudes or more, but has only 2"):
        free_law(few)


def test_readings_that_are_no_numbers_are_refused():
    (table,) = tables(count=1)
    broken = table._replace(hz=np.where(np.arange(12) == 0, np.nan, table.hz))
    with pytest.raises(DataError, match="positive amplitudes"):
        free_law([broken])


def test_an_unknown_term_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"`terms` must not contain .*'qubic'"):
        posterior_of(rows_of(tables()), "free", ("qubic",))

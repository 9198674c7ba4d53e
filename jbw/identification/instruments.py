r"""The uncertainty from errors of a recorder's clock and of sensor calibration.

No record shows these errors. A clock error stretches time by $\lambda$. A sensor of the p-th
derivative of the displacement whose readings are too small by a factor s stretches lengths by

$$\ell = s\,\lambda^p,$$

and a joint in these units explains the same records: a parameter of unit $m^a s^b$ becomes $\ell^a
\lambda^b$ times as large, a gain $\ell\,\lambda^{-2}$ times, over the factor of the source's own
sensor. If the displacement is prescribed, only forces determine time, $\lambda^2 = \ell / s_F$.
Factors are drawn log-normally, one of each per draw of the posterior. A stated gain stays fixed;
the rest $e^\eta$ of its factor moves the parameters by the Gauss-Newton step

$$\Delta\theta = J^+\,\frac{\partial r}{\partial \log g}\,\eta.$$
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.campaign.tables import Instruments
from jbw.identification.joint import law_variables
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.summary import shape_of
from jbw.measurement.records import INPUTS, RESPONSES, Test
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.drives import plain
from jbw.oscillator.laws import laws_named
from jbw.quantities import GAINS, derivative_order
from jbw.report.messages import instruments as messages
from jbw.results.attributes import StoredVariable

# powers of length and time in each unit
POWER = {"m": (1, 0), "s": (0, 1), "rad": (0, 0), "1": (0, 0)}
STEP = 1e-4  # relative step of a stated gain in a finite difference


class Factors(NamedTuple):
    """Ratios of true to recorded time, length and gain for every draw."""

    time: Float[np.ndarray, "..."]
    length: Float[np.ndarray, "..."]
    gain: Float[np.ndarray, "..."]


class Sensors(NamedTuple):
    """The measured quantities that all fitted tests have in common; empty if there are none."""

    response: str
    source: str
    is_prescribed: bool


def sensors_of(tests: Sequence[Test]) -> Sensors | None:
    """Return the measured quantities of a campaign; None if its tests have no common quantity."""
    tests = [test for test in tests if test.records]
    prescribed = {test.traits.is_prescribed for test in tests}
    if prescribed == {True}:
        return Sensors("displacement", "restoring_force", is_prescribed=True)
    responses = {
        role
        for test in tests
        for role in RESPONSES
        if not test.traits.is_prescribed and role in test.records[0].channels
    }
    driven = [
        test.records[0]
        for test in tests
        if test.traits.is_driven and not set(INPUTS).isdisjoint(test.records[0].channels)
    ]
    sources = {record.source for record in driven}
    if True in prescribed or len(responses) != 1 or len(sources) > 1:
        return None
    (response,) = responses
    return Sensors(response, next(iter(sources), ""), is_prescribed=False)


def factors_of(
    rng: np.random.Generator, shape: tuple[int, ...], stated: Instruments, sensors: Sensors
) -> Factors:
    """Draw errors of clock and calibration, one set for each draw of a posterior."""

    def drawn(spread: float) -> Float[np.ndarray, "..."]:
        return np.exp(spread * rng.standard_normal(shape))

    clock = drawn(stated.fs_std)
    response, source = (
        drawn(stated.gain_std.get(role, 0.0)) for role in (sensors.response, sensors.source)
    )
    if sensors.is_prescribed:
        return Factors(np.sqrt(response / source), response, np.ones(shape))
    length = response * clock ** derivative_order(sensors.response)
    return Factors(clock, length, length / clock**2 / source)


def powers(unit: str) -> tuple[int, int] | None:
    """Return the powers of length and time in a unit such as `1/(m s^2)`; None for other units."""
    above, _, below = unit.partition("/")
    exponents = np.zeros(2, int)
    for part, sign in ((above, 1), (below.strip("()"), -1)):
        for factor in part.split():
            name, _, power = factor.partition("^")
            if name not in POWER or not re.fullmatch(r"\d*", power):
                return None
            exponents += sign * int(power or 1) * np.array(POWER[name])
    return int(exponents[0]), int(exponents[1])


def with_factors(posterior: xr.Dataset, factors: Factors, laws: Sequence[str] = ()) -> xr.Dataset:
    """Return a posterior with its draws corrected by the true factors of sensors and clock."""
    theta = {str(name): values.values for name, values in posterior.data_vars.items()}
    law_powers = [law.build(theta).powers_of_length() for law in laws_named(laws)]
    lengths = {name: power for powers_of_law in law_powers for name, power in powers_of_law.items()}
    scaled = {}
    for name, values in posterior.data_vars.items():
        exponents = powers(StoredVariable.of(values).units)
        if plain(str(name)) in GAINS:
            factor = factors.gain
        elif exponents is None or (exponents == (0, 0) and name not in lengths):
            continue
        else:
            power = exponents[0] + np.asarray(lengths.get(str(name), 0.0))
            factor = factors.length**power * factors.time ** exponents[1]
        extra = (1,) * (values.ndim - factor.ndim)
        scaled[name] = (values.dims, values.values * factor.reshape(*factor.shape, *extra))
    return posterior.assign({name: (*pair, posterior[name].attrs) for name, pair in scaled.items()})


def by_stated_gain(best: Fit, data: Dataset) -> dict[str, float]:
    """Return each parameter's derivative with respect to the logarithm of a stated gain."""
    gains = [name for name in data.held if plain(name) in GAINS]
    if not gains:
        return {}

    def rows(factor: float) -> Float[np.ndarray, " values"]:
        moved = {name: data.held[name] * factor for name in gains}
        theta = {name: jnp.asarray(value) for name, value in best.theta.items()}
        return np.asarray(stacked({**theta, **moved}, data))

    slope = (rows(np.exp(STEP)) - rows(np.exp(-STEP))) / (2 * STEP)
    size = np.linalg.norm(best.jacobian, axis=0)
    size[size == 0] = 1.0
    change = np.linalg.lstsq(best.jacobian / size, slope)[0] / size
    return dict(zip(best.theta, change.tolist(), strict=True))


def with_instruments(
    posterior: xr.Dataset,
    stated: Instruments,
    sensors: Sensors,
    *,
    seed: int,
    best: Fit | None = None,
    data: Dataset | None = None,
) -> xr.Dataset:
    """Return a posterior that includes the stated errors of clock and calibration.

    Args:
        posterior: Draws by name, with their units.
        stated: Relative standard deviations of clock and calibration errors.
        sensors: Roles of the response and source channels.
        seed: Seed of the factors.
        best: The fit, needed with `data` for a stated gain; else None.
        data: The fitted dataset, needed with `best`.
    """
    shape = shape_of(posterior)
    factors = factors_of(np.random.default_rng((seed, 36)), shape, stated, sensors)
    scaled = with_factors(posterior, factors, () if data is None else data.laws)
    moved = by_stated_gain(best, data) if best is not None and data is not None else {}
    if not moved or data is None or sensors.is_prescribed or not sensors.source:
        return scaled
    changed = {
        name: (scaled[name].dims, scaled[name].values + change * np.log(factors.gain))
        for name, change in moved.items()
        if name in scaled
    }
    corrected = scaled.assign(
        {name: (*pair, posterior[name].attrs) for name, pair in changed.items()}
    )
    derived = law_variables(corrected[list(moved)], data)
    return corrected.assign({name: values for name, values in derived.items() if name in scaled})


def instruments_sentence(stated: Instruments, sensors: Sensors | None) -> str:
    """Return the sentence on the clock and calibration errors that intervals include."""
    if not stated.is_stated:
        return messages.LEFT_OUT
    if sensors is None:
        return messages.NOT_INCLUDED
    has_clock = stated.fs_std > 0 and not sensors.is_prescribed
    included = [messages.of_clock(stated.fs_std)] if has_clock else []
    roles = (sensors.response, sensors.source)
    included += [
        f"{role} ({stated.gain_std[role]:.2g})" for role in roles if role in stated.gain_std
    ]
    lacking = [] if stated.fs_std or sensors.is_prescribed else ["`fs_std`"]
    lacking += [f"`gain_std` of {role}" for role in roles if role and role not in stated.gain_std]
    return messages.included(included, lacking)


def as_recorded(before: xr.Dataset, after: xr.Dataset) -> xr.Dataset:
    """Return the draws as they were before errors of clock and calibration were added to them."""
    return before[[name for name in before.data_vars if not before[name].equals(after[name])]]


def spread_of(
    rows: Mapping[str, Mapping[str, float]], wide: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]]:
    """Return summary rows with the mean, sd and interval that include instrument errors."""
    keys = ("mean", "sd", "cv", "q005", "q995")
    return {name: {**row, **{key: wide[name][key] for key in keys}} for name, row in rows.items()}

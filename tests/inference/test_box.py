import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import ConfigError
from jbw.inference.fit.fitting import named_starts
from jbw.inference.space.box import box, from_unit


def test_unit_coordinate_is_linear_between_the_bounds():
    b = box({"alpha": (425.0, 575.0), "zeta": (-1.0, 3.0)})
    theta = from_unit(jnp.array([[0.0, 1.0], [0.5, 0.25]]), b)
    np.testing.assert_array_equal(theta["alpha"], [425.0, 500.0])
    np.testing.assert_array_equal(theta["zeta"], [3.0, 0.0])
    np.testing.assert_allclose(named_starts(theta, b), [[0.0, 1.0], [0.5, 0.25]], rtol=1e-15)


@pytest.mark.fault(25)
@pytest.mark.parametrize(
    "pair",
    [(2.0, 1.0), (1.0, 1.0), (float("nan"), 1.0), (0.0, float("inf")), (1.0,), "ab", None],
)
def test_bounds_that_cannot_be_meant_are_refused_by_name(pair):
    with pytest.raises(ConfigError, match="`alpha`") as caught:
        box({"zeta": (0.0, 1.0), "alpha": pair})
    assert caught.value.remedy


def test_an_empty_box_is_refused():
    with pytest.raises(ConfigError, match="at least one"):
        box({})

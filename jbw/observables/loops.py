"""Force loops under a prescribed displacement: reduction, prediction."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError
from jbw.measurement.curves import forced_loop
from jbw.measurement.records import Test
from jbw.observables.joint import joint_of
from jbw.observables.repeats import Repeats, repeats
from jbw.observables.runs import run_of
from jbw.oscillator.hysteresis import hysteresis_map


class Loops(eqx.Module):
    """Prescribed displacement and restoring force of several tests.

    Attributes:
        displacement: Prescribed displacement of each test [m].
        counted: Weight of each sample: 1, or 0 while the joint forgets its start and behind the
            last sample.
        mean: Mean measured force [N].
        repeats: Their repeats.
    """

    displacement: Float[Array, "test time"]
    counted: Float[Array, "test time"]
    mean: Float[Array, "test time"]
    repeats: Repeats


def reduce(tests: Sequence[Test]) -> Loops:
    """Mean force of the repeats of each test under the same displacement.

    Args:
        tests: Tests of kind loop; `settle` seconds at the start are predicted but not compared.

    Returns:
        The loops.

    Raises:
        DataError: If repeats of one test differ in length.
    """
    found = [[forced_loop(record) for record in test.records] for test in tests]
    for test, one in zip(tests, found, strict=True):
        if len({len(loop.force) for loop in one}) > 1:
            raise DataError(
                f"Repeats of test `{test.name}` must be of one length.",
                remedy="Cut them with `span`, or make each a test of its own.",
            )
    longest = max(len(one[0].force) for one in found)

    def filled(rows: list[np.ndarray], mode: str = "constant") -> np.ndarray:
        return np.stack([np.pad(row, (0, longest - len(row)), mode) for row in rows])  # pyright: ignore

    force = [np.stack([loop.force for loop in one]) for one in found]
    counted = [
        (np.arange(rows.shape[1]) >= round(test.settle * one[0].fs)).astype(float)
        for test, one, rows in zip(tests, found, force, strict=True)
    ]
    mean = [rows.mean(axis=0) * keep for rows, keep in zip(force, counted, strict=True)]
    within = [
        np.sum((rows * keep - m) ** 2) for rows, keep, m in zip(force, counted, mean, strict=True)
    ]
    return Loops(
        displacement=jnp.asarray(
            filled([np.mean([loop.displacement for loop in one], axis=0) for one in found], "edge")
        ),
        counted=jnp.asarray(filled(counted)),
        mean=jnp.asarray(filled(mean)),
        repeats=repeats(
            within=np.array(within),
            num_repeats=np.array([len(one) for one in found]),
            sizes=np.array([keep.sum() for keep in counted]),
            longest=longest,
            labels=tuple(test.name for test in tests),
            runs=tuple(run_of(test) for test in tests),
            scale=np.array([np.sqrt(np.mean(m**2)) for m in mean]),
        ),
    )


def predict(theta: Mapping[str, Array], data: Loops) -> Float[Array, "test time"]:
    r"""Restoring force along the displacement, the joint unloaded at the start.

    $$F = m\,(k\,y + Z + f(y)), \qquad m = 1 / g$$

    Args:
        theta: The joint's parameters and `gain`, the inverse of the modal mass [1/kg].
        data: The loops.

    Returns:
        Force [N].

    Reference:
        Eqs. (1), (2).
    """
    joint = joint_of(theta)

    def force(y: Float[Array, " time"]) -> Float[Array, " time"]:
        def move(z: Array, dy: Array) -> tuple[Array, Array]:
            z = hysteresis_map(joint, z, dy)
            return z, z

        _, z = jax.lax.scan(move, jnp.zeros(()), jnp.diff(y, prepend=0.0))
        beside = 0.0 if joint.restoring is None else joint.restoring(y)
        return joint.k * y + z + beside

    return jax.vmap(force)(data.displacement) / theta["gain"]


def compare(theta: Mapping[str, Array], data: Loops) -> Float[Array, "test time"]:
    """Mean measured force of every test less its prediction."""
    return data.mean - data.counted * predict(theta, data)


def counted_of(data: Loops) -> list[np.ndarray]:
    """Which samples of each test are compared."""
    return list(np.asarray(data.counted) > 0)

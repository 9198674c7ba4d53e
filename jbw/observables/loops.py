"""Force loops under a prescribed displacement, in the likelihood."""

from collections.abc import Sequence
from functools import partial
from typing import ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.loops import readings_of_cycles
from jbw.measurement.records import Test, run_of
from jbw.observables.groups import compared, filled, repeated
from jbw.observables.observable import Laws, Observable, Shown, SteadyLines, Theta
from jbw.oscillator.oscillator import oscillator_of
from jbw.quantities import DEFAULT_LAWS

LONG = 8192  # number of samples above which neighbouring samples are averaged
# If the stiffest cycle is stiffer than the whole loop by more than this factor, use the cycle's
# stiffness.
SOFTER = 2.0
# largest step between averaged samples, relative to the largest displacement; it gives about a
# thousand values per cycle
SEEN = 0.1
# largest step between averaged samples, relative to the largest displacement: about a thousand
# values per cycle
FINEST = 6e-3


class Loops(Observable):
    """The prescribed displacement [m] and mean restoring force [N] of several tests.

    Samples are not counted while the joint still remembers its start, nor in the padding.
    """

    kinds: ClassVar[tuple[str, ...]] = ("loop",)
    suffix: ClassVar[str] = "_loop"
    dimension: ClassVar[str] = "loop"
    # Under a prescribed displacement, data determine neither damping nor modal mass.
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n"})
    stepped: ClassVar[bool] = True
    is_prescribed: ClassVar[bool] = True

    displacement: Float[Array, "test time"]

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Average the force of equally long repeats; samples in `settle` are not compared.

        Moves of the hysteresis are exact and need no steps. Samples much closer together than the
        loop bends are therefore averaged into one.
        """
        loops_by_test = [
            [forced_loop(record, test.delay) for record in test.records] for test in tests
        ]
        for test, test_loops in zip(tests, loops_by_test, strict=True):
            if len({len(loop.force) for loop in test_loops}) > 1:
                raise DataError(
                    f"Repeats of test `{test.name}` must have equal lengths.",
                    remedy="Cut the repeats with `span`, or make a separate test of each repeat.",
                )
        displacement = [
            np.mean([loop.displacement for loop in test_loops], axis=0)
            for test_loops in loops_by_test
        ]
        force = [np.stack([loop.force for loop in test_loops]) for test_loops in loops_by_test]
        blocks = [together(y) for y in displacement]
        counted = [
            (
                blocks_of(np.arange(float(rows.shape[1])), size)
                >= round(test.settle * test_loops[0].fs)
            ).astype(float)
            for test, test_loops, rows, size in zip(
                tests, loops_by_test, force, blocks, strict=True
            )
        ]
        displacement = [blocks_of(y, size) for y, size in zip(displacement, blocks, strict=True)]
        force = [blocks_of(rows, size) for rows, size in zip(force, blocks, strict=True)]
        force = [rows * keep for rows, keep in zip(force, counted, strict=True)]
        mean = [rows.mean(axis=0) for rows in force]
        data = cls(
            laws=laws,
            displacement=filled(displacement, "edge"),
            mean=filled(mean),
            groups=repeated(
                force,
                np.array([keep.sum() for keep in counted]),
                [test.name for test in tests],
                [run_of(test) for test in tests],
                longest=max(map(len, mean)),
                units=("N",) * len(tests),
                counted=filled(counted),
                spanned=zeros_of_load_cells([test.load_cell for test in tests], counted),
            ),
        )
        return (data,)

    def predict(self, theta: Theta) -> Float[Array, "test time"]:
        r"""Predict the restoring force [N] along a displacement from rest: eqs. (1), (2).

        $$F = m\,(k\,y + \sum_l F_l), \qquad m = 1 / g$$

        with the `gain` g, the inverse of the modal mass [1/kg].
        """
        joint = oscillator_of(theta, self.laws)
        return jax.vmap(joint.force_along)(self.displacement) / theta["gain"]

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates: the displacement, and the stiffness of the stiffest loop."""

        def lines() -> SteadyLines:
            return SteadyLines(np.zeros(1), np.array([secant(self) + 0j]), np.ones(1, complex))

        y_peak = float(jnp.max(jnp.abs(self.displacement)))
        return Shown(steady_lines=lines, stiffness=partial(secant, self), y_peak=y_peak)


def secant(data: Loops) -> float:
    """Return the stiffness of the stiffest loop: peak-to-peak force divided by displacement [N/m].

    If its stiffest cycle is more than twice as stiff, that is returned instead: a joint that wears
    or yields far is soft in its largest cycles.
    """
    displacement, mean = np.asarray(data.displacement), np.asarray(data.mean)
    peak_to_peak = float(np.max(np.ptp(mean, axis=1) / np.ptp(displacement, axis=1)))
    cycles = [
        of_cycle
        for i, (y, force) in enumerate(zip(displacement, mean, strict=True))
        for of_cycle in _secants(y[compared(data.groups, i)], force[compared(data.groups, i)])
    ]
    stiffest = max(cycles, default=peak_to_peak)
    return stiffest if stiffest > SOFTER * peak_to_peak else peak_to_peak


def _secants(y: Float[np.ndarray, " time"], force: Float[np.ndarray, " time"]) -> list[float]:
    """Return the secant stiffness [N/m] of each cycle whose force is well above its noise."""
    cycles = readings_of_cycles(ForcedLoop(1.0, y, force))
    strengths = [cycle.stiffness * cycle.amplitude for cycle in cycles]
    felt = SEEN * max(strengths, default=0.0)
    return [cycle.stiffness for cycle, size in zip(cycles, strengths, strict=True) if size > felt]


def zeros_of_load_cells(
    kinds: Sequence[str], counted: Sequence[np.ndarray]
) -> Float[np.ndarray, "test 2 time"] | None:
    """Return the time functions of load cells' offset and drift; None if tests have none."""
    if all(kind == "exact" for kind in kinds):
        return None
    columns = np.zeros((len(kinds), 2, max(map(len, counted))))
    for row, kind, keep in zip(columns, kinds, counted, strict=True):
        if kind != "exact":
            row[0, : len(keep)] = keep
        if kind == "drift":
            row[1, : len(keep)] = keep * np.linspace(-1.0, 1.0, len(keep))
    return columns


def together(displacement: Float[np.ndarray, " time"]) -> int:
    r"""Return how many samples to average, so that a sine moves at most 6e-3 amplitudes in them.

    Only records so long that their samples dominate the cost of a prediction are averaged. The mean
    of so few samples is below a peak by $(6\times10^{-3})^2 / 24$ of the amplitude.
    """
    if len(displacement) <= LONG:
        return 1
    moved = np.mean(np.abs(np.diff(displacement))) * np.pi / 2
    reach = np.max(np.abs(displacement))
    return max(1, int(FINEST * reach / moved)) if moved > 0 else 1


def blocks_of(
    rows: Float[np.ndarray, "*batch time"], size: int
) -> Float[np.ndarray, "*batch block"]:
    """Return the means of blocks of `size` samples; an incomplete last block is dropped."""
    count = rows.shape[-1] // size
    in_blocks = rows[..., : count * size]
    return in_blocks.reshape(*rows.shape[:-1], count, size).mean(axis=-1)

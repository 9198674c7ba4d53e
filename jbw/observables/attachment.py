r"""What a shaker's attachment foretells of another drive, as an observable.

Voltage, force and the drive point's motion tell what the armature adds to the structure, and with
that by how much natural frequency and damping differ when it is driven by voltage,

$$\omega_n' - \omega_n \sim N(\Delta\omega, s_\omega^2), \qquad
  \zeta' - \zeta \sim N(\Delta\zeta, s_\zeta^2)$$

A run's offsets move both alike, so that this says nothing of them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.groups.offsets import Estimate, known_estimate
from jbw.observables.drives import named
from jbw.observables.observable import OFFSETS, Laws, Numbers, Observable, Theta, Weighted
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import observed as messages


def label_of(drive: str) -> str:
    """What the group is called that foretells a drive."""
    return f"shaker by {drive}"


class Foretold(Observable):
    """Change of omega_n [rad/s] and zeta by the shaker of a drive, with standard deviations.

    Attributes:
        mean: Of the changes.
        std: Of the changes, known.
        directions: Of the run's offsets: none moves a change.
        fed: The drive whose shaker it is.
        run: A run of the data, which it says nothing of.
        words: How it was read.
    """

    mean: Float[Array, " own"]
    std: Float[Array, " own"]
    directions: Float[Array, "offset own"]
    fed: str = eqx.field(static=True)
    run: str = eqx.field(static=True)
    words: str = eqx.field(static=True, default="")

    @classmethod
    def of(
        cls,
        mean: Float[np.ndarray, " own"],
        std: Float[np.ndarray, " own"],
        fed: str,
        run: str,
        words: str = "",
        *,
        laws: Laws = DEFAULT_LAWS,
    ) -> Self:
        """The changes of omega_n [rad/s] and zeta that a shaker's attachment leads to."""
        none = jnp.zeros((0, len(OFFSETS)))
        return cls(jnp.asarray(mean), jnp.asarray(std), none, fed, run, words, laws=laws)

    @property
    def labels(self) -> tuple[str, ...]:
        """One group."""
        return (label_of(self.fed),)

    @property
    def runs(self) -> tuple[str, ...]:
        """Its run."""
        return (self.run,)

    def unnamed(self, numbers: Numbers) -> Self:
        """The data as programs see them: its run has a number for a name."""
        return replace(super().unnamed(numbers), run=numbers.runs[self.run], words="")

    @property
    def width(self) -> int:
        """The two changes."""
        return len(OFFSETS)

    def predict(self, theta: Theta) -> Float[Array, " own"]:
        """Changes of omega_n [rad/s] and zeta from the structure alone to that with its shaker."""
        return jnp.stack([theta[named(name, self.fed)] - theta[name] for name in OFFSETS])

    def weighted(self, theta: Theta) -> Weighted:
        """Foretold less assumed changes, in standard deviations."""
        return ((self.mean - self.predict(theta)) / self.std)[None], self.directions[None]

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """The log density of the changes; nothing of offsets."""
        residual, _ = self.weighted(theta)
        return known_estimate(residual, jnp.zeros((1, num_offsets, len(OFFSETS))))

    def linearised(self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]) -> Self:
        """With directions of the offsets, which are zero."""
        return replace(self, directions=jnp.zeros((len(OFFSETS), len(OFFSETS))))

    def statements(self, theta: Theta) -> list[str]:
        """Where the mode lies with its shaker, and where that was foretold."""
        names = [named(name, self.fed) for name in OFFSETS]
        omega, zeta = (float(theta[name]) for name in names)
        foretold = [float(theta[n] + x) for n, x in zip(OFFSETS, self.mean, strict=True)]
        return [
            messages.with_shaker(
                self.fed,
                mode_words(omega, zeta),
                mode_words(*foretold),
                mode_words(float(theta["omega_n"]), float(theta["zeta"])),
            ),
            *filter(None, [self.words]),
        ]


def mode_words(omega_n: float, zeta: float) -> str:
    """A mode in words: its frequency, and its damping in percent."""
    return f"{omega_n / (2 * np.pi):.5g} Hz ({100 * zeta:.3g} %)"

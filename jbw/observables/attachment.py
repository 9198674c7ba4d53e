r"""The predicted effect of an attached shaker on frequency and damping, as a likelihood term.

Voltage, force and motion at the drive point determine what the armature adds to the structure, and
so the change of natural frequency and damping when the structure is driven by voltage,

$$\omega_n' - \omega_n \sim N(\Delta\omega, s_\omega^2), \qquad
  \zeta' - \zeta \sim N(\Delta\zeta, s_\zeta^2)$$

A run's offsets move both equally, so that this does not constrain them.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.observables.drives import named
from jbw.observables.groups import read_before
from jbw.observables.observable import OFFSETS, KnownReading, Laws, Theta
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import observed as messages


def label_of(drive: str) -> str:
    """Return the label of the data group that predicts the shaker's effect for a drive."""
    return f"shaker by {drive}"


class Foretold(KnownReading):
    """The predicted change of omega_n [rad/s] and zeta that attaching a shaker causes.

    Attributes:
        mean: Predicted changes.
        std: Known standard deviations of the changes.
        fed: Drive whose shaker it is.
        words: Text on how the changes were determined.
    """

    moved_by_runs: ClassVar[bool] = False
    unread: ClassVar[Mapping[str, Any]] = {"words": ""}

    std: Float[Array, " own"]
    fed: str = eqx.field(static=True)
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
        """Build the likelihood term from the predicted changes of omega_n [rad/s] and zeta."""
        groups = read_before(label_of(fed), run, len(OFFSETS))
        read = jnp.asarray(mean)[None]
        return cls(jnp.asarray(std), fed, words, mean=read, groups=groups, laws=laws)

    def predict(self, theta: Theta) -> Float[Array, "1 own"]:
        """Return the changes of omega_n [rad/s] and zeta that the shaker causes."""
        return jnp.stack([theta[named(name, self.fed)] - theta[name] for name in OFFSETS])[None]

    def whitened(
        self, theta: Theta
    ) -> tuple[Float[Array, "1 own"], Float[Array, "1 offset own"], float]:
        """Return predicted changes minus the model's changes, in standard deviations."""
        return (self.mean - self.predict(theta)) / self.std, self.groups.directions, 0.0

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences that compare the predicted and the identified mode with its shaker."""
        names = [named(name, self.fed) for name in OFFSETS]
        omega, zeta = (float(theta[name]) for name in names)
        foretold = [float(theta[n] + x) for n, x in zip(OFFSETS, self.mean[0], strict=True)]
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
    """Return a text that states a mode's frequency, and its damping in percent."""
    return f"{omega_n / (2 * np.pi):.5g} Hz ({100 * zeta:.3g} %)"

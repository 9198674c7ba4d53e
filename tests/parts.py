"""As much of a kind of data as what looks at its groups alone asks for."""

import jax.numpy as jnp
import numpy as np

from jbw.observables.groups import repeated
from jbw.observables.observable import Observable, Shown


class Sized(Observable):
    """Groups of one value, with a largest displacement."""

    y_peak: float

    def shown(self, omega_n=1.0):
        return Shown(y_peak=self.y_peak)


def part_of(sizes, runs=None, y_peak=0.0):
    """Groups of responses of such sizes by label, each of a run of its own unless stated."""
    mean, names = np.array(list(sizes.values()), float), tuple(sizes)
    groups = repeated(list(mean[:, None, None]), np.ones(len(names)), names, runs or names)
    return Sized(y_peak, mean=jnp.asarray(mean[:, None]), groups=groups)

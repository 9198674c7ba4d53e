"""A minimal kind of data for code that uses only its groups."""

import jax.numpy as jnp
import numpy as np

from jbw.observables.groups import repeated
from jbw.observables.observable import Observable, Shown


class Sized(Observable):
    """Groups of one value each, with a largest displacement."""

    y_peak: float

    def shown(self, omega_n=1.0):
        return Shown(y_peak=self.y_peak)


def part_of(sizes, runs=None, y_peak=0.0):
    """Return groups of responses of given sizes by label; unless stated, each is a separate run."""
    mean, names = np.array(list(sizes.values()), float), tuple(sizes)
    groups = repeated(list(mean[:, None, None]), np.ones(len(names)), names, runs or names)
    return Sized(y_peak, mean=jnp.asarray(mean[:, None]), groups=groups)

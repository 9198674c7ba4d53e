"""What laws look like side by side: their loops, and what they leave of a record."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
import xarray as xr

from jbw.identification.evidence import Candidate
from jbw.observables import dataset
from jbw.oscillator.oscillator import oscillator_of

NUM_POINTS = 101  # of half a loop
MOST_PARTS = 100  # of a record, of which the rms is shown


def loops(named: Mapping[str, Candidate], y_peak: float) -> xr.Dataset:
    """Steady loops at the largest displacement [m]: the force beside that of the stuck spring.

    On the way down from y = Y and up again, at the fit of each law; dampers do not act so slowly.
    """
    down = y_peak * np.cos(np.linspace(0.0, np.pi, NUM_POINTS))
    force = []
    for candidate in named.values():
        theta = dataset.as_arrays(candidate.fitted.fit.theta, candidate.fitted.data)
        joint = oscillator_of(theta, candidate.laws).slow
        stuck = sum(law.stiffness() for law in joint.laws)
        if not joint.laws:
            force.append(np.zeros(2 * NUM_POINTS))
            continue
        joint_force = np.asarray(joint.force_unloading(y_peak, jnp.asarray(down)) - stuck * down)
        force.append(np.concatenate([joint_force, -joint_force]))
    return xr.Dataset(
        {
            "displacement": ("point", np.concatenate([down, -down]), {"units": "m"}),
            "force": (("law", "point"), force, {"units": "N/kg"}),
        },
        {"law": list(named)},
    )


def residuals(named: Mapping[str, Candidate], highest: str | None) -> xr.Dataset:
    """What every law leaves along one group of data, over its rms: of the highest level, if known.

    Otherwise of the group with the largest response.
    """
    data = next(iter(named.values())).fitted.data
    sizes = dataset.size_by_label(data)
    pairs = zip(data.labels, data.runs, strict=True)
    labels = [label for label, run in pairs if run == highest and label in sizes] or list(sizes)
    if not labels:
        return xr.Dataset()
    label = max(labels, key=lambda name: sizes[name])
    rows = []
    for candidate in named.values():
        residual = dataset.left_by_label(candidate.fitted.fit.residual, candidate.fitted.data)[
            label
        ]
        relative = np.abs(residual) * np.sqrt(len(residual)) / sizes[label]
        parts = np.array_split(relative, min(MOST_PARTS, len(relative)))
        rows.append([np.sqrt(np.mean(part**2)) for part in parts])
    return xr.Dataset(
        {"left": (("law", "part"), rows, {"units": "1"})}, {"law": list(named)}, {"group": label}
    )

r"""Backbones of the modes that tests drive, of a structure with several joints, by the posterior.

Bands are of draws at the shape of full stick, with K and L of `jbw.identification.joint_answers`,

$$\omega^2 = \omega_i^2 - \sum_j K_{ji}(a), \qquad
  \zeta_{eq} = \zeta_i\,\frac{\omega_i}{\omega} + \frac{\sum_j L_{ji}(a)}{2\omega^2}$$

and beside them stands the extended periodic motion at the medians, which lets the shape change.
"""

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.identification.assembled import ASSEMBLED, largest_amplitudes
from jbw.identification.joint_answers import softening_and_losses, values_of
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.dataset import Dataset, as_arrays
from jbw.oscillator.modes.assembled import seen_name
from jbw.oscillator.modes.backbone import ModalBackbone, modal_backbone
from jbw.oscillator.modes.parameters import DRIVEN, structure_of
from jbw.quantities import joints_of

BACKBONES = "backbones"
LEVELS = np.linspace(0.0, 1.0, 9)[1:]  # of the largest amplitude that was measured of a mode
NUM_HARMONICS = 3  # frequency to 1e-6, damping to 1e-4
MAX_TURNS = 2  # of a joint in a period


def backbones_group(posterior: xr.Dataset, data: Dataset) -> xr.Dataset | None:
    """Frequency, damping and shape of every driven mode against amplitude; None of one joint.

    Variables over `mode` and `level`: `displacement` at the first point, `frequency_hz` and
    `damping` with quantiles, the same `at_medians` with the shape free, and over `coordinate` their
    `shape`, the modal coordinates over that of the mode. NaN of modes that the first point hardly
    sees, and behind the end of a backbone.
    """
    modes = data.modes
    if modes is None or modes.meet != ASSEMBLED or not joints_of(data.laws):
        return None
    largest, driven = largest_amplitudes(modes, data), range(len(modes.hz))
    amplitude = np.multiply.outer(largest, LEVELS)
    omega, zeta = (
        np.array(np.broadcast_arrays(*(values_of(posterior, data, DRIVEN[i][k]) for i in driven)))
        for k in range(2)
    )
    bands = [
        _of_draws(omega, zeta, *softening_and_losses(posterior, data, at).sum(axis=1))
        for at in amplitude.T
    ]
    frequency, damping = (np.stack(rows, axis=1) for rows in zip(*bands, strict=True))
    free = [_at_medians(posterior, data, i, amplitude[i]) for i in driven]
    numbers = dict(modes.numbers)
    seen = np.abs([numbers[seen_name(i + 1)] for i in driven])
    of_levels, with_quantiles = ("mode", "level"), ("mode", "level", "quantile")
    return xr.Dataset(
        {
            "displacement": (of_levels, seen[:, None] * amplitude, {"units": "m"}),
            "frequency_hz": (with_quantiles, frequency / (2 * np.pi), {"units": "Hz"}),
            "damping": (with_quantiles, damping, {"units": "1"}),
            "frequency_at_medians": (
                of_levels, np.array([x.omega for x in free]) / (2 * np.pi), {"units": "Hz"},
            ),
            "damping_at_medians": (of_levels, np.array([x.zeta for x in free]), {"units": "1"}),
            "shape": (
                (*of_levels, "coordinate"),
                np.abs([x.shape[:, : len(driven)] for x in free]), {"units": "1"},
            ),
        },
        {
            "mode": [i + 1 for i in driven], "coordinate": [i + 1 for i in driven],
            "quantile": list(QUANTILES),
        },
    )  # fmt: skip


def _of_draws(
    omega: Float[np.ndarray, "mode draw"],
    zeta: Float[np.ndarray, "mode draw"],
    softening: Float[np.ndarray, "mode draw"],
    losses: Float[np.ndarray, "mode draw"],
) -> tuple[Float[np.ndarray, "mode quantile"], Float[np.ndarray, "mode quantile"]]:
    """Quantiles of frequency and damping of draws at one level of every mode."""
    lowered = np.sqrt(np.maximum(omega**2 - softening, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        damping = zeta * omega / lowered + losses / (2 * lowered**2)
    frequencies, dampings = (np.quantile(x, QUANTILES, axis=-1).T for x in (lowered, damping))
    return frequencies, dampings


def _at_medians(
    posterior: xr.Dataset, data: Dataset, mode: int, amplitude: Float[np.ndarray, " level"]
) -> ModalBackbone:
    """The extended periodic motion of a mode, the parameters at their medians."""
    medians = {str(n): float(np.median(x.values)) for n, x in posterior.data_vars.items()
               if x.dims == ("chain", "draw")}  # fmt: skip
    structure = structure_of(as_arrays(medians, data), data.laws)
    levels = np.where(np.isfinite(amplitude), amplitude, 0.0)
    return modal_backbone(
        structure, levels, mode=mode, num_harmonics=NUM_HARMONICS, max_turns=MAX_TURNS, may_end=True
    )

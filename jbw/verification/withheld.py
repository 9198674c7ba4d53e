"""Predictions without bands, because the law's error at their amplitude is unknown."""

from collections.abc import Iterable

import xarray as xr

from jbw.report.messages.discrepancy import WITHHELD
from jbw.verification.predictive_basis import Basis

OF_BAND = ("coverage", "num_values", "half_width")


def is_withheld(basis: Basis, amplitudes: Iterable[float]) -> bool:
    """Return whether a band is withheld, because the law's error at the amplitude is unknown."""
    discrepancy = basis.discrepancy
    return discrepancy is not None and not all(map(discrepancy.is_stated, amplitudes))


def without_band(dataset: xr.Dataset) -> xr.Dataset:
    """Return the prediction of a test without its band; attribute `noise` states the reason."""
    bands = [name for name in dataset.data_vars if "predictive" in str(name)]
    bare = dataset.drop_vars(bands)
    bare.attrs = {name: value for name, value in dataset.attrs.items() if name not in OF_BAND}
    return bare.assign_attrs(noise=WITHHELD, withheld=1)

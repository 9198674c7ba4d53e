r"""Possible errors of measurement, each with columns: the change of the data per unit of error.

A suspect is a possible error that changes the data by columns D near the fit, in addition to the
parameters' own J. One Gauss-Newton step with D, and one without, show how much of the misfit it
would explain:

$$\min_{\Delta\theta, c} |r + J\,\Delta\theta - D\,c|^2, \qquad
  1 - \frac{|r + J\,\Delta\theta - D\,c|^2}{|r + J\,\Delta\theta|^2}$$
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.residual_spectra import Row, Spectrum, real_rows
from jbw.report.messages.message import FaultText

DRIVEN = 0.1  # Input lines above this fraction of the largest line count as driven.

Columns = Float[np.ndarray, "value column"]


class Misfit(NamedTuple):
    """A fit whose residual exceeds the noise of the data.

    Attributes:
        spectra: Values, residual and spectra of each group, by label.
        missed: Labels of the groups whose residuals exceed their noise.
        theta: Parameters of the fit and held ones; `omega_n` [rad/s] and `zeta` are the mode's.
        slopes: Derivatives of the residuals, by name of an offset of a run and by label.
    """

    spectra: Mapping[str, Spectrum]
    missed: Sequence[str]
    theta: Mapping[str, float]
    slopes: Mapping[str, Mapping[str, Row]] = {}

    def error(self, label: str) -> float:
        """Return the residual of a data group, relative to the size of its data."""
        spectrum = self.spectra[label]
        return float(np.linalg.norm(spectrum.residual) / np.linalg.norm(spectrum.values))


class Suspect(NamedTuple):
    """A possible cause of a residual, represented by the changes of the data that it causes.

    Attributes:
        columns: Derivatives of the data with respect to the error's sizes, by label of the group.
        text: Function from these sizes to the text of the fault.
        label: Group whose error it is; empty for an error of all groups.
        mode: Frequency [rad/s] and damping of the suspected mode, if it is one.
    """

    columns: Mapping[str, Columns]
    text: Callable[[Reals], FaultText]
    label: str = ""
    mode: tuple[float, float] | None = None


class Cause(NamedTuple):
    """A possible cause of a residual, and the fraction of the residual that it would explain.

    Attributes:
        text: What is wrong, why it matters and what to do.
        explained: Share of the sum of squares of the misfit.
        label: Group whose error it is; empty for an error of all groups.
        mode: Frequency [rad/s], damping and residue of the mode, if it is one.
    """

    text: FaultText
    explained: float
    label: str = ""
    mode: tuple[float, float, float] | None = None


def as_columns(*rows: Row) -> Columns:
    """Return rows as columns of a real array, with imaginary parts below real parts."""
    return real_rows(np.stack(rows, axis=1))


def in_time(spectra: Mapping[str, Spectrum]) -> dict[str, Spectrum]:
    """Return the data groups that are compared sample by sample instead of line by line."""
    return {label: s for label, s in spectra.items() if not np.iscomplexobj(s.values)}


def is_driven(spectrum: Spectrum) -> np.ndarray:
    """Return a mask of the lines that the input drives."""
    return np.abs(spectrum.source) > DRIVEN * np.abs(spectrum.source).max()


def stiffness(mode: Mapping[str, float], omega: Reals) -> Complexes:
    r"""Return the dynamic stiffness of a mode, $\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega$."""
    return mode["omega_n"] ** 2 - omega**2 + 2j * mode["zeta"] * mode["omega_n"] * omega

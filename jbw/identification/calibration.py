"""What intervals leave out: errors of the recorder's clock and of the sensors' calibration."""

import numpy as np
import xarray as xr

from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.drives import plain

CLOCK = 1e-4  # what clocks of recorders are off by: 10 to 100 millionths
CALIBRATION = 0.01  # what sensitivities of sensors are known to
GAIN, FREQUENCY = "gain", "omega_n"
LEAST = {FREQUENCY: CLOCK, GAIN: CALIBRATION}


def calibration_sentences(posterior: xr.Dataset) -> list[str]:
    """What to add to intervals that are narrower than the instruments; nothing where none is.

    A sampling rate that is off by a part scales every frequency and rate by it, a sensitivity every
    displacement or force: records cannot tell either.
    """
    said = []
    for name in map(str, posterior.data_vars):
        what = plain(name)  # without its drive
        if what not in LEAST:
            continue
        low, middle, high = np.quantile(posterior[name].values, QUANTILES)
        half = float((high - low) / (2 * abs(middle))) if middle else np.inf
        if half < LEAST[what] and what == FREQUENCY:
            said.append(
                f"The 99 % interval of {name}, {1e6 * half:.2g} ppm to either side, leaves out the "
                f"error of the sampling rate, which moves it by as much: some {1e6 * CLOCK:.0f} "
                "ppm unless the recorder's clock was checked."
            )
        elif half < LEAST[what]:
            said.append(
                f"The 99 % interval of {name}, {100 * half:.2g} % to either side, leaves out the "
                f"calibration of the sensors, which moves it by as much: some "
                f"{100 * CALIBRATION:.0f} % unless they were calibrated."
            )
    return said

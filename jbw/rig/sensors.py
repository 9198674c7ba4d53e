"""Sensors and converter: what remains of an analog channel once it is a column of numbers."""

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError


def digitise(
    analog: NDArray[np.float64],
    *,
    noise_std: float,
    full_scale: float,
    bits: int,
    rng: np.random.Generator,
    channel: str = "channel",
) -> NDArray[np.float64]:
    r"""Adds white noise of the band 0 .. fs/2 and rounds to the steps of the converter.

    $$q\,\mathrm{round}\big((x_n + \sigma e_n)/q\big), \qquad q = 2^{1-b} x_\mathrm{full}$$

    With `full_scale` a power of two the values of a converter of up to 24 bits are exact in
    float32.

    Args:
        analog: The channel at the sampling instants, in its unit.
        noise_std: Rms of the sensor's noise, same unit.
        full_scale: Largest magnitude the converter takes, same unit.
        bits: Bits of the converter, sign included.
        rng: Source of the noise.
        channel: What to call it in the message.

    Returns:
        Samples as recorded.

    Raises:
        ConfigError: When the channel leaves the range of the converter.
    """
    noisy = analog + noise_std * rng.standard_normal(analog.size)
    step = full_scale * 2.0 ** (1 - bits)
    digital = np.rint(noisy / step) * step
    peak = np.abs(digital).max()
    if peak > full_scale - step:
        raise ConfigError(
            f"Channel {channel} must stay within +-{full_scale:g}, but reaches {peak:.4g}.",
            why="A converter out of its range clips, and a clipped record is worthless.",
            remedy="Lower the level or the gain, or give the preset a larger range.",
        )
    return digital

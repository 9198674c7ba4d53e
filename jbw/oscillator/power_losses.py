"""Stiffness reduction and damping of a loop whose force deficit is a power of displacement."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import gammaln


def power_losses(
    exponent: Any, xp: Any = np, log_gamma: Callable[[Any], Any] = gammaln
) -> tuple[Any, Any]:
    r"""Return exact stiffness reduction and damping over $c\,Y^q$ for a force deficit $c\,x^{1+q}$.

    $$C_s = \frac{8}{\pi} I(2q+2) \frac{1+q}{2+q}, \qquad C_d = \frac{4q}{\pi (2+q)}, \qquad
      I(n) = \int_0^{\pi/2} \sin^n = \frac{\sqrt\pi}{2}
      \frac{\Gamma((n+1)/2)}{\Gamma(n/2+1)}$$

    NumPy is used, or another module `xp` with its functions and its own logarithm of Gamma.
    """
    q = exponent
    integral = 0.5 * np.sqrt(np.pi) * xp.exp(log_gamma(q + 1.5) - log_gamma(q + 2.0))
    return 8.0 / np.pi * integral * (1.0 + q) / (2.0 + q), 4.0 / np.pi * q / (2.0 + q)

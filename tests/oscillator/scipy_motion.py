"""The motion of an oscillator under a linearly interpolated input, by SciPy alone."""

import numpy as np
from scipy.integrate import solve_ivp


def scipy_motion(force, stiffness, damping, u, fs, rate=None, memory=0.0):
    """Return y, v and a memory of rate(v, m) of y'' + d y' + k y + F(y, v, m) = u at samples."""
    state, found = np.array([0.0, 0.0, memory]), []
    for before, after in zip(u, [*u[1:], 0.0], strict=True):
        found.append(state)

        def field(t, x, before=before, after=after):
            push = before + (after - before) * t * fs
            a = push - damping * x[1] - stiffness * x[0] - force(*x)
            return [x[1], a, rate(x[1], x[2]) if rate else 0.0]

        run = solve_ivp(field, (0.0, 1.0 / fs), state, "DOP853", rtol=1e-11, atol=1e-15)
        state = run.y[:, -1]
    return np.array(found).T

"""Parameters with which tests use every law of the register, and one law of the tests."""

import equinox as eqx
import jax
import numpy as np
from guests import Bilinear

from jbw.oscillator.laws import law_named

THETA = {
    "bouc_wen": {"alpha": 497.4, "delta": 340.21, "gamma": 32.84},
    "bouc_wen_nu": {"nu_stiffness": 497.4, "nu_softening": 0.3, "nu_opening": 0.1, "nu": 0.7},
    "bwbn": {
        "bwbn_stiffness": 600.0, "bwbn_yield": 2e-3, "bwbn_n": 1.5, "bwbn_beta": 0.6,
        "bwbn_zeta_s": 0.7, "bwbn_p": 0.4, "bwbn_q": 0.1, "bwbn_psi": 0.4, "bwbn_delta_psi": 0.01,
        "bwbn_lambda": 0.4, "bwbn_delta_nu": 0.03, "bwbn_delta_eta": 0.02,
    },
    "bwbn_pinching": {
        "bwbn_stiffness": 600.0, "bwbn_yield": 2e-3, "bwbn_n": 1.5, "bwbn_beta": 0.6,
        "bwbn_zeta_s": 0.7, "bwbn_p": 0.4, "bwbn_q": 0.1, "bwbn_psi": 0.4, "bwbn_delta_psi": 0.01,
        "bwbn_lambda": 0.4,
    },
    "cubic": {"cubic": 2e7},
    "jenkins": {"stiffness_1": 600.0, "slip_1": 2e-3},
    "jenkins_3": {
        "stiffness_1": 300.0, "slip_1": 5e-4, "stiffness_2": 250.0, "slip_ratio_2": 3.0,
        "stiffness_3": 200.0, "slip_ratio_3": 8.0 / 3.0,
    },
    "gap_series": {
        "gap_stiffness": 700.0, "gap_softening": 300.0, "gap_opening": 100.0, "gap": 6e-4,
    },
    "iwan4": {"iwan_stiffness": 1500.0, "iwan_loss": 217.0, "iwan_chi": -0.3, "iwan_beta": 0.5},
    "masing_exponential": {"exponential_alpha": 497.4, "exponential_b": 373.05},
    "masing_power": {"power_loss": 120.0, "power_exponent": 0.7},
    "quadratic": {"quadratic": 8e4},
    "quintic": {"quintic": 5e11},
    "square": {"square": 8e4},
    "quadratic_damping": {"quadratic_damping": 2.0},
    "cubic_damping": {"cubic_damping": 4.0},
    "stop": {"stop_stiffness": 400.0, "stop_gap": 1.5e-3},
    "bilinear": {"bilinear_k": 600.0, "bilinear_yield": 2e-3},
}  # fmt: skip

ODD = [name for name in THETA if name != "square"]  # the laws that have a steady response


def law_of(name, theta=None):
    """Return the law with a name, with other parameters where given."""
    kind = Bilinear if name == "bilinear" else law_named(name)
    return kind.build(THETA[name] if theta is None else theta)


def as_arrays(tree):
    """Return the numbers of a law or of arguments as arrays, not as constants of a program."""
    return jax.tree.map(
        lambda x: jax.device_put(np.asarray(x, complex if np.iscomplexobj(x) else float)), tree
    )


def compiled(function):
    """Return a function of laws and numbers as one program per kind of law, whatever the numbers.

    Eager JAX compiles a program for every operation, and another one for every loop.
    """
    program = eqx.filter_jit(function)
    return lambda *arguments: program(*as_arrays(arguments))

"""The mathematics of Teloli et al., Eqs. (1)-(42), with one function per equation.

Functions are pure and work under `jit`, `vmap` and `grad`. Their docstrings state under `Reference`
which equation they compute and whether the printed one is correct; where it is wrong,
`variant="printed"` computes the printed one. `equations()` lists them all. Names load on first use,
and `import jbw` does not load this module.

Examples:
    The cubic stiffness of a joint is a function of the paper, and a table lists all functions:

    >>> import jbw; jbw.enable_x64()
    >>> from jbw import paper
    >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
    >>> print(f"{paper.smoothing(joint, 0.8e-3).lambda_3:.3g} 1/(m^2 s^2)")
    -6.8e+07 1/(m^2 s^2)
    >>> print(paper.equations()[0].function)
    jbw.BoucWen
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jbw.paper.coefficients import Smoothing as Smoothing
    from jbw.paper.coefficients import branch as branch
    from jbw.paper.coefficients import closed_loop_stiffness as closed_loop_stiffness
    from jbw.paper.coefficients import loading_force as loading_force
    from jbw.paper.coefficients import smoothed_force as smoothed_force
    from jbw.paper.coefficients import smoothing as smoothing
    from jbw.paper.coefficients import smoothing_error as smoothing_error
    from jbw.paper.coefficients import unloading_force as unloading_force
    from jbw.paper.equivalent import EquivalentResponse as EquivalentResponse
    from jbw.paper.equivalent import equivalent_acceleration as equivalent_acceleration
    from jbw.paper.equivalent import equivalent_force as equivalent_force
    from jbw.paper.equivalent import simulate_equivalent as simulate_equivalent
    from jbw.paper.equivalent import smoothed_harmonics as smoothed_harmonics
    from jbw.paper.equivalent import square_wave as square_wave
    from jbw.paper.impulse import impulse_1 as impulse_1
    from jbw.paper.impulse import impulse_2 as impulse_2
    from jbw.paper.impulse import impulse_3 as impulse_3
    from jbw.paper.kernel_responses import Lines as Lines
    from jbw.paper.kernel_responses import Terms as Terms
    from jbw.paper.kernel_responses import VolterraResponse as VolterraResponse
    from jbw.paper.kernel_responses import merge_lines as merge_lines
    from jbw.paper.kernel_responses import multinomial as multinomial
    from jbw.paper.kernel_responses import periodic_response as periodic_response
    from jbw.paper.kernel_responses import repeated_kernel as repeated_kernel
    from jbw.paper.kernel_responses import synthesize as synthesize
    from jbw.paper.kernel_responses import tone_response as tone_response
    from jbw.paper.kernel_responses import tone_terms as tone_terms
    from jbw.paper.kernel_responses import tones as tones
    from jbw.paper.kernel_responses import volterra_response as volterra_response
    from jbw.paper.kernel_responses import volterra_sums as volterra_sums
    from jbw.paper.kernels import cubic_kernel as cubic_kernel
    from jbw.paper.kernels import cubic_stiffness as cubic_stiffness
    from jbw.paper.kernels import estimated_kernel as estimated_kernel
    from jbw.paper.kernels import h1 as h1
    from jbw.paper.kernels import h3 as h3
    from jbw.paper.kernels import harmonic_amplitudes as harmonic_amplitudes
    from jbw.paper.kernels import harmonic_response as harmonic_response
    from jbw.paper.kernels import softened_receptance as softened_receptance
    from jbw.paper.kernels import third_harmonic as third_harmonic
    from jbw.paper.likelihoods import Repeats as Repeats
    from jbw.paper.likelihoods import gaussian_log_likelihood as gaussian_log_likelihood
    from jbw.paper.likelihoods import kernel_log_likelihood as kernel_log_likelihood
    from jbw.paper.likelihoods import log_posterior as log_posterior
    from jbw.paper.likelihoods import map_estimate as map_estimate
    from jbw.paper.likelihoods import repeats as repeats
    from jbw.paper.likelihoods import response_log_likelihood as response_log_likelihood
    from jbw.paper.likelihoods import with_noise as with_noise
    from jbw.paper.objectives import convergence as convergence
    from jbw.paper.objectives import kernel_constraints as kernel_constraints
    from jbw.paper.objectives import kernel_energy as kernel_energy
    from jbw.paper.objectives import kernel_objective as kernel_objective
    from jbw.paper.objectives import kernel_residual as kernel_residual
    from jbw.paper.objectives import opening_constraints as opening_constraints
    from jbw.paper.objectives import response_misfit as response_misfit
    from jbw.paper.polynomial import PolynomialOscillator as PolynomialOscillator
    from jbw.paper.polynomial import cubic_oscillator as cubic_oscillator
    from jbw.paper.polynomial import kernel_1 as kernel_1
    from jbw.paper.polynomial import kernel_2 as kernel_2
    from jbw.paper.polynomial import kernel_3 as kernel_3
    from jbw.paper.polynomial import nonlinear_force as nonlinear_force
    from jbw.paper.probing import cross_kernel as cross_kernel
    from jbw.paper.probing import kernel as kernel
    from jbw.paper.probing import leading_diagonals as leading_diagonals
    from jbw.paper.table import Equation as Equation
    from jbw.paper.table import equations as equations
    from jbw.paper.walk import STEP_SIZE as STEP_SIZE
    from jbw.paper.walk import Walk as Walk
    from jbw.paper.walk import coefficient_of_variation as coefficient_of_variation
    from jbw.paper.walk import kl_draws as kl_draws
    from jbw.paper.walk import kl_joint as kl_joint
    from jbw.paper.walk import kl_normal as kl_normal
    from jbw.paper.walk import random_walk as random_walk

# The public names of each module of this package, in the order of the paper's sections.
_NAMES = {
    "coefficients": (
        "branch", "Smoothing", "smoothing", "smoothing_error", "loading_force",
        "unloading_force", "smoothed_force", "closed_loop_stiffness",
    ),
    "equivalent": (
        "square_wave", "equivalent_force", "equivalent_acceleration", "smoothed_harmonics",
        "simulate_equivalent", "EquivalentResponse",
    ),
    "polynomial": (
        "PolynomialOscillator", "cubic_oscillator", "nonlinear_force", "kernel_1", "kernel_2",
        "kernel_3",
    ),
    "probing": ("kernel", "leading_diagonals", "cross_kernel"),
    "impulse": ("impulse_1", "impulse_2", "impulse_3"),
    "kernel_responses": (
        "tones", "tone_terms", "Terms", "multinomial", "repeated_kernel", "tone_response", "Lines",
        "merge_lines", "synthesize",
        "volterra_response", "volterra_sums", "periodic_response", "VolterraResponse",
    ),
    "kernels": (
        "h1", "h3", "cubic_kernel", "cubic_stiffness", "third_harmonic", "softened_receptance",
        "harmonic_response", "harmonic_amplitudes", "estimated_kernel",
    ),
    "likelihoods": (
        "log_posterior", "with_noise", "gaussian_log_likelihood", "map_estimate", "Repeats",
        "repeats", "kernel_log_likelihood", "response_log_likelihood",
    ),
    "objectives": (
        "kernel_residual", "kernel_objective", "kernel_constraints", "kernel_energy",
        "convergence", "response_misfit", "opening_constraints",
    ),
    "walk": (
        "random_walk", "Walk", "STEP_SIZE", "coefficient_of_variation", "kl_normal", "kl_draws",
        "kl_joint",
    ),
    "table": ("equations", "Equation"),
}  # fmt: skip
_HOME = {name: file for file, names in _NAMES.items() for name in names}

__all__ = [*_HOME]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"jbw.paper.{_HOME[name]}"), name)
    raise AttributeError(f"module 'jbw.paper' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({"__all__", "__doc__", *__all__})

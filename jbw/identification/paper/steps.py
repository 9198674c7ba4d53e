"""The steps of the identification as single calls, public as `jbw.steps`.

`linear_step` is Step 2, `fit_kernel` the fit and the prior box of Step 3, `third_order_steps` its
posterior. `jbw.identify` performs all of them in order; single steps serve to examine each one, as
the notebooks do.

Examples:
    Step 2 pools the line fits of three records; Step 3 reads the kernel (31) of each probing tone:

    >>> import jbw; jbw.enable_x64()
    >>> tests = ["noise_0p005V", "tone_5p50Hz", "tone_6p50Hz"]
    >>> noise, *tones = jbw.rig.measure(tests=tests, repeats=3).tests
    >>> linear = jbw.steps.linear_step(noise).pooled
    >>> print(f"{linear.omega_n:.2f} rad/s, {linear.zeta:.2%}")
    118.12 rad/s, 0.44%
    >>> kernels = jbw.steps.measured_kernels(tones, linear)
    >>> print([f"{abs(kernel.mean):.2g}" for kernel in kernels])
    ['1.1e-08', '3.3e-08']
"""

from jbw.identification.linear_step import linear_step
from jbw.identification.paper.kernel import log_likelihood as kernel_log_likelihood
from jbw.identification.paper.kernel import predict as predicted_kernel
from jbw.identification.paper.step3 import fit_kernel, measured_kernels, third_order_steps
from jbw.identification.shaker import read_shaker, shaker_sentence

__all__ = [
    "fit_kernel",
    "kernel_log_likelihood",
    "linear_step",
    "measured_kernels",
    "predicted_kernel",
    "read_shaker",
    "shaker_sentence",
    "third_order_steps",
]

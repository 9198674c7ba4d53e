"""Steps of the identification, one call each: what the notebooks take apart, public as `jbw.steps`.

    import jbw

    jbw.enable_x64()
    linear = jbw.steps.linear_step(noise_test).pooled               # Step 2: omega_n, zeta, gain
    step = jbw.steps.fit_kernel(key, tone_tests, linear, settings)  # Step 3: fit and prior box
    drawn = jbw.steps.third_order_steps(key, step, settings)        # its posterior, by name

`jbw.identify` takes all of them in their order; a single step is for looking at what it does.
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

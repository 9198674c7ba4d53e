"""The Silverbox on its official terms: trained on its training record, scored on its test records.

    jbw identify notebooks/campaigns/silverbox_official.toml --allow-outside --out runs/silverbox
    python notebooks/campaigns/official.py runs/silverbox

The split, the window of 50 samples from which a model may find its initial state, and the root mean
square error in millivolts are those of the benchmark's own package, nonlinear_benchmarks 0.1.2. The
joint is the draw of highest density; the offset of the output is that which it leaves on the
training record. Published numbers stand beside it with their sources.
"""

import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.io import loadmat

import jbw
from jbw.oscillator.oscillator import oscillator_of
from jbw.report.result import laws_of, read_result
from jbw.study.exported_draw import density_of

FS = 1e7 / 2**14
TRAINING = slice(40_650, 105_712)
TESTS = {"multisine": slice(105_712, 127_400), "arrow": slice(100, 40_575),
         "arrow, no extrapolation": slice(100, 32_100)}  # fmt: skip
WINDOW = 50  # samples from which the initial state may be found
# Root mean square errors in mV of the multisine and of the whole arrow.
PUBLISHED = (
    ("polynomial state space by inference and learning (freq-statespace 0.2.0)", 0.289, 0.333),
    ("gated recurrent unit (nonlinearbenchmark.org)", 1.49, 2.80),
)


def best_of(tree: Any) -> tuple[dict[str, float], tuple[str, ...]]:
    """The draw of highest density by name, and the laws."""
    best = int(np.argmax(density_of(tree)))
    draws = tree["posterior"].to_dataset().stack(one=("chain", "draw")).isel(one=best)
    return {name: float(x) for name, x in draws.items() if x.ndim == 0}, laws_of(tree)


def output(
    theta: dict[str, float],
    laws: tuple[str, ...],
    u: Float[Array, " time"],
    start: Any = (0.0, 0.0),
) -> Float[Array, " time"]:
    """Output without its offset [V], from a displacement and a velocity."""
    joint = oscillator_of(theta, laws)
    force = theta["gain"] * u
    start = jnp.asarray(start)
    return jbw.simulate(joint, force, FS, hold="band_limited", initial=start).y


def started(
    theta: dict[str, float], laws: tuple[str, ...], u: Array, y: Array
) -> Float[Array, " two"]:
    """Displacement and velocity at the start that the first samples ask for."""
    start = jnp.array([y[0], (y[1] - y[0]) * FS])
    scale = jnp.array([1.0, theta["omega_n"]])
    for _ in range(4):
        left = output(theta, laws, u, start) - y
        slopes = jax.jacfwd(partial(output, theta, laws, u))(start) * scale
        start = start - scale * jnp.linalg.lstsq(slopes, left)[0]
    return start


def main(folder: Path) -> None:
    jbw.enable_x64()
    _, tree = read_result(folder)
    theta, laws = best_of(tree)
    data = loadmat(Path(os.environ["JBW_DATA"]) / "silverbox" / "SNLS80mV.mat")
    u, y = (jnp.asarray(data[name].ravel()) for name in ("V1", "V2"))
    u_mean = jnp.mean(u[TRAINING])
    offset = jnp.mean(y[TRAINING] - output(theta, laws, u[TRAINING] - u_mean))
    print(f"laws: {', '.join(laws)}; " + ", ".join(f"{n} {x:.6g}" for n, x in theta.items()))
    print(f"{'model':75s}" + "".join(f"{name:>25s}" for name in TESTS))
    errors = []
    for where in TESTS.values():
        push, measured = u[where] - u_mean, y[where] - offset
        start = started(theta, laws, push[:WINDOW], measured[:WINDOW])
        left = (measured - output(theta, laws, push, start))[WINDOW:]
        errors.append(1e3 * float(jnp.sqrt(jnp.mean(left**2))))
    print(f"{'jbw, ' + ' and '.join(laws):75s}" + "".join(f"{e:>22.3f} mV" for e in errors))
    for name, *known in PUBLISHED:
        print(f"{name:75s}" + "".join(f"{e:>22.3f} mV" for e in known))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

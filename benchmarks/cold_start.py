"""How long does the summary of Step 3 take from the start of a process, next to `import numpyro`?

Each contender is a separate process: it reads the kernel at five tones from a file, fits, samples
and summarises it, once without compiled code and once with compiled code in the folder that
JAX_COMPILATION_CACHE_DIR names.

    python benchmarks/cold_start.py [--calls 3] [--json FILE]
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from timing import Table, Target, options, show, targets

COMMON = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from jbw.identification.paper.step3 import PAPER_HALF_WIDTH, about
from jbw.inference.space.box import box
from jbw.inference.fit.fitting import fit
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.ridge import along_ridge
from jbw.inference.posterior.summary import summarise
from jbw.identification.paper import kernel
with np.load(sys.argv[1]) as stored:
    data = kernel.KernelData(**{name: jnp.asarray(stored[name]) for name in stored.files})
prior = box({"zeta": (0.00352, 0.00528), "alpha": (424.31, 589.61), "delta": (272.80, 409.92)})
key = jax.random.key(0)
best = fit(kernel.residual, prior, data, starts=16, key=key)
place = along_ridge(best.theta, best.covariance, prior)
about = {"coordinates": place, "chain_method": "vectorized"}
tree = sample(key, kernel.log_likelihood, prior, data, **about, %s)
rows = summarise(tree, prior)
print(min(row["ess_bulk"] for row in rows.values()))
"""
CONTENDERS = {
    "import numpyro": "import numpyro",
    "fit, walk in lanes, summary": COMMON
    % 'sampler="random_walk", num_warmup=1000, num_samples=10_000',
    "fit, slices, summary": COMMON % 'sampler="elliptical_slice", num_warmup=25, num_samples=1000',
    "fit, NUTS, summary": COMMON
    % 'sampler="nuts", num_warmup=500, num_samples=500, options={"adapt_mass": True}',
}
COLUMNS = {
    "contender": "", "cold, s": ".2f", "/ import": ".2f", "kept, s": ".2f", "kept / import": ".2f",
    "ESS": ".0f",
}  # fmt: skip
TARGETS = {"fit, walk in lanes, summary": 2.5, "fit, NUTS, summary": 5.5}


def kernel_at_five_tones(relative: float = 0.01) -> dict[str, np.ndarray]:
    """Return the third-order kernel (31) at five tones, as Step 3 reduces it from eight repeats.

    Args:
        relative: Noise of one repeat relative to |H3|.
    """
    omega_n, zeta, alpha, delta = 2 * np.pi * 18.8, 0.00444, 497.4, 340.2
    omega = 2 * np.pi * np.array([5.0, 5.5, 6.0, 6.5, 6.75])
    y_peak = 10 / (omega_n**2 - omega**2)
    lambda_3 = alpha * (delta**2 / 6 - 35 * delta / (96 * y_peak))
    once, thrice = (
        1 / (omega_n**2 - (n * omega) ** 2 + 2j * zeta * omega_n * n * omega) for n in (1, 3)
    )
    h3 = -lambda_3 * once**3 * thrice
    rng = np.random.default_rng(0)
    noise = relative * np.abs(h3)
    error = noise / np.sqrt(8) * (rng.normal(size=5) + 1j * rng.normal(size=5))
    return {
        "omega": omega,
        "mean": h3 + error,
        "within": noise**2 * rng.chisquare(14, size=5),
        "num_repeats": np.full(5, 8.0),
        "noise_std": noise,
        "y_peak": y_peak,
        "omega_n": np.asarray(omega_n),
    }


def timed(code: str, data: Path, cache: Path | None) -> tuple[float, float | None]:
    """Return the wall time of a process [s], and the number of effective draws that it prints."""
    env = {name: v for name, v in os.environ.items() if not name.startswith("JAX_")}
    if cache is not None:
        env |= {
            "JAX_COMPILATION_CACHE_DIR": str(cache),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
    started = perf_counter()
    ended = subprocess.run(
        [sys.executable, "-c", code, str(data)], env=env, capture_output=True, text=True, check=True
    )
    return perf_counter() - started, float(ended.stdout) if ended.stdout.strip() else None


def main() -> None:
    arguments = options(__doc__, calls=3).parse_args()
    best: dict[str, list[float]] = {name: [np.inf, np.inf] for name in CONTENDERS}
    worth: dict[str, float | None] = {}
    with tempfile.TemporaryDirectory() as folder:
        data, cache = Path(folder) / "kernel.npz", Path(folder) / "cache"
        np.savez(data, **kernel_at_five_tones())
        for code in CONTENDERS.values():
            timed(code, data, cache)  # This run fills the cache.
        for _ in range(arguments.calls):
            for name, code in CONTENDERS.items():
                for i, kept in enumerate((None, cache)):
                    seconds, worth[name] = timed(code, data, kept)
                    best[name][i] = min(best[name][i], seconds)
    least = best["import numpyro"][0]
    rows = [
        (name, cold, cold / least, kept, kept / least, worth[name])
        for name, (cold, kept) in best.items()
    ]
    wanted = [
        Target(f"{name}, cold / import numpyro", best[name][0] / least, reach, None)
        for name, reach in TARGETS.items()
    ]
    title = "From a fresh process to the summary of Step 3"
    show([Table(title, COLUMNS, rows), targets(wanted)], ("numpyro",), arguments.json)


if __name__ == "__main__":
    main()

"""A law, a kind of test, a sampler and a finding from outside of jbw, as users write them."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jbw.identification.checks import CheckedPosterior, Outcome
from jbw.inference.posterior.finding import checked
from jbw.inference.samplers.chains import Draw, Kernel
from jbw.measurement.records import run_of
from jbw.observables.groups import repeated
from jbw.observables.observable import Observable, Shown
from jbw.oscillator.law import Law
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.parameters import Conversion, Material
from jbw.quantities import Quantity
from jbw.report.messages.message import Message


class Bilinear(Law):
    """A spring of stiffness `bilinear_k` that yields at the displacement `bilinear_yield`."""

    name: ClassVar[str] = "bilinear"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("bilinear_k", "k_b", "1/s^2", "stiffness before yield", 0.0, is_share=True),
        Quantity("bilinear_yield", "y_b", "m", "displacement at yield", 0.0),
    )
    bilinear_k: float
    bilinear_yield: float

    @classmethod
    def prior(cls, scales):
        most = 0.5 * scales.omega_n**2
        return {"bilinear_k": (1e-3 * most, most), "bilinear_yield": (1e-4, scales.y_peak)}

    def at_rest(self):
        return 0.0

    def force(self, y, v, memory):
        return memory

    def rate(self, y, v, memory):
        yields = jnp.sign(v) * memory >= self.bilinear_k * self.bilinear_yield
        return jnp.where(yields, 0.0, self.bilinear_k * v)

    def move(self, y, memory, dy):
        most = self.bilinear_k * self.bilinear_yield
        return jnp.clip(memory + self.bilinear_k * dy, -most, most)

    def convert(self, omega_n, zeta, mass):
        values = {"E": mass * self.bilinear_k, "epsyP": self.bilinear_yield}
        own = (Material("ElasticPP", tuple(values.values())),)
        return {"ElasticPP, OpenSees": Conversion(values, {"E": "N/m", "epsyP": "m"}, own)}


class RingDown(Observable):
    """Frequencies read at some amplitudes of a ring-down, a kind of test that jbw does not have."""

    kinds: ClassVar[tuple[str, ...]] = ("ring_down",)
    suffix: ClassVar[str] = "_ring_down"
    dimension: ClassVar[str] = "ring_down"
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n"})

    amplitude: jax.Array

    @classmethod
    def reduce(cls, tests, *, laws=("bouc_wen",), substeps=None):
        rows = [np.stack([r.channels["frequency"] for r in t.records]) for t in tests]
        mean = np.stack([row.mean(axis=0) for row in rows])
        amplitude = [t.records[0].channels["displacement"] for t in tests]
        of_groups = repeated(
            rows, np.full(len(tests), mean.shape[1]), [t.name for t in tests],
            [run_of(t) for t in tests], units=("Hz",) * len(tests),
        )  # fmt: skip
        return (
            cls(
                laws=laws, amplitude=jnp.asarray(np.stack(amplitude)), mean=jnp.asarray(mean),
                groups=of_groups,
            ),
        )  # fmt: skip

    def predict(self, theta):
        joint = oscillator_of(theta, self.laws)
        stiffness = jax.vmap(jax.vmap(joint.loop))(self.amplitude).stiffness
        return jnp.sqrt(joint.k + stiffness) / (2 * jnp.pi)

    def shown(self, omega_n=1.0):
        values = {"omega_n": float(2 * np.pi * np.max(self.mean)), "zeta": 0.01}
        return Shown(
            lambda: values, y_peak=float(jnp.max(self.amplitude)),
            axis=("displacement", "m"), places=np.asarray(self.amplitude),
        )  # fmt: skip


def metropolis(problem, propose, ratio):
    """Return the kernel of Metropolis' rule with independent proposals.

    `propose` draws a proposal from a key, `ratio` is the log of the posterior over the proposal
    density; both are in the whitened coordinate.
    """

    def step(state):
        w, key = state
        key, key_move, key_take = jax.random.split(key, 3)
        there = propose(key_move)
        taken = jnp.log(jax.random.uniform(key_take)) < ratio(there) - ratio(w)
        return jnp.where(taken, there, w), key

    return Kernel(
        lambda key, w: (w, key),
        step,
        lambda state: Draw(problem.theta(state[0]), {"x": jnp.zeros(())}),
    )


class AboutTheFit:
    """A sampler of independent proposals, normal about the fit and wider than its covariance."""

    class Options(NamedTuple):
        """The counts of a run of the sampler."""

        num_warmup: int = 0
        num_samples: int = 1000
        num_chains: int = 4
        chain_method: str = "sequential"

    @staticmethod
    def kernel(problem, options):
        wide, shape = 1.5, (len(problem.box.names),)
        return metropolis(
            problem,
            lambda key: wide * jax.random.normal(key, shape),
            lambda w: problem.log_density(w) + 0.5 * jnp.sum((w / wide) ** 2),
        )


STOP = 2e-2  # place of the stop of a bench [m]
BENCH_STOP = Message(
    "bench_stop",
    "The joint moves by {y_peak:.2g} m; the stop of the bench stands at {stop:g} m.",
    """
    Check: whether the fitted motion stays away from the stop of the bench.

    Remedy: drive the joint less.
    """,
    remedy="Drive the joint less: it may move by {stop:g} m.",
    question="law",
)


def motion_before_the_stop(posterior: CheckedPosterior) -> Outcome:
    """Return the finding that compares the largest fitted displacement with the stop's place."""
    y_peak = posterior.fitted.y_peak
    values = {"y_peak": y_peak, "stop": STOP}
    return Outcome(checked(BENCH_STOP.code, y_peak < STOP, values, y_peak, {"stop": STOP}))

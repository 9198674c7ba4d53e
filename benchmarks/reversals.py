"""What does a law that remembers load reversals cost, compared with Bouc-Wen's exact step?

The standard sweep passes through Iwan's law of four parameters, forward, with the gradient of its
six parameters, and for 16 sets of parameters; and through the Bouc-Wen joint of Teloli et al.
There is one step per sample; all take turns in one process.

    python benchmarks/reversals.py [--calls 31] [--json FILE]
"""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from problem import FS, NUM, U, joint
from timing import Table, Target, Times, compiled, options, show, take_turns, targets

import jbw
from jbw.oscillator.laws.iwan import Iwan4

BOUC_WEN, IWAN = "Bouc-Wen", "Iwan, four parameters"
GRADIENT, FORWARD = "the same, value and gradient of six", "the same, jacfwd of six"
LANES = "the same, 16 lanes"
NUM_LANES = 16
# omega_n and zeta as published; K_T, F_S, chi and beta of macroslip at the sweep's peak
PARAMETERS = (118.12388, 0.00444, 1500.0, 3.0, -0.3, 0.5)
COLUMNS = {"solve": "", "min, ms": ".3f", "median, ms": ".3f", "ns a sample": ".1f"}
COLUMNS |= {"/ Bouc-Wen": ".2f"}


def velocity(parameters: jax.Array, u: jax.Array) -> jax.Array:
    omega_n, zeta, *own = parameters
    return jbw.simulate(jbw.Oscillator(omega_n, zeta, (Iwan4.of_segalman(*own),)), u, FS).v


def squares(parameters: jax.Array, u: jax.Array) -> jax.Array:
    return 0.5 * jnp.sum(velocity(parameters, u) ** 2)


def measure(calls: int) -> list[Table]:
    u, one = jnp.asarray(U), jnp.asarray(PARAMETERS)
    many = one * (1.0 + 0.05 * jnp.linspace(-1.0, 1.0, NUM_LANES)[:, None])
    runs = {
        BOUC_WEN: compiled(lambda joint, u: jbw.simulate(joint, u, FS).v, joint(), u),
        IWAN: compiled(velocity, one, u),
        GRADIENT: compiled(jax.value_and_grad(squares), one, u),
        FORWARD: compiled(jax.jacfwd(squares), one, u),
        LANES: compiled(jax.vmap(velocity, (0, None)), many, u),
    }
    return summaries(take_turns(runs, calls))


def summaries(times: Mapping[str, Times]) -> list[Table]:
    """Return the table of solves, and the targets."""
    base, own = times[BOUC_WEN].least, times[IWAN].least
    rows = [
        (name, 1e3 * least, 1e3 * median, 1e9 * least / NUM, least / base)
        for name, (least, median) in times.items()
    ]
    entries = [
        Target("Iwan's law / Bouc-Wen's exact step", own / base, 1.5, 1.2),
        Target("value and gradient of six / forward", times[GRADIENT].least / own, 6.0, 3.0),
        Target("16 lanes, a lane / one run", times[LANES].least / (NUM_LANES * own), 2.0, 1.0),
    ]
    return [Table("Laws with reversals", COLUMNS, rows), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(measure(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()

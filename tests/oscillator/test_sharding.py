"""Parameter sets as lanes over two host devices, and the memory of a long record's gradient."""

import os
import subprocess
import sys

import numpy as np
import pytest
from compiling import kept_code

LANES = """
import re
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec as P
jax.config.update("jax_enable_x64", True)
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate

assert jax.device_count() == 2
mesh = Mesh(np.array(jax.devices()), ("lane",))
u = jnp.asarray(8.0 * np.sin(0.2 * np.arange(300) + 3e-4 * np.arange(300) ** 2))
paper = np.array([118.1, 0.00444, 497.4, 340.21, 32.84])
theta = jnp.asarray(paper * (1 + 0.03 * np.linspace(-1, 1, 4))[:, None])

def loss(theta, u):
    return jnp.sum(simulate(BoucWen(*theta), u, 512.0).v ** 2)

lanes = jax.vmap(jax.value_and_grad(loss), in_axes=(0, None))
split = jax.shard_map(lanes, mesh=mesh, in_specs=(P("lane"), P()), out_specs=P("lane"),
                      check_vma=False)
expected = jax.jit(lanes)(theta, u)
sharded = jax.device_put(theta, NamedSharding(mesh, P("lane")))
for name, f in (("jit", lanes), ("shard_map", split)):
    compiled = jax.jit(f).lower(sharded, u).compile()
    found = compiled(sharded, u)
    for a, b in zip(found, expected):
        scale = np.abs(np.asarray(b)).max(axis=0)
        assert np.all(np.abs(np.asarray(a) - np.asarray(b)) <= 1e-12 * scale), (name, a, b)
    text = compiled.as_text()
    words = "all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter"
    print(name, "while" in text, len(re.findall(words, text)), len(found[0].sharding.device_set))
"""

MEMORY = """
import resource, sys
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate
joint = BoucWen(*(jnp.asarray(p) for p in (118.1, 0.00444, 497.4, 340.21, 32.84)))
for seconds in map(float, sys.argv[1:]):
    u = jnp.asarray(2.0 * np.sin(0.11 * np.arange(int(seconds * 1024))))
    loss = lambda joint: jnp.sum(simulate(joint, u, 1024.0, substeps=2).v ** 2)
    value, gradient = jax.jit(jax.value_and_grad(loss))(joint)
    assert all(np.isfinite(x) for x in jax.tree.leaves((value, gradient)))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def run(script, *arguments, **environment):
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(
        command, env=os.environ | kept_code() | environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_lanes_are_shared_by_two_devices():
    out = run(LANES, XLA_FLAGS="--xla_force_host_platform_device_count=2")
    # A collective within the time loop would cost it its native call. There is none anywhere.
    assert out.split("\n")[:2] == ["jit True 0 2", "shard_map True 0 2"]


@pytest.mark.slow
def test_gradient_of_1000_seconds_stays_below_1_gibibyte():
    base, peak = map(int, run(MEMORY, "1", "1000").split())
    assert peak - base < 2**20  # in KiB


PERIOD = """
import jax, sys
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu

assert jax.device_count() == int(sys.argv[1])
law = BoucWenNu(nu_stiffness=497.4, nu_softening=0.3, nu_opening=0.1, nu=0.7)
q, theta = jnp.array([4e-3, 1e-4j]), jnp.linspace(0.0, 6.2, 32)
force = jax.jit(lambda law: law.force_over_period(q, theta, 2))(law)
print(*force.tolist())
"""


@pytest.mark.slow  # two processes, which compile
def test_period_of_a_free_exponent_is_the_same_on_two_devices():
    """Its rare branch takes the law among its operands: a bound method of traced numbers fails."""
    one, two = (
        [
            float(x)
            for x in run(PERIOD, n, XLA_FLAGS=f"--xla_force_host_platform_device_count={n}").split()
        ]
        for n in ("1", "2")
    )
    assert max(map(abs, one)) > 0.5  # of 497 * 4e-3 N/kg, where it would stick
    np.testing.assert_allclose(two, one, rtol=1e-12, atol=1e-12)  # of rounding alone

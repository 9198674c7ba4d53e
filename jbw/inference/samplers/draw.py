"""Draw by any sampler of the register, and its options: pure, for one posterior or for many."""

from typing import Any

from jaxtyping import Array, Key

from jbw.inference.samplers.chains import draw_chains
from jbw.inference.samplers.register import Sampler, module_of
from jbw.inference.samplers.sampler import Draws
from jbw.inference.space.problem import Problem


def draws_of(sampler: Sampler, key: Key[Array, ""], problem: Problem, options: Any) -> Draws:
    """Draw from a posterior by a sampler; pure, usable under `jit` and `vmap`."""
    module = module_of(sampler)
    if hasattr(module, "draw"):
        return module.draw(key, problem, options)
    return draw_chains(module.kernel, key, problem, options)


def options_of(sampler: Sampler, **given: Any) -> Any:
    """The record of options of a sampler, of those given that it has.

    Args:
        sampler: One of the register.
        given: Options by name; None, and names that it does not have, are left out.
    """
    record = getattr(module_of(sampler), sampler.options)
    known = {n: v for n, v in given.items() if n in record._fields and v is not None}
    return record(**known)

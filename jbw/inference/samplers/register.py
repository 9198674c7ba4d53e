"""The register of samplers, which can be read without loading JAX.

A sampler is a module with a record `Options` and one of three functions. The first two are pure
under `jit` and `vmap`:

    kernel(problem, options) -> Kernel          a Markov chain: first state, step, read-out
    draw(key, problem, options) -> Draws        all draws at once, with the evidence
    gather(key, problem, options, ...)          draws in rounds that can be monitored and stored

To add one, copy `elliptical_slice.py` or `importance.py`, and call `register`.
"""

from difflib import get_close_matches
from importlib import import_module
from typing import Any, NamedTuple

from jbw.errors import ConfigError


class Sampler(NamedTuple):
    """A registered sampler, whose module is imported when it draws.

    Attributes:
        name: Name in `[identify] sampler` and in `sample`.
        module: The module, or its import path.
        options: Name of the module's record of options, or of an instance of it.
        needs_fit: Whether it draws around a fit with its covariance, which is then required.
        from_prior: Whether it covers the whole box without a fit or ridge coordinates.
        ignores_fit: Whether it uses the box itself and no coordinates of a fit.
        most_parameters: Largest number of parameters; None for any number.
        draws: Numbers of warm-up steps and draws of a chain, if an evaluation steps through time.
        cheap_draws: Numbers of warm-up steps and draws of a chain, if an evaluation takes
            microseconds.
        is_fixed: Whether it always draws the requested number, as printed in a paper.
        suits_costly: Whether a comparison of samplers tries it by default if an evaluation steps
            through time.
        in_rounds: Whether rounds are planned between compiled calls, so that it samples one
            posterior at a time.
    """

    name: str
    module: Any
    options: str = "Options"
    needs_fit: bool = False
    from_prior: bool = False
    ignores_fit: bool = False
    most_parameters: int | None = None
    draws: tuple[int, int] = (1000, 1000)
    cheap_draws: tuple[int, int] = (500, 1000)
    is_fixed: bool = False
    suits_costly: bool = False
    in_rounds: bool = False

    def suits(self, num_parameters: int) -> bool:
        """Return whether the sampler supports `num_parameters` parameters."""
        return self.most_parameters is None or num_parameters <= self.most_parameters


_ROOM = "jbw.inference.samplers."
SAMPLERS: dict[str, Sampler] = {}


def register(sampler: Sampler) -> None:
    """Add a sampler to the register, or replace the one of the same name."""
    SAMPLERS[sampler.name] = sampler


for _sampler in (
    Sampler("nuts", _ROOM + "nuts", draws=(300, 1000), suits_costly=True),
    Sampler(
        "elliptical_slice", _ROOM + "elliptical_slice", needs_fit=True, draws=(25, 400),
        suits_costly=True,
    ),
    Sampler(
        "random_walk", _ROOM + "random_walk", cheap_draws=(2000, 20_000), suits_costly=True
    ),
    Sampler(
        "random_walk_paper", _ROOM + "random_walk", options="PAPER", from_prior=True,
        ignores_fit=True, draws=(85, 765), cheap_draws=(85, 765), is_fixed=True,
    ),
    Sampler(
        "importance", _ROOM + "importance", needs_fit=True, draws=(0, 1000), suits_costly=True
    ),
    Sampler(
        "amis", _ROOM + "amis", needs_fit=True, draws=(0, 1000), cheap_draws=(0, 1000),
        suits_costly=True, in_rounds=True,
    ),
    Sampler(
        "tempered_smc", _ROOM + "tempering", from_prior=True, draws=(0, 500), suits_costly=True
    ),
    Sampler("nested", _ROOM + "nested", from_prior=True, draws=(0, 500)),
    Sampler(
        "quadrature", _ROOM + "quadrature", from_prior=True, ignores_fit=True, most_parameters=4,
        draws=(0, 1000),
    ),
):  # fmt: skip
    register(_sampler)


def sampler_named(name: str) -> Sampler:
    """Return the sampler of a name; if it is unknown, raise a ConfigError with the nearest one."""
    if name in SAMPLERS:
        return SAMPLERS[name]
    near = get_close_matches(name, SAMPLERS, 1)
    raise ConfigError(
        f"Argument `sampler` must be one of {', '.join(SAMPLERS)}, not {name!r}.",
        remedy=f"Did you mean {near[0]!r}?" if near else "",
    )


def module_of(sampler: Sampler) -> Any:
    """Return the module of a sampler, imported by its path if necessary."""
    module = sampler.module
    return import_module(module) if isinstance(module, str) else module


def default_options(sampler: Sampler) -> Any:
    """Return the default options of a sampler."""
    options = getattr(module_of(sampler), sampler.options)
    return options() if isinstance(options, type) else options


def options_of(sampler: Sampler, **choices: Any) -> Any:
    """Return a sampler's options; ignore those that are None or that it does not have."""
    defaults = default_options(sampler)
    accepted = {n: v for n, v in choices.items() if n in defaults._fields and v is not None}
    return defaults._replace(**accepted)

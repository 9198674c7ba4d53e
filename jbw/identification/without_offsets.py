"""What laws would be if the runs had no offsets: these trade with softening, and both are shown."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Key

from jbw.identification.assemble import Measured, assemble
from jbw.identification.evidence import Candidate, again, alike, under
from jbw.identification.prepare import reweight


def without_offsets(
    key: Key[Array, ""], seen: Measured, found: Sequence[Candidate], best: Candidate
) -> list[Candidate]:
    """The candidates fitted again to runs that share omega_n and zeta.

    To the data as the best of them weighs these then.
    """
    settings = alike(seen.settings).model_copy(update={"offsets": "none"})
    fitted = best.fitted
    data = under(best.laws, assemble(seen), best.meet)
    data = replace(data, held=fitted.data.held)  # with the signs of modes
    ready = reweight(key, data, fitted.box, fitted.fit, settings)
    keys = jax.random.split(key, len(found))
    return [again(k, candidate, ready) for k, candidate in zip(keys, found, strict=True)]


def compared(best: Candidate, shared: Candidate) -> dict[str, Any]:
    """Parameters and error of a law with offsets of the runs and without, plain values."""
    pair = best.fitted.fit, shared.fitted.fit
    std = [np.sqrt(np.diag(fit.covariance)) for fit in pair]
    rows = {
        name: {
            "with": float(pair[0].theta[name]),
            "with_sd": float(std[0][i]),
            "without": float(pair[1].theta[name]),
            "without_sd": float(std[1][i]),
        }
        for i, name in enumerate(best.fitted.box.names)
        if name in shared.fitted.box.names
    }
    return {"parameters": rows, "error": [best.error, shared.error]}

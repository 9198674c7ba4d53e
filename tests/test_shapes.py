"""Shapes in annotations are checked at the first call and at every other, kept compiled or not."""

import sys
from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from shapes import STATE, Checking

MODULE = '''
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


def product(x: Float[np.ndarray, " time"], y: Float[np.ndarray, " time"], *, scale: float = 2.0):
    """Scaled inner product."""
    return scale * float(x @ y)


@dataclass(frozen=True)
class Motion:
    y: Float[np.ndarray, " time"]
    v: Float[np.ndarray, " time"]
'''


def loaded(path):
    spec = spec_from_file_location("checked_module", path, loader=Checking("checked_module", path))
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_shapes_are_checked_by_source_and_by_what_was_compiled_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    path = tmp_path / "checked_module.py"
    path.write_text(MODULE)
    for _ in range(2):  # the second reads what the first has compiled
        module = loaded(str(path))
        assert module.product(np.ones(3), np.ones(3)) == 6.0
        assert module.product(np.ones(3), np.ones(3), scale=1) == 3.0
        assert module.Motion(np.ones(3), np.zeros(3)).y.size == 3
        for refused in (module.product, module.Motion):
            with pytest.raises(TypeCheckError):
                refused(np.ones(3), np.ones(4))
    (kept,) = (tmp_path / "__pycache__").iterdir()
    assert STATE in kept.name  # Python, which knows no checks, reads another file

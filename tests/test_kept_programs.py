"""Programs that are kept between processes are found without tracing, and never mistaken."""

import os
import shutil
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import Compiled

import jbw
from jbw.cache import Programs
from jbw.kept_programs import KeptProgram
from jbw.observables.samples import joints_at
from jbw.oscillator import batch
from jbw.oscillator.batch import INTERVALS, LANES, released
from jbw.paper.kernels import h1

OMEGA = jnp.linspace(1.0, 3.0, 5)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="XDG_CACHE_HOME names the folder")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of kept programs, for a process that keeps them."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(Programs, "are_kept", True)
    return tmp_path / "jbw" / "programs"


def expected(omega_n, zeta):
    omega = np.asarray(OMEGA)
    return 1 / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)


def refuse(*_):
    raise AssertionError("traced again")


def test_a_kept_program_is_found_without_tracing(folder, monkeypatch):
    first = KeptProgram(h1)(OMEGA, 2.0, 0.1)
    assert len(list(folder.iterdir())) == 1
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(jax.export, "export", refuse)
    again = KeptProgram(h1)(OMEGA, 2.0, 0.1)  # a new wrapper knows no program, as a new process
    np.testing.assert_array_equal(again, first)
    np.testing.assert_allclose(first, expected(2.0, 0.1), rtol=1e-14)  # some rounding errors


def test_a_program_that_takes_its_own_results_is_compiled_once_and_kept(folder):
    """The batch solver, piece by piece, with load reversals in named tuples."""
    theta = {"omega_n": 118.0, "zeta": 0.005, "power_loss": 90.0, "power_exponent": 0.4}
    joints = joints_at(
        {name: np.array([value]) for name, value in theta.items()}, ("masing_power",)
    )
    march = partial(batch.march, joints, np.zeros(LANES), fs=1024.0, substeps=1, order=1)
    with Compiled() as compiled:
        moved = march(released(1e-3, 2 * INTERVALS)).response
    assert len([name for name in compiled if name == "jit(call)"]) == 2  # the tip and the march
    assert len(list(folder.iterdir())) == 2
    batch._marched.forget()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax.export, "export", refuse)
        again = march(released(1e-3, 2 * INTERVALS)).response
    np.testing.assert_array_equal(again, moved)


@pytest.mark.parametrize("values", [(2.0, 0.2), (3, 0.1), (2, 0.1)])
def test_each_value_that_is_no_array_has_its_own_program(folder, values):
    response = KeptProgram(h1)
    response(OMEGA, 2.0, 0.1)
    np.testing.assert_allclose(response(OMEGA, *values), expected(*values), rtol=1e-14)
    assert len(list(folder.iterdir())) == 2


def test_a_function_of_another_package_is_traced_in_each_process(folder):
    for factor in (2.0, 3.0):
        applied = KeptProgram(_applied)(lambda x, factor=factor: factor * x, OMEGA)
        np.testing.assert_array_equal(applied, factor * OMEGA)
    assert not folder.exists()


def _applied(function, x):
    return function(x)


def test_a_damaged_program_is_compiled_again_with_one_warning(folder):
    KeptProgram(h1)(OMEGA, 2.0, 0.1)
    (path,) = folder.iterdir()
    sound = path.read_bytes()
    path.write_bytes(sound[:-1] + bytes([sound[-1] ^ 1]))
    with pytest.warns(UserWarning, match="is damaged") as warned:
        again = KeptProgram(h1)(OMEGA, 2.0, 0.1)
    assert len(warned) == 1
    np.testing.assert_allclose(again, expected(2.0, 0.1), rtol=1e-14)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # The damaged file was replaced.
        KeptProgram(h1)(OMEGA, 2.0, 0.1)


@pytest.mark.usefixtures("folder")
def test_derivatives_pass_through_a_kept_function():
    response = KeptProgram(h1)

    def real(omega_n):
        return jnp.real(response(OMEGA[0], omega_n, 0.0))

    assert jax.grad(real)(2.0) == pytest.approx(-4 / 9, rel=1e-12)  # d/dx 1 / (x^2 - 1) at x = 2


def test_nothing_is_kept_unless_a_command_asks(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    KeptProgram(h1)(OMEGA, 2.0, 0.1)
    assert not list(tmp_path.iterdir())


PROBE = """
from jbw.kept_programs import KeptProgram

@KeptProgram
def probe(x):
    return {factor} * x
"""
RUN = """
import jax.numpy as jnp
from jbw.cache import Programs
from jbw.inference.probe import probe
Programs.are_kept = True
print(float(probe(jnp.ones(()))))
"""


@pytest.mark.slow
def test_an_edited_function_gives_its_new_number(tmp_path):
    source = Path(jbw.__file__).parent
    copy = tmp_path / "jbw"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
    cache = tmp_path / "cache"
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(tmp_path)}

    def printed(factor):
        (copy / "inference" / "probe.py").write_text(PROBE.format(factor=factor))
        done = subprocess.run(
            [sys.executable, "-c", RUN], env=environment, cwd=tmp_path, capture_output=True,
            text=True, check=True,
        )  # fmt: skip
        return float(done.stdout)

    assert [printed(2.0), printed(2.0), printed(3.0)] == [2.0, 2.0, 3.0]
    assert len(list((cache / "jbw" / "programs").iterdir())) == 2

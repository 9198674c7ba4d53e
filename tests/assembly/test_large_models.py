"""Sparse models: the same numbers as SciPy's own routes, in little memory."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg
from plate import plate

from jbw.assembly.dofs import weights_at
from jbw.assembly.reduce import reduce

PEAK_KB = 2e6
RUN = """
import sys
sys.path.insert(0, sys.argv[1])
from plate import plate
from jbw.assembly.reduce import reduce
model, joints, tip = plate(100, 50)
reduced = reduce(model, joints, to_hz=6000.0, input=tip, outputs={"tip": tip}, zeta=0.004)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print(model.num_dofs, reduced.num_kept, reduced.omega.size, peak)
"""


@pytest.fixture(scope="module")
def thousand():
    """A plate of some thousand degrees of freedom, K_s, the weights of its joints and reduction."""
    model, joints, tip = plate(30, 16)
    weights = np.column_stack([weights_at(j.weights, model.dofs, j.name) for j in joints])
    stuck = model.stiffness + 2e7 * scipy.sparse.csc_array(weights) @ weights.T
    found = reduce(model, joints, to_hz=12000.0, input=tip, outputs={"tip": tip}, zeta=0.004)
    assert model.num_dofs > 1000
    return model, scipy.sparse.csc_array(stuck), weights, found


def test_modes_of_a_sparse_model_are_those_of_scipy(thousand):
    model, stuck, weights, found = thousand
    num = found.num_kept
    values, vectors = scipy.sparse.linalg.eigsh(
        stuck, k=num + 1, M=model.mass, sigma=0.0, which="LM"
    )
    omega = np.sqrt(values)
    assert omega[num] > 2 * np.pi * 12000.0 >= omega[num - 1]
    np.testing.assert_allclose(found.omega[:num], omega[:num], rtol=1e-9)
    motion = np.abs(weights.T @ vectors[:, :num])
    np.testing.assert_allclose(np.abs(found.H[:, :num]), motion, atol=1e-6 * motion.max())


def test_the_flexibility_of_a_sparse_model_is_a_direct_solution(thousand):
    _, stuck, weights, found = thousand
    exact = weights.T @ scipy.sparse.linalg.spsolve(stuck, weights)
    np.testing.assert_allclose(found.flexibility, exact, rtol=1e-9)
    np.testing.assert_allclose((found.H / found.omega**2) @ found.H.T, exact, rtol=1e-9)


def test_the_freed_frequencies_of_a_sparse_model(thousand):
    """With residual modes; the first lies three octaves below the last kept mode."""
    model, _, _, found = thousand
    values = scipy.sparse.linalg.eigsh(model.stiffness, k=3, M=model.mass, sigma=0.0)[0]
    exact = np.sqrt(np.sort(values)) / (2 * np.pi)
    np.testing.assert_allclose(found.frequencies_at([0.0, 0.0])[:3], exact, rtol=1e-5)


@pytest.mark.slow  # a process of its own, whose memory is measured
def test_ten_thousand_degrees_of_freedom_take_little_memory():
    folder = str(Path(__file__).parent)
    done = subprocess.run(
        [sys.executable, "-c", RUN, folder],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    size, kept, modes, peak = map(int, done.stdout.split())
    assert size > 10_000
    assert modes == kept + 3  # residual modes of two joints and of the input
    assert peak < PEAK_KB

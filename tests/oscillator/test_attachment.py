"""A shaker's attachment against golden poles, the one-mode closed form and what cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest

from jbw.errors import ModelError
from jbw.oscillator.attachment import Attachment, attached

CASES = json.loads((Path(__file__).parents[1] / "golden_shaker.json").read_text())["cases"]


@pytest.mark.parametrize("case", CASES)
def test_poles_with_an_attachment_are_the_golden_ones(case):
    system = case["system"]
    found = attached(system["w"], system["ze"], system["phi_drive"], Attachment(**case["armature"]))
    # Eigenvalues of condition number w: 1e-12 of the golden numbers, and 1e-16 / zeta of zeta.
    np.testing.assert_allclose(found[0], case["omega"], rtol=1e-12)
    np.testing.assert_allclose(found[1], case["zeta"], rtol=1e-11)


def test_one_mode_is_the_closed_form():
    omega, zeta, shape, added = 46.24, 0.00083, 0.0412, Attachment(0.7, 34.0, 6055.0)
    grown = 1 + added.mass * shape**2
    squared = (omega**2 + added.stiffness * shape**2) / grown
    rate = (2 * zeta * omega + added.damping * shape**2) / grown
    found = attached(omega, zeta, shape, added)
    np.testing.assert_allclose(found[0], np.sqrt(squared), rtol=1e-13)
    np.testing.assert_allclose(found[1], rate / (2 * np.sqrt(squared)), rtol=1e-11)


def test_nothing_attached_and_a_node_change_nothing():
    omega, zeta = np.array([118.0, 358.0]), np.array([0.004, 0.006])
    for shape, added in (([0.9, 0.6], Attachment(0, 0, 0)), ([0, 0], Attachment(1, 2, 3))):
        found = attached(omega, zeta, shape, added)
        np.testing.assert_allclose(found, (omega, zeta), rtol=1e-11)


@pytest.mark.parametrize(
    ("omega", "shape", "added", "said"),
    [
        ([100.0], [0.5], Attachment(-5.0, 0, 0), "positive mass together"),
        ([100.0], [0.5], Attachment(0, 0, -5e4), "positive stiffness together"),
        ([100.0], [0.5], Attachment(0, 900.0, 0), "must oscillate"),
        ([100.0, 200.0], [0.5], Attachment(0, 0, 0), "one value per mode"),
        ([-100.0], [0.5], Attachment(0, 0, 0), "must be positive"),
    ],
)
def test_what_is_no_oscillator_is_refused(omega, shape, added, said):
    with pytest.raises(ModelError, match=said):
        attached(omega, np.full(len(omega), 0.01), shape, added)

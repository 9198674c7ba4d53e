"""Types of the public functions: what an editor must accept of a user, and what it must refuse."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
JOINT = "joint = jbw.BoucWen(omega_n=118.1, zeta=0.005, alpha=497.4, delta=340.2, gamma=32.8)\n"
HEAD = "import jax.numpy as jnp\nimport numpy as np\nimport jbw\n\nu = np.zeros(64)\n" + JOINT
ACCEPTED = (
    HEAD
    + """
many = jbw.BoucWen(omega_n=118.1, zeta=np.float64(0.005), alpha=jnp.ones(3), delta=1, gamma=u[0])
omega, y_peak = np.linspace(110.0, 120.0, 5), np.array([1e-3, 2e-3])
each = jbw.BoucWen(np.linspace(1.0, 2.0, 3), np.full(3, 0.005), np.array(497.4), 340.2, np.ones(3))
jbw.Oscillator(np.ones(3), np.array(0.005), [jbw.Cubic(np.ones(3)), jbw.laws.Quintic(u[0])])
jbw.Structure(np.ones(2), np.ones(2), u[:2], np.ones(2), np.ones(2), np.ones(2))
jbw.simulate(each, np.zeros((3, 64)), 1024, initial=(np.zeros(3), 0.0))
jbw.h1(omega, np.array(118.1), np.full(5, 0.005)), jbw.steady_state(each, 118.0, np.ones(3))
jbw.simulate(many, u, np.float64(1024.0), hold="band_limited", periodic=True)
jbw.simulate(joint, jnp.asarray(u), 1024.0, hold="zero", initial=(0.0, u[0]))
jbw.simulate(joint, lambda t: jnp.sin(t), 1024.0, num_samples=64)
jbw.steady_state(joint, omega, y_peak[0])
jbw.frequency_response(joint, omega, y_peak, 4)
jbw.backbone(joint, y_peak), jbw.backbone(joint, 1e-3), jbw.steady_loop(joint, y_peak)
jbw.hysteresis_map(joint, 0.0, y_peak), jbw.hysteresis_rate(joint, u, u)
jbw.h1(omega, 118.1, 0.005), jbw.h3(joint, omega, y_peak[0], variant="printed")
jbw.third_harmonic(joint, omega, 1e-3 + 0j), jbw.smoothing(joint, y_peak)
jbw.paper.branch(joint, y_peak, 1e-5, 1, order=3), jbw.paper.smoothing(joint, 1e-3, "printed")
system = jbw.paper.PolynomialOscillator(0.1, 1.0, 0.0, np.float64(-0.1))
jbw.paper.kernel(system, 0.1, omega), jbw.paper.tone_response(system, omega, u[:5], max_order=2)
jbw.paper.volterra_response(system, u, 64.0, hold="zero"), jbw.paper.square_wave(1.0, u)
jbw.paper.kernel_log_likelihood(jbw.paper.repeats(np.ones((4, 5))), np.ones(5), 0.1)
jbw.excitation.tone(1.0, 30.0), jbw.dimensionless(joint, 30.0, 1.0), jbw.shooting(joint, 30.0, 1.0)
jbw.frf(u, u, 1024.0, response="velocity"), jbw.frf(list(u), list(u), 1024.0)
jbw.frf(jbw.Record(1024.0, {"force": u, "velocity": u}, {}), "force", "velocity", window="hann")
jbw.harmonics(u, 1024.0, 30.0, 3, response="acceleration")
jbw.third_order_kernel(u, u, 1024.0, 30.0, response="velocity")
"""
)
# Every line after the head is an error.
REFUSED = (
    HEAD
    + """
jbw.simulate(joint, u, 1024.0, hold="band")
jbw.simulate(joint, u, 1024.0, substep=2)
jbw.simulate(joint, "u", 1024.0)
jbw.frf(u, u, 1024.0, response="speed")
jbw.harmonics(u, 1024.0, 30.0, 3, response="speed")
jbw.third_order_kernel(u, u, 1024.0, 30.0, response="speed")
jbw.record_frf(u, u, 1024.0, (1.0, 2.0), response="speed")
jbw.fit_attachment(u, u, u, 1024.0, (1.0, 2.0), kind="speed")
jbw.h3(joint, 30.0, 1e-3, variant="exact")
jbw.steady_state(joint, "omega", 1.0)
jbw.paper.square_wave(1.0, 0.0, "wrong")
jbw.paper.branch(joint, y_peak, 1e-5, 5)
jbw.backbone(joint, y_peak="large")
jbw.BoucWen(omega_n="118.1", zeta=0.005, alpha=497.4, delta=340.2, gamma=32.8)
jbw.Oscillator(118.1, "0.005")
"""
)


@pytest.mark.slow  # pyright reads JAX
def test_array_likes_are_accepted_and_words_that_no_option_knows_refused(tmp_path):
    (tmp_path / "accepted.py").write_text(ACCEPTED)
    (tmp_path / "refused.py").write_text(REFUSED)
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"extraPaths": [str(ROOT)]}))
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "."],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    found = {"accepted.py": {}, "refused.py": {}}
    for one in json.loads(done.stdout)["generalDiagnostics"]:
        if one["severity"] == "error":
            line = one["range"]["start"]["line"]
            found[Path(one["file"]).name].setdefault(line, one["message"])
    assert found["accepted.py"] == {}
    called = [i for i, line in enumerate(REFUSED.splitlines()) if re.match(r"jbw\.", line)]
    assert sorted(found["refused.py"]) == called

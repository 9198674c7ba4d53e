"""The page for people from MATLAB: its snippets run as one session, and say what is true."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.io import loadmat

PAGE = Path(__file__).parent.parent / "notebooks" / "from_matlab.md"


def snippets(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


pytestmark = pytest.mark.slow  # one session of a minute


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Names that the snippets left behind, and their folder."""
    folder = tmp_path_factory.mktemp("matlab")
    names = {"__name__": "page"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for i, text in enumerate(snippets("python")):
            exec(compile(text, f"{PAGE.name}, snippet {i + 1}", "exec"), names)
    return names, folder


def test_read_converts_units(session):
    names, _ = session
    i = 1
    # float64 through a .mat of millimetres a second and back: rounding of two factors.
    np.testing.assert_allclose(
        names["record"].channels["velocity"], 1e-3 * names["rec"][i]["laser"].ravel(), rtol=1e-14
    )


def test_line_fit_finds_the_joint(session):
    names, _ = session
    joint, line = names["joint"], names["line"]
    # The softening at this level is part of what is found: 1 % of omega_n, not of its error.
    assert abs(line.omega_n / joint.omega_n - 1) < 0.002
    assert abs(line.zeta / joint.zeta - 1) < 0.15
    assert abs(line.gain / 0.1 - 1) < 0.02


def test_simulate_is_what_ode45_would_give(session):
    names, _ = session
    joint, motion, force, fs = (names[name] for name in ("joint", "motion", "force", "fs"))
    times = np.arange(force.size) / fs

    def rhs(t, x):
        y, v, z = x
        u = np.interp(t, times, force)
        return [
            v,
            u - 2 * joint.zeta * joint.omega_n * v - (joint.omega_n**2 - joint.alpha) * y - z,
            joint.alpha * v - joint.gamma * abs(v) * z - joint.delta * v * abs(z),
        ]

    known = solve_ivp(
        rhs, (0, times[-1]), [0.0, 0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-12, max_step=1 / fs
    )
    scale = np.max(np.abs(known.y[0]))
    # One step a sample is good to some 1e-6 of the peak.
    np.testing.assert_allclose(np.asarray(motion.y), known.y[0], atol=1e-5 * scale)


def test_fit_and_draws_agree(session):
    names, folder = session
    found, draws = names["found"], loadmat(folder / "draws.mat")
    for i, name in enumerate(names["bounds"].names):
        sd = np.sqrt(found.covariance[i, i])
        # The posterior is close to the fit's Gaussian: a quarter of its width is far more than
        # the error of some hundred effective draws.
        assert abs(draws[name].mean() - found.theta[name]) < 0.25 * sd
        assert abs(draws[name].std() / sd - 1) < 0.25


@pytest.mark.parametrize("text", snippets("toml"))
def test_campaign_snippet_loads(session, text):
    from jbw import load_campaign

    _, folder = session
    path = folder / "beam.toml"
    path.write_text(f'[campaign]\nname = "beam"\n\n{text}', encoding="utf-8")
    (test,) = load_campaign(path).tests
    assert set(test.records[0].channels) == {"input", "velocity"}

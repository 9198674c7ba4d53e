"""The summary of a run with toy numbers, for tests of the report."""

from toy_identifiability import identifiability_summary
from toy_tree import LEVELS, TRUTH, UNITS


def parameter_facts(name, mean, sd, **more):
    facts = {"map": mean, "mean": mean, "sd": sd, "cv": sd / mean, "kl": 1.3, "unit": UNITS[name]}
    facts |= {"q005": mean - 2.576 * sd, "q995": mean + 2.576 * sd}
    facts |= {"ess_bulk": 812.4, "ess_tail": 640.2, "r_hat": 1.004}
    facts |= {"truth": TRUTH.get(name), "z": (mean - TRUTH.get(name, mean)) / sd}
    return facts | more


def result_summary():
    unmixed = {
        "code": "r_hat",
        "status": "failed",
        "reason": "The chains disagree: R-hat of delta is 4.1.",
        "number": 4.1,
        "action": "Run more draws, or take the joint route.",
    }
    joint = {
        name: parameter_facts(name, TRUTH[name] * 1.0004, sd)
        for name, sd in zip(TRUTH, (0.004, 8e-6, 2.1, 2.4, 0.3), strict=True)
    }
    paper = {
        name: parameter_facts(name, TRUTH[name] * 1.05, 0.01 * TRUTH[name], r_hat=4.1, ess_bulk=4.2)
        for name in ("zeta", "alpha", "delta")
    }
    ridge = "Only the product alpha*delta is determined, not alpha and delta by themselves."
    nothing = {"kl": None, "ess_bulk": None, "ess_tail": None, "r_hat": None}
    return {
        "campaign": "cantilever",
        "verdict": {
            "status": "not assessed",
            "findings": [
                {
                    "code": "coverage",
                    "status": "not assessed",
                    "reason": "The 99 % band of the middle level holds 97.1 % of the points.",
                    "number": 0.971,
                    "action": "Look at figure 12 near the resonance.",
                },
                {
                    "code": "r_hat",
                    "status": "ok",
                    "reason": "R-hat is at most 1.004 (delta).",
                    "number": 1.004,
                    "action": "",
                },
            ],
        },
        "look": {
            "statements": ["Nonlinear: yes, it softens."],
            "seen": ["sweep 0.1: no harmonic stands above what the fit leaves, 0.44%."],
        },
        "comparison": {
            "parameters": {
                "gamma": {
                    "cut": {"mean": 33.4, "sd": 0.1},
                    "joint": {"mean": 32.84, "sd": 0.3},
                    "sd_ratio": 3.0,
                    "difference": 1.87,
                }
            },
            "statements": ["By the cut, gamma holds only for the held alpha."],
            "wall_time_s": {"cut": 4.0, "joint": 71.0},
        },
        "identifiability": identifiability_summary(),
        "main": "joint",
        "steps": {
            "linear": {
                "verdict": {"status": "ok", "findings": []},
                "parameters": {
                    "omega_n": parameter_facts("omega_n", 118.1216, 0.0031, **nothing),
                    "zeta": parameter_facts("zeta", 0.004431, 0.000021, **nothing),
                },
                "statements": ["The linear mode is identified."],
                "wall_time_s": 1.2,
            },
            "third_order_paper": {
                "verdict": {"status": "failed", "findings": [unmixed]},
                "parameters": paper,
                "statements": [ridge],
                "correlation": {"alpha": {"alpha": 1.0, "delta": -0.994}},
                "wall_time_s": 3.1,
            },
            "joint": {
                "verdict": {"status": "ok", "findings": []},
                "parameters": joint,
                "statements": ["All five parameters are determined by the sweeps."],
                "correlation": {"alpha": {"delta": -0.97}},
                "wall_time_s": 71.0,
            },
        },
        "predictions": {
            "sweep_0p05": {"level": 0.05, "fitted": True, "coverage": 0.991, "nrmse": 0.011},
            "sweep_0p10": {"level": 0.10, "fitted": False, "coverage": 0.971, "nrmse": 0.031},
        },
        "loops": {f"loop_{level:.2f}".replace(".", "p"): {} for level in LEVELS},
        "versions": {"jbw": "0.1.0", "jax": "0.12.0", "python": "3.13.1"},
        "seed": 7,
        "inputs": {"campaign.toml": "ab" * 32, "sweep_0p05_01.h5": "cd" * 32},
        "command": "jbw identify campaign.toml --out run --seed 7",
        "wall_time_s": 83.4,
    }

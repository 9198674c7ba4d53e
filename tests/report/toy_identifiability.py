"""The identifiability of a toy joint: precise products, vague factors, parabolic profiles."""

import numpy as np
import xarray as xr

NAMES = ("omega_n", "zeta", "alpha", "delta", "gamma", "gain")
PRODUCTS = ("alpha_delta", "alpha_gamma")
CENTRE = np.array([118.12, 4.44e-3, 497.0, 340.0, 32.8, 15.0])
SD = np.array([4e-3, 8e-6, 40.0, 28.0, 2.7, 1e-2])
RATIO = np.array([1e-3, 0.01, 0.9, 0.8, 0.4, 2e-3])
TEXTS = ("omega_n", "gain", "zeta", "alpha*delta", "gamma/delta^(1/2)", "delta/alpha")


def variable(dims, values, units="1", long_name="toy"):
    return (dims, np.asarray(values), {"units": units, "long_name": long_name})


def identifiability_group():
    z = np.linspace(-3.0, 3.0, 9)
    rise = np.tile(z**2, (6, 1))
    rise[2:4] = np.minimum(rise[2:4], 1.5)  # These profiles are open on both sides.
    values = CENTRE[:, None] + SD[:, None] * z
    loadings = np.eye(6)
    loadings[3, 2:4] = loadings[5, 2:4] = np.sqrt(0.5)
    variables = {
        "direction_text": variable("direction", list(TEXTS)),
        "direction_information": variable("direction", np.sort(RATIO) ** -2.0 - 1),
        "direction_ratio": variable("direction", np.sort(RATIO)),
        "loadings": variable(("direction", "parameter"), loadings),
        "cost": variable("start", [412.0, 412.3, 980.0]),
        "profile_value": variable(("parameter", "point"), values, "unit of the parameter"),
        "profile_chi_square": variable(("parameter", "point"), rise),
    }
    for dim, ratio in (("parameter", RATIO), ("combination", np.array([0.01, 0.02]))):
        variables[f"{dim}_relative"] = variable(dim, 0.3 * ratio)
        variables[f"{dim}_ratio"] = variable(dim, ratio)
        variables[f"{dim}_contraction"] = variable(dim, 1 - 0.9 * ratio**2)
        variables[f"{dim}_shift"] = variable(dim, 0.17 * ratio)
    return xr.Dataset(variables, {"parameter": list(NAMES), "combination": list(PRODUCTS)})


def known(text, ratio):
    return {"text": text, "value": 1.0, "sd": ratio, "relative": 0.3 * ratio, "ratio": ratio}


def identifiability_summary():
    parameters = dict(zip(NAMES, map(known, NAMES, RATIO.tolist()), strict=True))
    products = {name: known(name.replace("_", "*"), 0.01) for name in PRODUCTS}
    return {
        "statements": ["Known: alpha*delta to 0.3 %.", "Not known beyond the prior: <alpha>."],
        "spectrum": [
            {"combination": text, "information": 1 / r**2 - 1, "ratio": r, "sd": 0.3 * r}
            for text, r in zip(TEXTS, np.sort(RATIO).tolist(), strict=True)
        ],
        "parameters": parameters,
        "combinations": products,
        "contraction": {name: 1 - row["ratio"] ** 2 for name, row in parameters.items()},
        "box_sensitivity": {
            "alpha": {"shift": 0.17, "box": "alpha", "end": "lower"},
            "delta": {"shift": None, "box": "alpha", "end": "upper"},
            "gamma": {"shift": 0.0, "box": "", "end": ""},
        },
        "profiles": {
            "zeta": {"interval": [0.00438, 0.0045], "open": [False, False]},
            "alpha": {"interval": [425.0, 590.0], "open": [True, True]},
        },
        "waterfall": {"costs": [412.0, 412.3, 980.0, None], "reached": 2},
    }

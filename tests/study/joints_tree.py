"""The input of `jbw export` for a run with two bolts, made from the truth, without a fit."""

import json

import numpy as np
import two_bolts
import xarray as xr

from jbw.oscillator.modes.assembled import held_numbers
from jbw.quantities import label
from jbw.study.assembly_group import assembly_group

PEAK = 4e-6  # largest motion of the bolts [m]: delta x is about one


def tree_of(model=None, laws=two_bolts.LAWS, theta=None, *, spread=0.0, peak=PEAK):
    """Return the result of a run with draws about the true values of a reduced model."""
    model = two_bolts.reduced() if model is None else model
    theta = two_bolts.truth() if theta is None else theta
    rng, shape = np.random.default_rng(0), (2, 20)
    deviations = {name: rng.standard_normal(shape) for name in theta}
    draws = {
        name: (("chain", "draw"), value * (1 + spread * deviations[name]))
        for name, value in theta.items()
    }
    density = -0.5 * sum(z**2 for z in deviations.values())
    labels = [label(joint.name) for joint in model.joints]
    held = held_numbers(
        model.omega, model.zeta, dict(zip(labels, model.H, strict=True)),
        {label(joint.name): joint.stiffness for joint in model.joints},
        model.b, {"": model.c[0]},
    )  # fmt: skip
    held["gain"] = model.b[0] * model.c[0, 0]
    num = sum(name in theta for name in ("omega_n", "omega_2"))
    amplitude = peak / np.abs(model.H[:, :num]).max(axis=0)
    joints = xr.Dataset(
        {"amplitude": ("mode", amplitude), "frequency_hz": ("mode", model.frequencies_hz[:num])},
        {"mode": np.arange(1, num + 1)},
    )
    attrs = {
        "held": json.dumps({name: float(x) for name, x in held.items()}),
        "laws": json.dumps(laws),
        "y_peak": float(amplitude[0] * abs(model.c[0, 0])),
    }
    return xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs=attrs),
            "posterior": xr.Dataset(draws),
            "sample_stats": xr.Dataset({"lp": (("chain", "draw"), density)}),
            "joints": joints,
            "assembly": assembly_group(model),
        }
    )

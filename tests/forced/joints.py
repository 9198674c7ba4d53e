"""The joints of `golden_forced.json` with the parameters of jbw's laws."""

import json
from pathlib import Path

from jbw.oscillator.oscillator import oscillator_of

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_forced.json").read_text())
BOUC_WEN, IWAN4, JENKINS = (GOLDEN["parameters"][name] for name in ("bouc_wen", "iwan4", "jenkins"))


def parameters(law):
    """Return a law's parameters by their names in jbw, and the name of the law."""
    if law == "bouc_wen":
        return dict(BOUC_WEN), "bouc_wen"
    if law == "jenkins":
        mode = {name: JENKINS[name] for name in ("omega_n", "zeta")}
        return mode | {"stiffness_1": JENKINS["stiffness"], "slip_1": JENKINS["slip"]}, "jenkins_1"
    k_t, f_s, chi, beta = (IWAN4[name] for name in ("k_t", "f_s", "chi", "beta"))
    phi_max = f_s * (1 + beta) / (k_t * (beta + (chi + 1) / (chi + 2)))  # Segalman (2005)
    lost = k_t * phi_max ** -(1 + chi) / ((1 + beta) * (2 + chi))
    mode = {name: IWAN4[name] for name in ("omega_n", "zeta")}
    return mode | {
        "iwan_stiffness": k_t, "iwan_loss": lost * 1e-3 ** (1 + chi),
        "iwan_chi": chi, "iwan_beta": beta,
    }, "iwan4"  # fmt: skip


def joint(law):
    theta, name = parameters(law)
    return oscillator_of(theta, (name,))

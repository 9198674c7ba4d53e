"""Do bands of laws without an assumed form contain the truth, and is Masing's rule judged right?

    python benchmarks/free_law.py [--calls 20] [--seed 1000] [--kinds iwan4 linear] [--json FILE]

Joints of six kinds are drawn at random. Each is read from five records of one mode, with different
largest amplitudes and with errors of size and shape like those of decays; in half of the sets each
record has a separate frequency (standard deviation 3e-5). True values are closed forms, or
integrals over sliders that this file computes itself. Printed by kind are: the share of 99 % bands
that contain the truth within the readings, at 1.5 and 3 times the largest and at a third of the
smallest amplitude; the median half width of the damping's band within the readings; how often the
least damping is below the truth; and the evidence against Masing's rule. `--calls` is the number of
joints per kind.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import simpson
from timing import Table as ShownTable
from timing import options, show

from jbw.freeform.free_law import free_law
from jbw.freeform.sliders import loss_share, stiffness_share
from jbw.measurement.readings.statement import RecordTable

HZ = 100.0
OMEGA_SQ = (2 * np.pi * HZ) ** 2
OWN = 3e-5  # standard deviation between the records' frequencies, for every second joint
PLACES = "inside", "x1.5", "x3", "a third"
COLUMNS = {
    "joint": "", **{f"{place} [%]": ".1f" for place in PLACES}, "half width [%]": ".2g",
    "bound below [%]": ".0f", "least": "+.1f", "median": "+.1f", "most [nats]": "+.1f",
    "CPU s": ".1f",
}  # fmt: skip
SLIDERS = 4000  # number of sliders for a true value that is an integral
POINTS = 12  # number of amplitudes at which each record is read
Curve = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def sliders(d: np.ndarray, w: np.ndarray, zeta: float) -> Curve:
    """Return omega^2 and 2 zeta omega^2 of sliders with viscous damping, both over omega_n^2."""

    def curve(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        softening = (1 - stiffness_share(y[:, None], d)) @ w
        omega_sq = 1 - softening
        return omega_sq, 2 * zeta * np.sqrt(omega_sq) + loss_share(y[:, None], d) @ w

    return curve


def drawn_iwan(rng: np.random.Generator) -> Curve:
    """Draw an Iwan-4 joint below macroslip."""
    chi, share, top = rng.uniform(-0.8, 0.0), 10 ** rng.uniform(-2.5, -0.5), rng.uniform(1.5, 6.0)
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, SLIDERS)]) * top
    w = np.diff(edges ** (chi + 1)) / top ** (chi + 1)
    d, beta = (edges[1:] + edges[:-1]) / 2, 10 ** rng.uniform(-1, 1)
    w, d = np.append(w, beta * (w @ d) / top), np.append(d, top)
    return sliders(d, share * w / w.sum(), 10 ** rng.uniform(-3.5, -2))


def drawn_power(rng: np.random.Generator) -> Curve:
    """Draw sliders whose strength is a power of their half width, with a cubic spring."""
    base = drawn_iwan(rng)
    hard = rng.uniform(-0.1, 0.1)

    def curve(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        omega_sq, loss = base(y)
        return omega_sq + hard * (omega_sq.min() - 1) * y**2, loss

    return curve


def drawn_single(rng: np.random.Generator) -> Curve:
    """Draw three Jenkins elements of different half widths."""
    d = np.sort(rng.uniform(0.2, 2.0, 3))
    return sliders(d, rng.dirichlet(np.ones(3)) * 10 ** rng.uniform(-2.5, -0.5), 1e-3)


def drawn_bouc_wen(rng: np.random.Generator) -> Curve:
    """Draw a Bouc-Wen joint (nu = 1, delta unlike gamma), from far below to near saturation.

    On the virgin curve z' = 1 - (delta + gamma) z, on unloading from a tip z' = 1 + (gamma - delta)
    z down to z = 0 and z' = 1 - (delta + gamma) |z| beyond; its first harmonic is an integral.
    """
    size, ratio = rng.uniform(0.2, 1.5), 10 ** rng.uniform(0.3, 1.0)
    gamma = size / (1 + ratio)
    joint = 10 ** rng.uniform(-2.0, -0.5), size, ratio * gamma - gamma
    return np.vectorize(partial(_bouc_wen, *joint, 1e-3), signature="()->(),()")


def _bouc_wen(share: float, size: float, apart: float, zeta: float, top: float) -> tuple:
    """Return omega^2 and 2 zeta omega^2 of one steady loop, by Simpson's rule in its phase."""
    t = np.linspace(0.0, np.pi, 4001)
    y = top * np.cos(t)

    def unloading(peak: float) -> np.ndarray:
        gone = top - y  # z' = dz / dgone = -(1 + (apart sign z) ...), closed in two branches
        # gamma - delta = -apart while z > 0; afterwards z saturates at -1 / size.
        falling = (peak - 1 / apart) * np.exp(apart * gone) + 1 / apart if apart else peak - gone
        crossing = np.log(1 / (1 - apart * peak)) / apart if apart else peak
        beyond = -(1 - np.exp(-size * np.maximum(gone - crossing, 0.0))) / size
        return np.where(gone < crossing, falling, beyond)

    low, high = 0.0, 1 / size
    for _ in range(60):  # The loop closes when z at -top is minus z at top.
        peak = (low + high) / 2
        low, high = (peak, high) if -unloading(peak)[-1] > peak else (low, peak)
    z = unloading(peak)
    stiffness = 2 / np.pi * simpson(z * np.cos(t), x=t) / top
    lost = -2 / np.pi * simpson(z * np.sin(t), x=t) / top
    omega_sq = 1 - share + share * stiffness
    return omega_sq, 2 * zeta * np.sqrt(omega_sq) + share * lost


def drawn_smooth(rng: np.random.Generator) -> Curve:
    """Draw a cubic spring with a damper v|v|: no sliders at all."""
    hard, drag = 10 ** rng.uniform(-2.5, -1) * rng.choice([-1, 1]), 10 ** rng.uniform(-3, -1.5)

    def curve(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        omega_sq = 1 + 0.75 * hard * y**2
        return omega_sq, 2e-3 * np.sqrt(omega_sq) + drag * omega_sq * y

    return curve


def drawn_linear(rng: np.random.Generator) -> Curve:
    """Draw a linear mode."""
    zeta = 10 ** rng.uniform(-3, -1.7)
    return lambda y: (np.ones(len(y)), np.full(len(y), 2 * zeta))


KINDS = {
    "iwan4": drawn_iwan, "sliders + cubic": drawn_power, "jenkins_3": drawn_single,
    "bouc_wen": drawn_bouc_wen, "cubic + v|v|": drawn_smooth, "linear": drawn_linear,
}  # fmt: skip


def drawn_tables(curve: Curve, rng: np.random.Generator, own: float) -> list[RecordTable]:
    """Draw frequency and damping of five records, with their covariances."""
    tables = []
    for top in rng.uniform(0.5, 1.0, 5):
        y = top * np.geomspace(1 / rng.uniform(5, 20), 1.0, POINTS)
        omega_sq, loss = curve(y)
        hz, zeta = HZ * np.sqrt(omega_sq), loss / (2 * omega_sq)
        r = np.stack([np.ones(POINTS), y / top, (y / top) ** 2])
        factors = [0.006 * scale[:, None] * r.T for scale in (zeta * hz, zeta)]
        floors = 1e-3 * zeta * hz, 3e-3 * zeta
        covariances = [f @ f.T + np.diag(x**2) for f, x in zip(factors, floors, strict=True)]
        noise = [rng.multivariate_normal(np.zeros(POINTS), c) for c in covariances]
        hz = (hz + noise[0]) * (1 + own * rng.standard_normal())
        tables.append(RecordTable(y, hz, zeta + noise[1], covariances[0], covariances[1]))
    return tables


def calibrated(kind: str, number: int, seed: int) -> list[Any]:
    """Return a row for joints of one kind: coverage of bands, and the test of Masing's rule."""
    held: dict[str, list[bool]] = {place: [] for place in PLACES}
    masing, below, width, started = [], [], [], time.process_time()
    for i in range(number):
        rng = np.random.default_rng([seed, list(KINDS).index(kind), i])
        curve = KINDS[kind](rng)
        law = free_law(drawn_tables(curve, rng, OWN * (i % 2)), named=False, seed=i)
        masing.append(law.masing)
        low, high = law.rows.y.min(), law.rows.y.max()
        places = np.geomspace(low, high, 5), [1.5 * high], [3.0 * high], [low / 3]
        for place, at in zip(PLACES, places, strict=True):
            truths, bands = truth_at(curve, at), law.bands(at)
            for truth, band in zip(truths, bands, strict=True):
                held[place] += list((band[0] <= truth) & (truth <= band[2]))
            if place == "inside":
                width += list((bands[1][2] - bands[1][0]) / (2 * truths[1]))
        at = np.geomspace(low, 3 * high, 6)
        below += list(law.least_damping(at) <= truth_at(curve, at)[1])
    shares = [100 * float(np.mean(inside)) for inside in held.values()]
    nats = [min(masing), float(np.median(masing)), max(masing)]
    seconds = (time.process_time() - started) / number
    return [
        kind,
        *shares,
        100 * float(np.median(width)),
        100 * float(np.mean(below)),
        *nats,
        seconds,
    ]


def truth_at(curve: Curve, y: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return the true frequency [Hz] and damping ratio at given amplitudes."""
    omega_sq, loss = curve(np.asarray(y, float))
    return HZ * np.sqrt(omega_sq), loss / (2 * omega_sq)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the coverage of the bands, and the test of Masing's rule, by kind of joint."""
    parser = options(__doc__, calls=20)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    chosen = parser.parse_args(arguments)
    rows = []
    for kind in chosen.kinds:
        rows.append(calibrated(kind, chosen.calls, chosen.seed))
        print(*rows[-1], flush=True)
    show([ShownTable("Bands of a law without a form", COLUMNS, rows)], file=chosen.json)


if __name__ == "__main__":
    main()

r"""The modes of a structure that move one joint, and their known properties before any fit.

Their frequencies are stated; starting values are read from spectra. Of a mode's coupling to the
joint only the order of magnitude is known,

$$\ln|h_i| \sim N(0, 1.5^2), \qquad \ln\kappa_i \sim N(0, 2^2)$$

and the sign of h_i, which is fixed, is that of the better fit.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.observables.groups import read_before
from jbw.observables.observable import KnownReading, Laws, Shown, Theta
from jbw.oscillator.modes.assembled import OMEGA, PUSH, ZETA, numbered, seen_name
from jbw.oscillator.modes.parameters import NAMES, SEEN, Names, structure_of
from jbw.quantities import DEFAULT_LAWS, OSCILLATOR
from jbw.report.messages import observed as messages

FIRST = tuple(quantity.name for quantity in OSCILLATOR)
LABEL = "modes at the joint"
# prior standard deviations of ln shape_i (motion of the joint in mode i) and of ln coupling_i
SHAPE_STD, COUPLING_STD = 1.5, 2.0
REACH = 3.0  # prior bounds of ln shape_i and ln coupling_i, in standard deviations
WITHIN = 0.07  # half width of a mode's search range, relative to its stated frequency
# The data determine a mode's frequency if its gain exceeds this fraction of the largest gain.
HARDLY_SEEN = 0.02
LEAST_ZETA = 1e-4  # smallest starting value of a damping ratio
CLEAR = 9.0  # smallest difference of chi-square that decides between the signs of a mode's motion
Bounds = dict[str, tuple[float, float]]
Reals = NDArray[np.float64]


class Modes(NamedTuple):
    """The modes that a campaign states; the laws refer to the motion of the first one."""

    hz: tuple[float, ...]
    driving_point: bool = False  # whether the response is measured where the source pushes
    # measured motion of the joint in every mode, divided by the motion in the first mode (h_i /
    # h_1)
    joint_shape: tuple[float, ...] = ()
    points: tuple[str, ...] = ()  # names of additional points where responses are measured
    # Coupling of the modes. "common": one joint couples them; "apart": separate laws, no coupling;
    # "first": only the first mode moves the joint; "assembled": several joints of a reduced model
    # couple them.
    meet: str = "common"
    numbers: tuple[tuple[str, float], ...] = ()  # fixed values from the reduced model, by name
    uncertain: bool = False  # whether the joints' motion in the model's modes is uncertain

    @property
    def names(self) -> tuple[Names, ...]:
        """The names of the parameters of each mode except the first, as in `NAMES`."""
        return NAMES[: len(self.hz) - 1]

    @property
    def seen(self) -> dict[str, tuple[str, ...]]:
        """The names of response parameters at each additional point, relative to point one."""
        rows = (names[: len(self.hz)] for names in SEEN)
        return dict(zip(self.points, rows, strict=False))

    @property
    def free(self) -> tuple[str, ...]:
        """The names of the unknown modal parameters of the joint: motions and couplings, if any."""
        if self.meet != "common":
            return ()
        shapes = () if self.joint_shape else tuple(names.shape for names in self.names)
        couplings = () if self.driving_point else tuple(names.coupling for names in self.names)
        return shapes + couplings

    @property
    def held(self) -> dict[str, float]:
        """The fixed modal parameters: measured joint motions, and signs (positive by default)."""
        if self.meet != "common":
            return dict(self.numbers)
        signs = {names.sign: 1.0 for names in self.names}
        over_first = (h / self.joint_shape[0] for h in self.joint_shape[1:])
        shapes = dict(zip(self.names, over_first, strict=False))
        signs |= {names.sign: float(np.sign(h)) for names, h in shapes.items()}
        return signs | {names.shape: abs(h) for names, h in shapes.items()}

    @property
    def ratios(self) -> tuple[str, ...]:
        """The names of the gains of the other modes, relative to that of the first mode."""
        return tuple(names.ratio for names in self.names)

    @property
    def windows_hz(self) -> list[tuple[float, float]]:
        """The search range of each mode [Hz] around its stated frequency; ranges do not overlap."""
        windows = []
        for centre in self.hz:
            middles = [0.5 * (centre + other) for other in self.hz if other != centre]
            low = max([(1 - WITHIN) * centre, *(x for x in middles if x < centre)])
            windows.append((low, min([(1 + WITHIN) * centre, *(x for x in middles if x > centre)])))
        return windows

    @property
    def regions_hz(self) -> list[tuple[float, float]]:
        """The range [Hz] assigned to each mode: closer to it than to other modes, and within 50 %.

        It is wider than the search window, because a fast sweep has much of a mode's motion outside
        that window.
        """
        regions = []
        for centre in self.hz:
            below = [0.5 * (centre + other) for other in self.hz if other < centre]
            above = [0.5 * (centre + other) for other in self.hz if other > centre]
            regions.append((max([0.5 * centre, *below]), min([1.5 * centre, *above])))
        return regions


def with_ratios(found: Mapping[str, float]) -> dict[str, float]:
    """Return starting values, with the gains of other modes and points relative to the first."""
    if not found.get("gain"):
        return dict(found)
    ratios = {n.ratio: found[n.ratio] / found["gain"] for n in NAMES if n.ratio in found}
    gains = [found.get(name, 0.0) for name in ("gain", *(n.ratio for n in NAMES))]
    seen = {name: found[name] / gain for names in SEEN
            for name, gain in zip(names, gains, strict=True) if name in found and gain}  # fmt: skip
    return {**found, **ratios, **seen}


def gain_shares(modes: Modes, point: str = "") -> Reals:
    """Return a reduced model's gain at a point for each driven mode, relative to the first mode."""
    numbers, driven = dict(modes.numbers), range(1, len(modes.hz) + 1)
    gains = [numbers[numbered(PUSH, i)] * numbers[seen_name(i, point)] for i in driven]
    return np.array(gains) / (numbers[numbered(PUSH, 1)] * numbers[seen_name(1)])


def by_model(modes: Modes, readings: Mapping[str, float]) -> dict[str, float]:
    r"""Return starting values from fits of single modes, for a reduced model with known shapes.

    $$g = \frac{\sum_{io} w_{io}g_{io}}{\sum_{io} w_{io}^2}, \qquad
      w_{io} = \frac{b_ic_{oi}}{b_1c_{11}}$$

    Frequencies and damping ratios of modes that are hardly visible at the points are the model's.
    """
    numbers, names = dict(modes.numbers), (FIRST, *(mode_names[:3] for mode_names in modes.names))
    gains = {"": [mode_names[2] for mode_names in names]} | {
        p: list(gain_names) for p, gain_names in modes.seen.items()
    }
    shares = {point: gain_shares(modes, point) for point in gains}
    strongest = np.max([np.abs(row) for row in shares.values()], axis=0)
    first: dict[str, float] = {}
    for i, (omega, zeta, _) in enumerate(names):
        is_seen = strongest[i] > HARDLY_SEEN * strongest.max() and omega in readings
        first[omega] = readings[omega] if is_seen else numbers[numbered(OMEGA, i + 1)]
        first[zeta] = readings[zeta] if is_seen else max(numbers[numbered(ZETA, i + 1)], LEAST_ZETA)
    shares_and_gains = [
        (shares[point][i], readings[name])
        for point, gain_names in gains.items()
        for i, name in enumerate(gain_names)
        if name in readings
    ]
    if shares_and_gains:
        w, g = np.array(shares_and_gains).T
        first["gain"] = float(w @ g / (w @ w))
    return first


def bounds_of(modes: Modes, known: Mapping[str, float], *, with_joint: bool) -> Bounds:
    """Return bounds of modal parameters about starting values; with laws, also of joint motions."""
    bounds: Bounds = {}
    for names, (low, high) in zip(modes.names, modes.windows_hz[1:], strict=True):
        bounds[names.omega] = 2 * np.pi * low, 2 * np.pi * high
        bounds[names.zeta] = 0.005 * known[names.zeta], 3.0 * known[names.zeta]
        # A gain ratio is missing if no test drives the mode, or the reduced model gives its gain.
        if names.ratio not in known:
            continue
        ratio = known[names.ratio]
        reach = 2 * max(abs(ratio), 0.05)
        # If the response is measured at the drive point, gains are squares and therefore positive.
        least = 1e-3 * ratio if modes.driving_point else ratio - reach
        bounds[names.ratio] = least, ratio + reach
    for name in (name for names in modes.seen.values() for name in names if name in known):
        reach = 2 * max(abs(known[name]), 0.05)
        bounds[name] = known[name] - reach, known[name] + reach
    for name in modes.free if with_joint else ():
        end = float(np.exp(REACH * _std(name)))
        bounds[name] = 1 / end, end
    return bounds


def _std(name: str) -> float:
    return SHAPE_STD if name in {names.shape for names in NAMES} else COUPLING_STD


class ModesAtJoint(KnownReading):
    """The prior on how strongly each mode moves the joint, as a likelihood term.

    Attributes:
        growth: Increase of chi-square with the other sign of each mode, in the order of `names`;
            NaN if not tried.
        mean: Zeros, the prior means of the logarithms of the sizes.
        names: Names of parameters whose logarithms are normal about zero; static.
        modes: Stated modes; static.
    """

    moved_by_runs: ClassVar[bool] = False

    growth: Float[Array, " mode"]
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls, modes: Modes, stated: Sequence[str], run: str, *, laws: Laws = DEFAULT_LAWS
    ) -> Self:
        """Build the prior for the joint motions that a campaign does not state."""
        names = tuple(name for name in modes.free if name not in stated)
        growth = jnp.full(len(modes.names), jnp.nan)
        mean, groups = jnp.zeros((1, len(names))), read_before(LABEL, run, len(names))
        return cls(growth, names, mean=mean, groups=groups, laws=laws, modes=modes)

    def predict(self, theta: Theta) -> Float[Array, "1 size"]:
        """Return the logarithms of each mode's motion and coupling at the joint."""
        sizes = [jnp.log(theta.get(name, jnp.ones(()))) for name in self.names]
        return jnp.stack(sizes)[None]

    def whitened(
        self, theta: Theta
    ) -> tuple[Float[Array, "1 size"], Float[Array, "1 offset size"], Float[Array, ""] | float]:
        """Return log motions and couplings divided by their prior sd, and the log prior density.

        The density is relative to that of a uniform prior.
        """
        logs, std = self.predict(theta), np.array([_std(name) for name in self.names])
        rows, directions = logs / std, self.groups.directions
        if not set(self.names) <= theta.keys():
            return rows, directions, 0.0
        box = np.sum(np.log(2 * np.sinh(REACH * std)) - np.log(np.sqrt(2 * np.pi) * std))
        return rows, directions, box - jnp.sum(logs)

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return starting values for which each mode moves the joint as much as the first one."""
        return Shown(lambda: dict.fromkeys(self.modes.free, 1.0) if self.modes else {})

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences on each further mode: how much the joint moves in it, with its sign."""
        if self.modes is None or self.modes.meet != "common" or not self.laws:
            return []
        structure = structure_of(theta, self.laws)
        h, p = (np.asarray(x)[1:] for x in (structure.h, structure.p))
        growth = np.asarray(self.growth)
        sentences = []
        for i, hz in enumerate(np.asarray(structure.omega_n)[1:] / (2 * np.pi)):
            sentence = messages.moves_joint(i + 2, hz, h[i], p[i])
            if not np.isnan(growth[i]):
                sign = messages.sign_of_motion(growth[i], is_clear=bool(growth[i] > CLEAR))
                sentence = f"{sentence} {sign}"
            sentences.append(sentence)
        return sentences

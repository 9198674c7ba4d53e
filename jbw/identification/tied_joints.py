r"""Comparison of laws at several joints, shared by joints or separate.

Every law is tried at all joints; joints that share a law in the campaign share it here too. The
campaign's own laws are tried as well, also with one law for all joints of a kind. Then the law of
one joint after another is changed while the others keep theirs. A joint without a law is stuck.

The choice between one law for several joints and separate laws is made by the evidence of both,

$$\ln\frac{Z_{tied}}{Z_{own}}, \qquad Z = \int L(\theta)\,\pi(\theta)\,d\theta \le L_{max}$$

Both use the same values with the weights of the fit with separate laws. The prior of a law that
joints share is the same as in a campaign with `same_as`.

If shapes are uncertain, tests determine the sum of two joints' effects on a mode but not each of
them: a shape factor of one is exchanged for the law of the other along a curve. Points around the
fit miss the ends of this curve, so points are drawn along it instead.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError, did_you_mean
from jbw.identification.assembled import ASSEMBLED, joint_bounds
from jbw.identification.evidence import (
    FAR_BELOW,
    Candidate,
    likelihood_at,
    name_of,
    place_of,
    tried_under,
)
from jbw.identification.first_fit import inside
from jbw.identification.law_scores import weighed_in
from jbw.identification.prepare import Fitted
from jbw.identification.uncertain_shapes import first_factors
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.valley import about_valley
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers.amis import WeighedPoints
from jbw.inference.space.box import bounds_by_name, box
from jbw.observables import dataset
from jbw.observables.modes import Modes
from jbw.oscillator.laws import law_named
from jbw.quantities import are_at_joints, joints_of, law_name, name_at, split
from jbw.report.messages import laws as messages

Laws = tuple[str, ...]
PREFIX = "tied_"  # prefix of the attributes that store this comparison
DECISIVE = 3.0  # difference of log evidence that decides between laws: 20 to 1 [nats]
# Largest number of sets of laws. If sets with another law at one joint exceed this number, only
# sets with one joint without a law are added; if these exceed it too, no set is added.
MOST = 12

# laws that are tried by default: no law, elastic laws, and hysteretic laws
USUAL: tuple[Laws, ...] = ((), ("cubic",), ("bouc_wen",), ("bouc_wen_nu",), ("iwan4",))


class TiedEvidence(NamedTuple):
    """The evidence for one law that several joints share, against separate laws.

    Attributes:
        laws: Names of the laws, with the joints that share each law.
        tied: The fit of the shared laws.
        log_ratio: Log evidence of the shared laws minus that of separate laws [nats].
        khat: The larger k-hat of the weights of both; good below 0.7.
        is_bound: Whether the ratio is only an upper bound, from the largest likelihood of the
            shared laws.
    """

    laws: Laws
    tied: Fitted
    log_ratio: float
    khat: float
    is_bound: bool

    @property
    def is_trusted(self) -> bool:
        """Whether the importance weights are good enough (k-hat below 0.7)."""
        return self.khat < GOOD_KHAT

    @property
    def answer(self) -> str:
        """The laws that the evidence prefers (20 to 1): `tied`, `own`, or `not told` if neither."""
        if not self.is_trusted or abs(self.log_ratio) < DECISIVE:
            return "not told"
        return "tied" if self.log_ratio > 0 else "own"

    @property
    def attrs(self) -> dict[str, Any]:
        """The evidence as plain values, to be stored as attributes of the joints' group."""
        facts = {
            "laws": " + ".join(self.laws),
            "log_evidence_ratio": self.log_ratio,
            "khat": self.khat,
            "is_bound": int(self.is_bound),
            "is_trusted": int(self.is_trusted),
            "answer": self.answer,
        }
        return {f"{PREFIX}{name}": value for name, value in facts.items()}


def tied_record(attrs: Mapping[Any, Any]) -> dict[str, Any] | None:
    """Return the stored evidence for shared laws as a record; None if it was not computed."""
    facts = {
        str(name).removeprefix(PREFIX): value
        for name, value in attrs.items()
        if str(name).startswith(PREFIX)
    }
    if not facts:
        return None
    numbers = {name: float(facts[name]) for name in ("log_evidence_ratio", "khat")}
    return {
        "laws": str(facts["laws"]).split(" + "),
        **numbers,
        **{name: bool(facts[name]) for name in ("is_bound", "is_trusted")},
        "answer": str(facts["answer"]),
    }


def tied_laws(laws: Laws) -> Laws:
    """Return the laws that joints share if all joints with the same kind of law have equal laws."""
    kinds = {
        joint: tuple(split(law)[0] for law in laws if joint in split(law)[1])
        for joint in joints_of(laws)
    }
    sharing = {
        of_joint: [joint for joint, others in kinds.items() if others == of_joint]
        for of_joint in kinds.values()
    }
    return tuple(law_name(kind, joints) for group, joints in sharing.items() for kind in group)


def tied_evidence(key: Key[Array, ""], own: Fitted, settings: Identify) -> TiedEvidence | None:
    """Compare the evidence for one law per kind of joint with that for separate laws.

    None unless two joints have separate laws of one kind.
    """
    data = own.data
    laws = tied_laws(data.laws)
    if data.modes is None or data.modes.meet != ASSEMBLED or len(laws) == len(data.laws):
        return None
    tied = tied_fit(own, laws, data.modes, settings)
    keys = jax.random.split(key)
    of_own = _weighed(keys[0], Candidate(data.laws, own))
    most = likelihood_at(tied.fit, tied.data) - of_own.log_evidence
    if most < -FAR_BELOW:
        return TiedEvidence(laws, tied, most, of_own.khat, is_bound=True)
    of_tied = _weighed(keys[1], Candidate(laws, tied))
    log_ratio = of_tied.log_evidence - of_own.log_evidence
    return TiedEvidence(laws, tied, log_ratio, max(of_own.khat, of_tied.khat), is_bound=False)


def tied_fit(own: Fitted, laws: Laws, modes: Modes, settings: Identify) -> Fitted:
    """Fit shared laws to the same data as separate laws, starting from each joint's law in turn."""
    data, settings = tried_under(laws, own.data, "", settings)
    own_names = {name for law in own.data.laws for name in law_named(law).names()}
    bounds = {n: pair for n, pair in bounds_by_name(own.box).items() if n not in own_names}
    theta = own.fit.theta
    bounds |= joint_bounds(modes, data, settings.prior, theta.get("zeta", 0.01))
    prior = box(bounds)
    common = first_factors(data) | theta
    starts = {name: [common[name]] * _most_joints(laws) for name in bounds if name in common}
    for law in laws:
        kind, joints = split(law)
        for name in law_named(kind).names():
            values = [theta[name_at(name, j)] for j in joints if name_at(name, j) in theta]
            starts[name_at(name, joints[0])] = [
                values[i % len(values)] for i in range(_most_joints(laws))
            ]
    best = costly_fit(dataset.stacked, prior, data, starts=inside(starts, prior))
    return replace(own, fit=best, box=prior, data=data, statements=(), findings=())


def _most_joints(laws: Laws) -> int:
    return max(len(split(law)[1]) for law in laws)


def _weighed(key: Key[Array, ""], candidate: Candidate) -> WeighedPoints:
    """Draw weighted points around a fit; if the weights are poor, also along the fit's valley."""
    fitted = candidate.fitted
    best, prior, data = fitted.fit, fitted.box, fitted.data
    about_fit = weighed_in(key, prior, data, {"fit": lambda: place_of(best, candidate)})
    if about_fit.khat < GOOD_KHAT:
        return about_fit
    valley = about_valley(dataset.stacked, prior, data, best)
    if valley is None:
        return about_fit
    along = weighed_in(jax.random.fold_in(key, 1), prior, data, {"valley": lambda: valley})
    return min(about_fit, along, key=lambda points: points.khat)


def trials_at_joints(
    campaign_laws: Laws, stated: Sequence[Laws] | None
) -> tuple[tuple[Laws, ...], str]:
    """Return the sets of laws to try at a campaign's joints, and a sentence that names them.

    Args:
        campaign_laws: The campaign's laws, with the joints that share each.
        stated: Laws without joints, which are tried at all joints and at each, and laws with
            joints, which are tried as they are; None for the usual ones.

    Raises:
        ConfigError: The campaign has no law at any joint, or lacks a named joint.
    """
    groups = tuple(dict.fromkeys(split(law)[1] for law in campaign_laws))
    if not groups:
        raise ConfigError(
            "A comparison of laws needs a joint with a law, but no [[joint]] table states a law.",
            remedy='Put under [[joint]]: `laws = ["bouc_wen"]`.',
        )
    chosen = list(USUAL if stated is None else stated)
    plain = [laws for laws in chosen if not are_at_joints(laws)]
    whole = [laws for laws in chosen if are_at_joints(laws)]
    _require_joints(whole, groups)
    alike = [_everywhere(laws, groups) for laws in plain]
    kept = [*alike, *whole, campaign_laws, tied_laws(campaign_laws)]
    which, sets = _with_changed(plain, kept, groups, campaign_laws)
    own = [name_of(laws) for laws in dict.fromkeys(kept) if laws not in alike]
    num_changed = len(sets) - len(dict.fromkeys(kept))
    words = messages.tried_at_joints(
        [name_of(laws) for laws in plain], own, num_changed, which, MOST
    )
    return sets, words


def _with_changed(
    plain: Sequence[Laws],
    kept: Sequence[Laws],
    groups: Sequence[tuple[str, ...]],
    campaign_laws: Laws,
) -> tuple[str, tuple[Laws, ...]]:
    """Add sets of laws that differ at one joint; return a description of them, and all sets."""
    stuck = [laws for laws in plain if not laws]
    for which, tried in ((messages.EVERY, plain), (messages.NONE, stuck)):
        changed = [_with_others(laws, group, campaign_laws) for group in groups for laws in tried]
        sets = tuple(dict.fromkeys([*kept, *changed]))
        if len(sets) <= MOST:
            return which if changed else messages.NEITHER, sets
    return messages.NEITHER, tuple(dict.fromkeys(kept))


def _everywhere(laws: Laws, groups: Sequence[tuple[str, ...]]) -> Laws:
    """Return the given laws at all joints; each group of tied joints shares a law."""
    return tuple(law_name(law, joints) for joints in groups for law in laws)


def _with_others(laws: Laws, group: tuple[str, ...], campaign_laws: Laws) -> Laws:
    """Return a campaign's laws, with other laws at one group of tied joints."""
    before = [law for law in campaign_laws if split(law)[1] != group]
    first = next(i for i, law in enumerate(campaign_laws) if split(law)[1] == group)
    return (*before[:first], *_everywhere(laws, [group]), *before[first:])


def _require_joints(whole: Sequence[Laws], groups: Sequence[tuple[str, ...]]) -> None:
    """Raise a ConfigError if laws are stated for joints that the campaign lacks."""
    known = [joint for joints in groups for joint in joints]
    for joint in (joint for laws in whole for joint in joints_of(laws)):
        if joint not in known:
            raise ConfigError(
                f"Argument `laws` must name joints of the campaign, but names `{joint}`.",
                remedy=f"{did_you_mean(joint, known)}Joints with laws: {', '.join(known)}.",
            )

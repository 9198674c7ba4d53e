"""Which laws are tried where a structure has several joints: at all of them, and one joint changed.

Every law is tried at all joints alike, those that share a law sharing it too; so are the campaign's
own laws, and these with one law for all joints of a kind. Then one joint after another has another
law, the others keeping theirs. A joint without a law sticks.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jbw.errors import ConfigError, did_you_mean
from jbw.identification.evidence import name_of
from jbw.identification.tied_joints import tied_laws
from jbw.quantities import are_at_joints, joints_of, law_name, split
from jbw.report.messages import laws as messages

Laws = tuple[str, ...]
MOST = 12  # sets of laws: beyond, fewer of one joint are tried

# What is tried unless laws are named: none, elastic, and hysteretic ones.
USUAL: tuple[Laws, ...] = ((), ("cubic",), ("bouc_wen",), ("bouc_wen_nu",), ("iwan4",))


class Trials(NamedTuple):
    """Sets of laws to try, and in words which they are."""

    sets: tuple[Laws, ...]
    sentence: str


def trials_at_joints(campaign_laws: Laws, stated: Sequence[Laws] | None) -> Trials:
    """Sets of laws that are tried at a campaign's joints.

    Args:
        campaign_laws: Its own, with the joints that share each.
        stated: Laws of one joint, tried at all and at each, and laws with joints, tried as they
            are; the usual ones when None.

    Raises:
        ConfigError: The campaign has no law at any joint, or lacks a joint that is named.
    """
    groups = tuple(dict.fromkeys(split(law)[1] for law in campaign_laws))
    if not groups:
        raise ConfigError(
            "A comparison of laws needs a joint that has one, but all [[joint]] tables have none.",
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
    return Trials(sets, words)


def _with_changed(
    plain: Sequence[Laws],
    kept: Sequence[Laws],
    groups: Sequence[tuple[str, ...]],
    campaign_laws: Laws,
) -> tuple[str, tuple[Laws, ...]]:
    """Sets with those of one changed joint, as many as there may be, and which these are."""
    stuck = [laws for laws in plain if not laws]
    for which, tried in ((messages.EVERY, plain), (messages.NONE, stuck)):
        changed = [_changed(laws, group, campaign_laws) for group in groups for laws in tried]
        sets = tuple(dict.fromkeys([*kept, *changed]))
        if len(sets) <= MOST:
            return which if changed else messages.NEITHER, sets
    return messages.NEITHER, tuple(dict.fromkeys(kept))


def _everywhere(laws: Laws, groups: Sequence[tuple[str, ...]]) -> Laws:
    """Laws at all joints, those of a tie together."""
    return tuple(law_name(law, joints) for joints in groups for law in laws)


def _changed(laws: Laws, group: tuple[str, ...], campaign_laws: Laws) -> Laws:
    """A campaign's laws with others at the joints of one tie, in their place."""
    before = [law for law in campaign_laws if split(law)[1] != group]
    first = next(i for i, law in enumerate(campaign_laws) if split(law)[1] == group)
    return (*before[:first], *_everywhere(laws, [group]), *before[first:])


def _require_joints(whole: Sequence[Laws], groups: Sequence[tuple[str, ...]]) -> None:
    """Refuse laws at joints that the campaign lacks, or that are no tie of it."""
    known = [joint for joints in groups for joint in joints]
    for joint in (joint for laws in whole for joint in joints_of(laws)):
        if joint not in known:
            raise ConfigError(
                f"Argument `laws` must name joints of the campaign, but names `{joint}`.",
                remedy=f"{did_you_mean(joint, known)}Joints with laws: {', '.join(known)}.",
            )

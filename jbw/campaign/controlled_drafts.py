"""Which kind a table of frequencies and amplitudes is: by what its columns hold."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import spearmanr

from jbw.campaign.roles import MOST_SAMPLES, Channel
from jbw.measurement.channels import Reals
from jbw.measurement.files.tree import Leaf, load
from jbw.measurement.records import INPUTS, RESPONSES, si_of
from jbw.measurement.response_checks import LOCKED

FEWEST = 4  # points by which a table is told from another
FOLLOWS = 0.9  # rank correlation of what goes together along a backbone
GROWS = 2.0  # times the least amplitude or force, that the largest is at least
SHIFTS = 0.3  # of the frequency at most along a backbone
SAME = 1e-6  # of a frequency that stays as it is


def controlled_kind(roles: Mapping[str, Channel], series: Mapping[str, Leaf]) -> str:
    """Kind of a controlled test, where frequencies and amplitudes say so; else nothing.

    A phase that stays makes a backbone, and so do a frequency and a force that go with the
    amplitude; frequencies that stay, or go back, make points of S-curves and of folded curves.
    """
    response = next((role for role in RESPONSES if role in roles), "")
    source = next((role for role in INPUTS if role in roles), "")
    if not response or "frequency" not in roles or "time" in roles:
        return ""
    columns = {role: _column(roles[role], series) for role in roles}
    hz, y, force = columns["frequency"], columns[response], columns.get(source)
    columns_read = [x for x in (hz, y, force) if x is not None]
    if hz is None or y is None or len({len(x) for x in columns_read}) > 1 or len(hz) < FEWEST:
        return ""
    if not all(np.all(x > 0) for x in columns_read):
        return ""
    phase = columns.get("phase")
    steps = np.diff(hz)
    goes_back = np.any(steps > SAME * hz.max()) and np.any(steps < -SAME * hz.max())
    stays = np.mean(np.abs(steps) < SAME * hz.max()) > 0.5
    if phase is not None:
        radians = np.unwrap(phase * si_of("phase", roles["phase"].unit or "rad")[0])
        if np.ptp(radians) < LOCKED and not stays:
            return "backbone"
        return "curve" if goes_back or stays else ""
    if force is not None and stays:
        return "curve"
    driven = y if force is None else force
    if y.max() < GROWS * y.min() or driven.max() < GROWS * driven.min():
        return ""
    together = spearmanr(y, hz if force is None else force).statistic
    shifts = 0 < np.ptp(hz) < SHIFTS * hz.max()
    return "backbone" if shifts and abs(together) > FOLLOWS else ""


def _column(channel: Channel, series: Mapping[str, Leaf]) -> Reals | None:
    """A column of finite real numbers; None where it is none."""
    leaf = series.get(channel.path)
    if leaf is None or max(leaf.shape, default=0) > MOST_SAMPLES:
        return None
    values = np.ravel(np.asarray(load(leaf)))
    if np.iscomplexobj(values) or not np.issubdtype(values.dtype, np.number):
        return None
    finite = values.astype(float)
    return finite if np.isfinite(finite).all() else None

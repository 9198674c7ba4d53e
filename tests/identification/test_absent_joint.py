"""A structure without a joint is answered by its fit: single records are left out."""

import numpy as np
import pytest

from jbw.inference.posterior.finding import Finding, judge
from jbw.study.collect import sees_no_joint


@pytest.mark.parametrize(("status", "unseen"), [("failed", True), ("ok", False)])
def test_single_records_are_left_out_where_no_joint_is_seen(status, unseen):
    finding = Finding("no_joint", status, "Without the joint chi-square grows.", np.nan)
    assert sees_no_joint(judge([finding])) is unseen
    assert not sees_no_joint(judge([Finding("r_hat", "failed", "High.", 1.2)]))

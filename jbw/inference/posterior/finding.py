"""What a look at a posterior found, and the verdict that follows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

Status = Literal["ok", "failed", "not assessed"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        code: Short name, such as "r_hat".
        status: ok, failed or not assessed.
        reason: One sentence with the worst quantity by name.
        number: The worst number; NaN where there is none.
        action: What to do; empty when ok.
    """

    code: str
    status: Status
    reason: str
    number: float
    action: str = ""


@dataclass(frozen=True)
class Verdict:
    """Everything that was looked at, and what follows.

    Attributes:
        status: failed if any finding failed, else not assessed if any could not be, else ok.
        findings: In the order they were looked at.
    """

    status: Status
    findings: tuple[Finding, ...]


def judge(findings: Iterable[Finding]) -> Verdict:
    """The verdict that follows from findings; one that says nothing is not assessed."""
    findings = tuple(findings)
    statuses = {finding.status for finding in findings}
    if "failed" in statuses:
        return Verdict("failed", findings)
    return Verdict("ok" if statuses == {"ok"} else "not assessed", findings)


def checked(code: str, ok: bool | np.bool_, reason: str, number: float, action: str) -> Finding:
    """A finding that is ok or failed; the action is for the failure."""
    return Finding(code, "ok" if ok else "failed", reason, float(number), "" if ok else action)

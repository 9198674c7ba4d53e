"""What a look at a posterior found, and the verdict that follows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

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
    """The verdict that follows from findings; one that says nothing is not assessed.

    Returns:
        The verdict.
    """
    found = tuple(findings)
    statuses = {finding.status for finding in found}
    if "failed" in statuses:
        return Verdict("failed", found)
    return Verdict("ok" if statuses == {"ok"} else "not assessed", found)


def limited(
    code: str, reason: str, number: float | int, limit: float | int, action: str
) -> Finding:
    """A finding that is ok up to a limit."""
    good = number <= limit
    return Finding(code, "ok" if good else "failed", reason, float(number), "" if good else action)

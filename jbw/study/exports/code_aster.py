"""Code_Aster: the joint's force and its equivalent damping as functions of the displacement."""

from pathlib import Path

from jbw.study.export import Export
from jbw.study.exports.program import Paths, Program, mirrored, number, write_text


def _card(folder: Path, result: Export) -> Paths:
    """The functions."""
    facts = {
        "force": [number(x) for x in mirrored(result.skeleton, "tip_force_n", odd=True)],
        "damping": [number(x) for x in mirrored(result.skeleton, "damping_ns_m", odd=False)],
    }
    return (write_text(folder / "joint.comm", "code_aster/joint.comm", result, **facts),)


CODE_ASTER = Program("code_aster", "Code_Aster", _card)

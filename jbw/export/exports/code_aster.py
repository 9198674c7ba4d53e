"""Code_Aster: the joint's force and its equivalent damping as functions of the displacement."""

from pathlib import Path

from jbw.export.exports.program import Paths, Program, mirrored, number, write_text
from jbw.export.one_joint import Export


def _card(folder: Path, result: Export) -> Paths:
    facts = {
        "force": [number(x) for x in mirrored(result.skeleton, "tip_force_n", odd=True)],
        "damping": [number(x) for x in mirrored(result.skeleton, "damping_ns_m", odd=False)],
    }
    return (write_text(folder / "joint.comm", "code_aster/joint.comm", result, **facts),)


CODE_ASTER = Program("code_aster", "Code_Aster", _card)

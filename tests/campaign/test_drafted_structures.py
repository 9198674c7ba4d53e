"""`jbw init` beside the matrices of a model: they are told from records, and drafted with them."""

import re

import numpy as np
import pytest
import scipy.io

from jbw.campaign.check import check_campaign
from jbw.campaign.draft import start_campaign, write_campaign
from jbw.errors import DataError
from jbw.rig import lapped_beams

MODEL = lapped_beams().model
TABLE = "row,node,direction\n" + "".join(
    f"{i},{dof.node},{dof.direction}\n" for i, dof in enumerate(MODEL.dofs, start=1)
)


def _one_file(folder):
    held = {"M": MODEL.mass.toarray(), "K": MODEL.stiffness.toarray()}
    scipy.io.savemat(
        folder / "beams.mat", held | {"dofs": np.array(list(map(str, MODEL.dofs)), object)}
    )


def _one_sparse_file(folder):
    held = {"M": MODEL.mass.tocsc(), "K": MODEL.stiffness.tocsc()}
    scipy.io.savemat(
        folder / "beams.mat", held | {"dofs": np.array(list(map(str, MODEL.dofs)), object)}
    )


def _a_file_each(folder):
    scipy.io.mmwrite(folder / "M.mtx", MODEL.mass.tocoo())
    scipy.io.mmwrite(folder / "beams_STIF1.mtx", MODEL.stiffness.tocoo())
    (folder / "rows.csv").write_text(TABLE)


def _sweep(folder):
    t = np.arange(8192) / 1024.0
    force = np.sin(2 * np.pi * (20.0 * t + 2.5 * t**2))
    ring = np.exp(-0.8 * t) * np.sin(2 * np.pi * 32.0 * t)
    response = np.convolve(force, ring)[: t.size] * 1e-3
    columns = np.c_[t, force, response + 1e-5 * np.random.default_rng(0).normal(size=t.size)]
    header = "time [s],force [N],velocity [m/s]"
    np.savetxt(folder / "sweep_1.csv", columns, delimiter=",", header=header, comments="")


@pytest.mark.parametrize("matrices", [_one_file, _one_sparse_file, _a_file_each])
def test_the_model_beside_records_is_drafted_and_runs_once_it_is_uncommented(tmp_path, matrices):
    _sweep(tmp_path)
    matrices(tmp_path)
    draft = start_campaign(tmp_path)
    assert draft.text.count("[[test]]\n") == 1  # the matrices are no record
    assert any("matrices of a model" in line for line in draft.assumed)
    path = write_campaign(draft, tmp_path)
    assert check_campaign(path).joints is None  # a comment until its places are filled in
    head, after = draft.text.split("before each of them.\n")
    block, rest = after.split("\n\n", 1)
    path.write_text("\n".join([f"{head}before each of them.", re.sub(r"(?m)^# ", "", block), rest]))
    assert check_campaign(path).joints.joints == ("bolt 1",)


def test_matrices_alone_are_named_with_what_they_lack(tmp_path):
    _one_file(tmp_path)
    with pytest.raises(DataError, match=r"contains only matrices .* beams\.mat"):
        start_campaign(tmp_path)


def test_records_named_like_matrices_are_records(tmp_path):
    _sweep(tmp_path)
    (tmp_path / "sweep_1.csv").rename(tmp_path / "k_1.csv")
    assert start_campaign(tmp_path).text.count("[[test]]\n") == 1

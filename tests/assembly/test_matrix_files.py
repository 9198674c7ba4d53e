"""Readers of matrices: each format gives what was written, and says what is wrong."""

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from jbw.assembly.dofs import Dof
from jbw.assembly.files.read import read_matrices
from jbw.assembly.units import SYSTEMS, in_si
from jbw.errors import ConfigError, DataError
from jbw.rig.assemblies import lapped_beams

RIG = lapped_beams().model
M, K = RIG.mass.toarray(), RIG.stiffness.toarray()
NAMES = [str(dof) for dof in RIG.dofs]
NUMBERS = {"z": 3, "ry": 5}
DIRECTIONS = [(int(dof.node), NUMBERS[dof.direction]) for dof in RIG.dofs]


def same(model, *, rtol=0.0, table=True):
    """The matrices of the rig, in any order of rows where the file names them."""
    order = [NAMES.index(str(dof)) for dof in model.dofs] if table else range(len(NAMES))
    pick = np.ix_(order, order)
    np.testing.assert_allclose(model.mass.toarray(), M[pick], rtol=rtol, atol=0)
    np.testing.assert_allclose(model.stiffness.toarray(), K[pick], rtol=rtol, atol=0)
    return model


@pytest.mark.parametrize("kind", [np.asarray, sp.csc_matrix])
@pytest.mark.parametrize("table", ["texts", "pairs", "triples"])
def test_matlab_v5(tmp_path, kind, table):
    dofs = {
        "texts": np.array(NAMES, dtype=object)[:, None],
        "pairs": np.array(DIRECTIONS, float),
        "triples": np.column_stack((np.arange(1, 19), DIRECTIONS)),
    }[table]
    path = tmp_path / "beams.mat"
    scipy.io.savemat(path, {"M": kind(M), "K": kind(K), "dofs": dofs, "note": "of a beam"})
    same(read_matrices(path, units="SI"))


@pytest.mark.parametrize("sparse", [False, True])
def test_matlab_v73(tmp_path, sparse):
    """As MATLAB R2023b lays out its files: axes in reverse, cells as references, 16-bit text."""
    path = tmp_path / "beams.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, matrix in (("M", M), ("K", K)):
            if sparse:
                group, columns = file.create_group(name), sp.csc_array(matrix)
                group.attrs["MATLAB_class"] = np.bytes_("double")
                group.attrs["MATLAB_sparse"] = np.uint64(matrix.shape[0])
                group["data"] = columns.data
                group["ir"] = columns.indices.astype(np.uint64)
                group["jc"] = columns.indptr.astype(np.uint64)
            else:
                file[name] = matrix.T
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
        texts = file.create_group("#refs#")
        links = np.empty((1, len(NAMES)), h5py.ref_dtype)
        for i, name in enumerate(NAMES):
            texts[str(i)] = np.array([[ord(letter)] for letter in name], np.uint16)
            links[0, i] = texts[str(i)].ref
        file["dofs"] = links
        file["dofs"].attrs["MATLAB_class"] = np.bytes_("cell")
    same(read_matrices(path, units="SI"))


def test_numpy_archives(tmp_path):
    path = tmp_path / "beams.npz"
    np.savez(path, M=M, K=K, C=2e-6 * K, dofs=np.array(NAMES))
    model = same(read_matrices(path, units="SI"))
    np.testing.assert_array_equal(model.damping.toarray(), 2e-6 * K)
    for name, matrix in (("M", M), ("K", K)):
        sp.save_npz(tmp_path / f"{name}.npz", sp.csr_array(matrix))
    files = {"mass": tmp_path / "M.npz", "stiffness": tmp_path / "K.npz", "dofs": NAMES}
    same(read_matrices(files, units="SI"))


def write_table(path, header=True, first=1, shuffled=False):
    rows = [f"{i + first},{n},{d}" for i, (n, d) in enumerate(DIRECTIONS)]
    if shuffled:
        rows = rows[::-1]
    path.write_text("\n".join([*(["row,node,direction"] if header else []), *rows]) + "\n")


@pytest.mark.parametrize("table", [{}, {"header": False}, {"first": 0}, {"shuffled": True}])
def test_matrix_market_with_a_table(tmp_path, table):
    for name, matrix in (("M", M), ("K", K)):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", sp.coo_array(matrix), precision=17)
    write_table(tmp_path / "dofs.csv", **table)
    files = {"mass": tmp_path / "M.mtx", "stiffness": tmp_path / "K.mtx"}
    same(read_matrices(files | {"dofs": tmp_path / "dofs.csv"}, units="SI"))
    bare = same(read_matrices(files, units="SI"), table=False)
    assert str(bare.dofs[0]) == "1:row"


def test_a_symmetric_matrix_market_file_holds_one_triangle(tmp_path):
    scipy.io.mmwrite(tmp_path / "K.mtx", sp.coo_array(K), precision=17, symmetry="symmetric")
    assert "symmetric" in (tmp_path / "K.mtx").read_text().splitlines()[0]
    same(read_matrices({"mass": M, "stiffness": tmp_path / "K.mtx", "dofs": NAMES}, units="SI"))


@pytest.mark.parametrize("form", ["matrix input", "labels", "coordinate", "both triangles"])
def test_abaqus(tmp_path, form):
    """Lines of *MATRIX GENERATE; symmetric matrices hold their lower triangle."""
    for name, matrix in (("M", M), ("K", K)):
        lines = ["** Assembled nodal matrix", "*MATRIX, NAME=STIFFNESS"]
        entries = np.argwhere(matrix if form == "both triangles" else np.tril(matrix))
        for i, j in entries:
            entry = f"{matrix[i, j]:.17e}"
            if form == "coordinate":
                lines.append(f"{i + 1} {j + 1} {entry}")
            elif form == "labels":
                lines.append("{} {} {} {} {}".format(*DIRECTIONS[i], *DIRECTIONS[j], entry))
            else:
                lines.append("{},{}, {},{}, {}".format(*DIRECTIONS[i], *DIRECTIONS[j], entry))
        (tmp_path / f"{name}.mtx").write_text("\n".join(lines) + "\n")
    files = {"mass": tmp_path / "M.mtx", "stiffness": tmp_path / "K.mtx"}
    if form == "coordinate":
        files["dofs"] = NAMES
    same(read_matrices(files, units="SI"))


def test_a_table_beside_names_of_rows_is_followed(tmp_path):
    lines = ["{},{}, {},{}, {:.17e}".format(*DIRECTIONS[i], *DIRECTIONS[j], K[i, j])
             for i, j in np.argwhere(np.tril(K))]  # fmt: skip
    (tmp_path / "K.mtx").write_text("\n".join(lines[::-1]))  # names in another order
    source = {"mass": M, "stiffness": tmp_path / "K.mtx", "dofs": NAMES}
    same(read_matrices(source, units="SI"))
    source["dofs"] = ["999:x", *NAMES[1:]]
    with pytest.raises(DataError, match="lacks `1:z` and 0 more"):
        read_matrices(source, units="SI")
    del source["dofs"]
    with pytest.raises(DataError, match="Either all matrices or none must"):
        read_matrices(source, units="SI")


def test_constrained_degrees_of_abaqus_are_left_out_and_said(tmp_path):
    """A fixed degree has 1e36 on the diagonal, and its mass stays in the mass matrix."""
    rows = {
        "M": "1,1, 1,1, 2.0\n2,1, 1,1, 0.5\n2,1, 2,1, 3.0\n",
        "K": "1,1, 1,1, 1.0e36\n2,1, 2,1, 300.0\n",
    }
    for name, text in rows.items():
        (tmp_path / f"{name}.mtx").write_text(text)
    model = read_matrices({"mass": tmp_path / "M.mtx", "stiffness": tmp_path / "K.mtx"}, units="SI")
    assert [str(dof) for dof in model.dofs] == ["2:x"]
    assert model.mass.toarray() == [[3.0]]
    assert model.notes == ("Degrees of freedom fixed by a stiffness above 1e+30: 1.",)


def test_matrices_in_memory():
    same(read_matrices({"mass": M, "stiffness": sp.csr_array(K), "dofs": NAMES}, units="SI"))
    same(read_matrices({"mass": M, "stiffness": K}, units="SI", dofs=NAMES))


@pytest.mark.parametrize(
    ("units", "stiffness", "damping", "mass"),
    [
        ("N-mm-t-s", 1e3, 1e3, 1e3),
        ("kN-mm-kg-ms", 1e6, 1e3, 1.0),  # kN/mm, kN ms/mm and kg
        ("lbf-in-s", 175.126835246476, 175.126835246476, 175.126835246476),  # lbf/in
    ],
)
def test_a_unit_of_stiffness_damping_and_mass_in_si(units, stiffness, damping, mass):
    found = [
        in_si(sp.csc_array([[1.0]]), [Dof("1", "z")], SYSTEMS[units], p)[0, 0] for p in range(3)
    ]
    assert found == pytest.approx([stiffness, damping, mass], rel=1e-12)


SMALL = """$ a comment
DMIG    KAAX           0       6       1       0                       4
DMIG    KAAX          17       1              17       1   300.0
DMIG    KAAX         112       1              17       1  -100.0
+            112       1   1.0+2
DMIG    MAAX           0       6       1       0                       4
DMIG    MAAX          17       1              17       1     2.0
DMIG    MAAX         112       1             112       1   1.0-0
"""
LARGE = """DMIG    KAAX    0       6       2       0                               4
DMIG*   KAAX                          17               1
*                     17               1 3.000000000D+02
DMIG*   KAAX                         112               1
*                     17               1-1.000000000D+02
*                    112               1 1.000000000D+02
DMIG    MAAX    0       6       2       0                               4
DMIG*   MAAX                          17               1
*                     17               1 2.000000000D+00
DMIG*   MAAX                         112               1
*                    112               1 1.000000000D+00
"""
FREE = """DMIG,KAAX,0,6,1,0,,,4
DMIG,KAAX,17,1,,17,1,300.0
DMIG,KAAX,112,1,,17,1,-100.0
+,112,1,100.0
DMIG,MAAX,0,6,1,0,,,4
DMIG,MAAX,17,1,,17,1,2.0
DMIG,MAAX,112,1,,112,1,1.0
"""


@pytest.mark.parametrize("text", [SMALL, LARGE, FREE], ids=["small", "large", "free"])
def test_dmig(tmp_path, text):
    """Entries as the Quick Reference Guide lays them out, of one triangle (form 6)."""
    path = tmp_path / "model.pch"
    path.write_text(text)
    model = read_matrices(path, units="SI")
    assert [str(dof) for dof in model.dofs] == ["17:x", "112:x"]
    np.testing.assert_array_equal(model.stiffness.toarray(), [[300, -100], [-100, 100]])
    np.testing.assert_array_equal(model.mass.toarray(), [[2, 0], [0, 1]])


def test_complex_dmig_is_refused(tmp_path):
    path = tmp_path / "model.pch"
    path.write_text(FREE.replace("KAAX,0,6,1", "KAAX,0,6,3"))
    with pytest.raises(DataError, match=r"Matrix KAAX of model\.pch must be real"):
        read_matrices(path, units="SI")
    path.write_text("$ nothing\n")
    with pytest.raises(DataError, match="must contain DMIG entries"):
        read_matrices(path, units="SI")


def test_dmig_that_pynastran_writes(tmp_path):
    try:
        from pyNastran.bdf.cards.dmig import DMIG
    except (ImportError, AttributeError) as error:
        pytest.skip(f"pyNastran does not load: {error}")
    text = ""
    for name, matrix in (("KAAX", K), ("MAAX", M)):
        rows, columns = np.nonzero(np.tril(matrix))
        card = DMIG(
            name, 6, 2, 0, 0, 0,
            [DIRECTIONS[j] for j in columns], [DIRECTIONS[i] for i in rows],
            list(matrix[rows, columns]),
        )  # fmt: skip
        text += card.write_card(size=16, is_double=True)
    (tmp_path / "model.pch").write_text(text)
    same(read_matrices(tmp_path / "model.pch", units="SI"), rtol=1e-8)  # digits of a field


def test_output4_that_pynastran_writes(tmp_path):
    """As text: of a binary file pyNastran 1.4.1 packs a row too many, and writes none."""
    try:
        from pyNastran.op2.result_objects.matrix import Matrix
        from pyNastran.op4.op4 import OP4
    except (ImportError, AttributeError) as error:
        pytest.skip(f"pyNastran does not load: {error}")
    matrices = {}
    for name, matrix in (("KAA", K), ("MAA", M)):
        matrices[name] = Matrix(name, form=6)
        matrices[name].data = matrix
    OP4(debug=False).write_op4(
        str(tmp_path / "model.op4"), matrices, precision="double", is_binary=False
    )
    same(read_matrices(tmp_path / "model.op4", units="SI", dofs=NAMES), rtol=1e-14)


def test_without_pynastran_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyNastran.op4.op4", None)
    (tmp_path / "model.op4").write_bytes(b"")
    with pytest.raises(
        DataError, match=r"pyNastran is needed to read model\.op4, but is not installed"
    ) as caught:
        read_matrices(tmp_path / "model.op4", units="SI")
    assert "DMIG" in caught.value.remedy


def test_what_a_file_lacks_is_said(tmp_path):
    np.savez(tmp_path / "beams.npz", mass=M, other=K)
    with pytest.raises(DataError, match="must hold the stiffness matrix as K, but holds") as caught:
        read_matrices(tmp_path / "beams.npz", units="SI")
    assert "mass, other" in caught.value.what
    with pytest.raises(DataError, match="does not exist"):
        read_matrices(tmp_path / "none.npz", units="SI")
    with pytest.raises(DataError, match="Matrices must be in a file of"):
        read_matrices(tmp_path / "model.full", units="SI")
    with pytest.raises(ConfigError, match="keys mass and stiffness") as caught:
        read_matrices({"M": M, "K": K}, units="SI")
    assert "{ mass = " in caught.value.remedy


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.mat", b"MATLAB 5.0 MAT-file" + bytes(200)),
        ("cut.npz", b"PK\x03\x04"),
        ("text.mtx", b"1, 1, one\n"),
        ("cut.mtx", b"%%MatrixMarket matrix coordinate real general\n3 3 5\n1 1 2.0\n"),
        ("four.mtx", b"1 1 1 2.0\n"),
        ("zero.mtx", b"0 0 2.0\n"),
    ],
)
def test_damaged_files_are_refused_by_name(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError) as caught:
        read_matrices({"mass": tmp_path / name, "stiffness": K}, units="SI")
    assert name in caught.value.what
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("1,17,x\n2,17,rx\n4,18,x\n", "row 4 is out of range"),
        ("0,17,x\n1,17,rx\n1,18,x\n", "row 2 is missing"),
        ("1,17,w\n", "Direction of node 17 must be"),
        ("one,17,x\ntwo,17,y\n", "must have columns node and direction"),
        ("1,17,x\n2,18\n", "must have 3 columns, but line 2 has 2"),
    ],
)
def test_faulty_tables_are_refused(tmp_path, text, what):
    (tmp_path / "dofs.csv").write_text(text)
    with pytest.raises(DataError, match=what):
        read_matrices({"mass": M, "stiffness": K, "dofs": tmp_path / "dofs.csv"}, units="SI")


# -- where nodes lie -------------------------------------------------------------------------------
PLACES = [(1, 0.1, 0.0, 0.0), (2, 0.2, 0.0, 0.0), (101, 0.25, 0.0, 0.005)]
IN_METRES = {str(node): tuple(where) for node, *where in PLACES}


@pytest.mark.parametrize("kind", ["mat", "npz", "files", "memory"])
def test_positions_of_nodes_are_read_beside_matrices(tmp_path, kind):
    arrays = {"M": M, "K": K, "dofs": np.array(NAMES), "nodes": np.array(PLACES)}
    source = tmp_path / f"beams.{kind}"
    if kind == "mat":
        scipy.io.savemat(source, arrays | {"dofs": np.array(NAMES, dtype=object)[:, None]})
    elif kind == "npz":
        np.savez(source, **arrays)
    else:
        table = tmp_path / "nodes.csv"
        lines = [",".join(map(str, place)) for place in PLACES]
        table.write_text("\n".join(["node,x,y,z", *lines]))
        source = {"mass": M, "stiffness": K, "dofs": NAMES}
        source["nodes"] = table if kind == "files" else PLACES
    assert dict(same(read_matrices(source, units="SI")).positions) == IN_METRES


def test_positions_are_in_the_unit_of_length_of_the_matrices():
    model = read_matrices(
        {"mass": M, "stiffness": K, "dofs": NAMES, "nodes": PLACES}, units="N-mm-t-s"
    )
    assert model.positions["101"] == pytest.approx((0.25e-3, 0.0, 5e-6))
    assert read_matrices({"mass": M, "stiffness": K}, units="SI").positions is None


@pytest.mark.parametrize("line", ["17,0.1,0.2", "17,0.1,0.2,here", "17,0.1,0.2,nan"])
def test_a_faulty_line_of_positions_is_refused(tmp_path, line):
    (tmp_path / "nodes.csv").write_text(f"node,x,y,z\n1,0,0,0\n{line}\n")
    with pytest.raises(DataError, match=r"nodes\.csv must be node, x, y and z") as caught:
        read_matrices({"mass": M, "stiffness": K, "nodes": tmp_path / "nodes.csv"}, units="SI")
    cure = caught.value.remedy.partition("such as `")[2].partition("`")[0]
    (tmp_path / "nodes.csv").write_text(f"node,x,y,z\n1,0,0,0\n{cure}\n")
    read_matrices({"mass": M, "stiffness": K, "nodes": tmp_path / "nodes.csv"}, units="SI")

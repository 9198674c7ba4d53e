"""The same samples twice in a campaign: refused, with both places named."""

import os
import shutil

import numpy as np
import pytest

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.campaign.together import ResponseOrigin, held_twice
from jbw.errors import DataError

FS = 100.0
# Noise that has nothing to do with its source is doubted, and is as good as any here.
pytestmark = pytest.mark.filterwarnings("ignore")


def record(seed):
    rng = np.random.default_rng(seed)
    return {
        "u": rng.standard_normal(2000),
        "v": rng.standard_normal(2000),
        "w": rng.standard_normal(2000),
    }


def table(files, name, more="", channel="v"):
    return f"""[[test]]
kind = "noise"
name = "{name}"
files = {files}
channels = {{ force = "u", velocity = "{channel}" }}
units = {{ force = "N", velocity = "m/s" }}
fs = {FS}
{more}
"""


@pytest.fixture
def folder(tmp_path):
    for seed in range(2):
        np.savez(tmp_path / f"run_{seed}.npz", **record(seed))
    return tmp_path


def campaign(folder, *tables):
    path = folder / "campaign.toml"
    path.write_text('[campaign]\nname = "twice"\nmodal_mass = 1.0\n' + "\n".join(tables))
    return path


def refused(path):
    """What a check refuses as the same; loading refuses the first of it as well."""
    faults = [f.what for row in check_campaign(path).rows for f in row.findings
              if f.severity == "error"]  # fmt: skip
    if faults:
        with pytest.raises(DataError) as caught:
            load_campaign(path)
        assert caught.value.what == faults[0]
    return faults


def test_one_file_under_two_tests(folder):
    path = campaign(folder, table('"run_*.npz"', "a"), table('"run_1.npz"', "b"))
    assert refused(path) == [
        "`run_1.npz` of test `b` contains the same samples as `run_1.npz` of test `a`."
    ]


def test_two_files_under_two_tests_are_sound(folder):
    path = campaign(folder, table('"run_0.npz"', "a"), table('"run_1.npz"', "b"))
    assert refused(path) == []


@pytest.mark.parametrize("how", ["copy", "symlink", "hard link", "written again"])
def test_a_copy_within_a_test(folder, how):
    source, other = folder / "run_1.npz", folder / "run_2.npz"
    if how == "copy":
        shutil.copy(source, other)
    elif how == "symlink":
        other.symlink_to(source)
    elif how == "hard link":
        os.link(source, other)
    else:  # other bytes, the same samples
        np.savez_compressed(other, **np.load(source))
    path = campaign(folder, table('"run_*.npz"', "a"))
    assert refused(path) == [
        "`run_2.npz` of test `a` contains the same samples as `run_1.npz` of test `a`."
    ]


def test_a_file_by_two_paths(folder):
    (folder / "sub").mkdir()
    path = campaign(folder, table('["run_1.npz", "sub/../run_1.npz"]', "a"))
    assert refused(path) == [
        "`run_1.npz` of test `a` contains the same samples as `run_1.npz` of test `a`."
    ]


@pytest.mark.parametrize(
    ("span", "severity"), [("[4.0, 14.0]", "error"), ("[7.0, 17.0]", "warning")]
)
def test_parts_that_overlap(folder, span, severity):
    first = table('"run_1.npz"', "a", "span = [0.0, 10.0]")
    path = campaign(folder, first, table('"run_1.npz"', "b", f"span = {span}"))
    (fault,) = [f for row in check_campaign(path).rows for f in row.findings if "shares" in f.what]
    assert fault.severity == severity
    share = "60%" if severity == "error" else "30%"
    assert fault.what == f"`run_1.npz` of test `b` shares {share} with `run_1.npz` of test `a`."


@pytest.mark.parametrize("more", ["span = [10.0, 20.0]", ""])
def test_other_parts_and_other_channels_are_sound(folder, more):
    first = table('"run_1.npz"', "a", "span = [0.0, 10.0]")
    second = table('"run_1.npz"', "b", more, channel="v" if more else "w")
    assert refused(campaign(folder, first, second)) == []


def test_other_bands_of_a_record_are_other_data(folder):
    first = table('"run_1.npz"', "a", "band = [5.0, 12.0]")
    second = table('"run_1.npz"', "b", "band = [20.0, 30.0]")
    assert refused(campaign(folder, first, second)) == []
    meeting = table('"run_1.npz"', "b", "band = [10.0, 30.0]")
    assert len(refused(campaign(folder, first, meeting))) == 1


def test_a_displacement_that_is_commanded_twice_is_sound(tmp_path):
    phase = np.arange(4000) * 2 * np.pi / 1000
    for i in range(2):
        noise = 1e-3 * np.random.default_rng(i).standard_normal(4000)
        force = np.sin(phase) + 0.3 * np.cos(phase) + noise
        np.savez(tmp_path / f"loop_{i}.npz", y=np.sin(phase), F=force)
    text = f"""[[test]]
kind = "loop"
files = "loop_*.npz"
channels = {{ displacement = "y", restoring_force = "F" }}
units = {{ displacement = "mm", restoring_force = "N" }}
fs = {FS}
"""
    path = campaign(tmp_path, text.replace("modal_mass = 1.0", ""))
    assert refused(path) == []
    shutil.copy(tmp_path / "loop_0.npz", tmp_path / "loop_2.npz")
    assert refused(path) == [
        "`loop_2.npz` of test `loop` contains the same samples as `loop_0.npz` of test `loop`."
    ]


def test_a_part_within_another_is_shared_whole(folder):
    """Four seconds of ten: all of the shorter part is in the longer one."""
    first = table('"run_1.npz"', "a", "span = [0.0, 10.0]")
    path = campaign(folder, first, table('"run_1.npz"', "b", "span = [2.0, 6.0]"))
    assert refused(path) == ["`run_1.npz` of test `b` shares 100% with `run_1.npz` of test `a`."]


@pytest.mark.parametrize(("tones", "is_same"), [((6.0,), False), ((5.0, 6.0), True), ((), True)])
def test_other_tones_of_a_record_are_other_data(tones, is_same):
    channel = ("a hash", "velocity", "")
    first, second = (
        ResponseOrigin(
            name, "run.npz", "velocity", "digest", channel, (0.0, 10.0), (0.0, np.inf), own
        )
        for name, own in (("a", (5.0,)), ("b", tones))
    )
    assert len(list(held_twice([first, second]))) == is_same


def remedies(path):
    return [f.remedy for row in check_campaign(path).rows for f in row.findings
            if f.severity == "error"]  # fmt: skip


def pasted(path, test, line):
    """The line in the table of a test, in the place of one of the same key."""
    head, name, rest = path.read_text().partition(f'name = "{test}"\n')
    key = line.partition(" = ")[0]
    table, mark, others = rest.partition("[[test]]")
    kept = "".join(x for x in table.splitlines(True) if not x.startswith(f"{key} ="))
    path.write_text(f"{head}{name}{line}\n{kept}{mark}{others}")


def test_records_of_two_tests_are_left_out_of_the_second_by_one_line(folder):
    """What the test leaves out already stays out."""
    for seed in (2, 3):
        np.savez(folder / f"run_{seed}.npz", **record(seed))
    first = table('["run_1.npz", "run_2.npz"]', "a")
    path = campaign(folder, first, table('"run_*.npz"', "b", 'exclude = ["run_3.npz"]'))
    told = remedies(path)
    line = 'exclude = ["run_3.npz", "run_1.npz", "run_2.npz"]'
    assert told == [f"Put under [[test]]: `{line}`."] * 2
    pasted(path, "b", line)
    assert refused(path) == []
    names = [[record.name for record in test.records] for test in load_campaign(path).tests]
    assert names == [["run_1.npz", "run_2.npz"], ["run_0.npz"]]


def test_a_test_of_which_all_records_are_in_another_is_left_out(folder):
    path = campaign(folder, table('"run_*.npz"', "a"), table('"run_1.npz"', "b"))
    assert remedies(path) == ["Leave the test out."]


def test_a_file_that_is_named_twice_is_not_excluded_by_its_name(folder):
    (folder / "sub").mkdir()
    path = campaign(folder, table('["run_1.npz", "sub/../run_1.npz"]', "a"))
    assert remedies(path) == ["Name each file once in `files`."]


def test_the_part_that_no_other_test_holds_is_told_as_a_span(folder):
    first = table('"run_1.npz"', "a", "span = [0.0, 10.0]")
    path = campaign(folder, first, table('"run_1.npz"', "b", "span = [4.0, 14.0]"))
    line = "span = [10.0, 14.0]"
    assert remedies(path) == [f"Put under [[test]]: `{line}`, a part that no other test contains."]
    pasted(path, "b", line)
    assert refused(path) == []
    assert [test.records[0].num_samples for test in load_campaign(path).tests] == [1000, 400]

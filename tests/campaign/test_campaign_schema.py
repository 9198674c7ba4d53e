"""The campaign file: strict, all errors at once, each with its key and remedy."""

import re
import time
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.campaign.schema import parse, read_spec
from jbw.campaign.settings import Identify
from jbw.errors import ConfigError

GOOD = """
[campaign]
name = "beam"
gain = 15.0
[[test]]
kind = "sweep"
files = "sweep_*.h5"
level = 0.2
channels = { input = "shaker", velocity = "laser" }
units = { input = "V", velocity = "mm/s" }
band = [5.0, 40.0]
[identify]
fit_levels = [0.2]
num_chains = 4
[identify.prior]
omega_n = [100.0, 130.0]
alpha = [400.0, 600.0]
"""


def refused(text):
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return str(caught.value)


def changed(old, new):
    assert old in GOOD
    return GOOD.replace(old, new)


def test_good_file():
    spec = parse(GOOD)
    assert (spec.name, spec.gain, spec.modal_mass) == ("beam", 15.0, None)
    (test,) = spec.tests
    assert (test.kind, test.files, test.band) == ("sweep", ("sweep_*.h5",), (5.0, 40.0))
    assert spec.settings["prior"] == {"omega_n": (100.0, 130.0), "alpha": (400.0, 600.0)}


@pytest.mark.fault(25, 27, 52)
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("gain =", "gian =", "[campaign] gian: unknown key; did you mean `gain`"),
        ("level =", "levle =", "[[test]] 1 levle: unknown key; did you mean `level`"),
        ("num_chains", "num_chain", "did you mean `num_chains`"),
        ("[identify]", "[identfy]", "unknown table; did you mean `identify`"),
        ('"sweep"', '"sweeep"', "kind: 'sweeep' is unknown; did you mean `sweep`"),
        ('velocity = "laser"', 'velocty = "laser"', "role `velocty` is unknown; did you mean"),
        ("15.0", '"15"', "[campaign] gain: must be a number, but is '15'"),
        ("15.0", "-1.0", "gain: must be positive, but is -1.0"),
        ("15.0", "nan", "gain: must be finite"),
        ("15.0", "true", "gain: must be a number, but is True"),
        ("gain = 15.0", "gain = 15.0\nmodal_mass = 2.0", "gain or modal_mass, not both"),
        ("[5.0, 40.0]", "[40.0, 5.0]", "band: must be [lower, upper] with lower < upper"),
        ("num_chains = 4", "num_chains = 0", "whole number of at least 1, but is 0"),
        ("num_chains = 4", "budget_s = 0.0", "budget_s: must be positive"),
        ("num_chains = 4", "num_chains = 2.5", "whole number of at least 1, but is 2.5"),
        ('"mm/s"', '"mm\\\\s"', "Did you mean `mm/s`?"),
        ('"mm/s"', '"V"', "`V` measures a voltage, but a velocity is needed"),
        ("[0.2]", "[0.3]", "no test has level 0.3; levels: 0.2"),
        ("num_chains = 4", 'fit = ["s_2"]', "State tests by name in hold_out"),
        ("[100.0, 130.0]", "[130.0, 100.0]", "prior: omega_n: must be [lower, upper]"),
        ("[100.0, 130.0]", "[100.0, nan]", "prior: omega_n: must be finite"),
        ("[100.0, 130.0]", "[100.0, 100.0]", "prior: omega_n: must be [lower, upper]"),
        ("[100.0, 130.0]", "[-1.0, 130.0]", "omega_n: must be positive"),
        ("[400.0, 600.0]", "[400.0, 10000.0]", "alpha < omega_n^2 must hold"),
        ("omega_n =", "omega =", "unknown parameter; did you mean `omega_n`"),
        ('files = "sweep_*.h5"', "files = 3", "files: must be a string or a list of strings"),
        ('files = "sweep_*.h5"', "", "files: missing"),
        ('input = "shaker", ', "", "kind `sweep` needs `input`, `force` or `base`"),
        ('"sweep"', '"tones"', "tones: missing"),
        ('"sweep"', '"stepped"', "dwell: missing"),
        ('"sweep"', '"loop"', "needs `displacement` and `restoring_force`"),
        ('"sweep"', '"frf"', "kind `frf` needs `frequency`"),
        (
            "level = 0.2",
            'amplitudes = "rms"',
            "amplitudes: for kind `frf`, `backbone`, `curve` only",
        ),
        ("level = 0.2", 'gaps = "mask"', "gaps: kind `sweep` needs every sample"),
        ("level = 0.2", "periods = 0", "periods: must be a whole number of at least 1"),
        ('"sweep_*.h5"', '{ input = "a.mat" }', "must name a file for each role (input, velocity)"),
        ('"sweep_*.h5"', '{ inptu = "a.mat" }', "did you mean `input`"),
        ('name = "beam"', 'name = "beam"\nname = "b"', "not valid TOML"),
        ("[campaign]", "!!python/object:os.system", "not valid TOML"),
    ],
)
def test_each_error_names_key_and_remedy(old, new, says):
    assert says in refused(changed(old, new))


WRITE = re.compile(r"Write line (\d+) as `([^`]+)`")


@pytest.mark.fault(52)
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"sweep"', "“sweep”", "line 6 has typographic characters, “ ”"),
        ('"sweep"', "„sweep“", "typographic"),
        ('"sweep"', "«sweep»", "typographic"),
        ('"sweep"', "\u2018sweep\u2019", "typographic"),
        ('"sweep_*.h5"', '"sweep_*.h5”', "line 7 has typographic"),
        ('"shaker", velocity = "laser"', "“shaker”, velocity = “laser”", "line 9 has typographic"),
        ("level = 0.2", "level\u00a0= 0.2", "a wide blank"),
        ("level = 0.2", "level = 0.2\ndelay = −0.2", "typographic characters, −,"),
        ('"sweep_*.h5"', r'"C:\data\x.csv"', "line 7 has a backslash in double quotes"),
        ('"sweep_*.h5"', r'"C:\Users\x.csv"', "line 7 has a backslash in double quotes"),
        ('"sweep_*.h5"', r"C:\data\x.csv", "line 7 has a word without quotes"),
        ("level = 0.2", "level = 0,2", "line 8 has a decimal comma"),
        ("[5.0, 40.0]", "[5,05, 40,0]", "line 11 has a decimal comma"),
        ("level = 0.2", "level = .2", "line 8 has a number without a digit before or after"),
        ('kind = "sweep"', "kind = sweep  # up", "line 6 has a word without quotes"),
        ('"mm/s"', "mm/s", "line 10 has a word without quotes"),
        ("level = 0.2", "level = 0.2\nremove_mean = True", "line 9 has a word without quotes"),
    ],
)
def test_a_slip_against_toml_is_named_and_its_line_cures(old, new, says):
    text = changed(old, new)
    message = refused(text)
    assert says in message
    ((number, line),) = WRITE.findall(message)
    lines = text.split("\n")
    lines[int(number) - 1] = line
    parse("\n".join(lines))


REMOVE = re.compile(r"remove line (\d+)")


@pytest.mark.fault(52)
@pytest.mark.parametrize(
    ("stated", "pasted", "key", "values"),
    [
        ("scale = { velocity = 2.0 }", "scale.input = -1.0", "scale",
         {"velocity": 2.0, "input": -1.0}),
        ("scale = { velocity = 2.0 }", "scale.velocity = -0.5", "scale", {"velocity": -1.0}),
        ("scale.input = -1.0", "scale = { velocity = 2.0 }", "scale",
         {"velocity": 2.0, "input": -1.0}),
    ],
)  # fmt: skip
def test_a_pasted_line_is_put_into_the_table_that_stands(stated, pasted, key, values):
    """What `jbw` prints for one role, in a test that states another: one line for both."""
    text = changed("level = 0.2", f"level = 0.2\n{stated}\n{pasted}")
    message = refused(text)
    assert "lines 9 and 10 both state `scale`" in message
    ((number, line),) = WRITE.findall(message)
    (removed,) = REMOVE.findall(message)
    lines = text.split("\n")
    lines[int(number) - 1] = line
    del lines[int(removed) - 1]
    assert getattr(parse("\n".join(lines)).tests[0], key) == values


def test_a_key_or_a_table_that_stands_twice_is_named():
    text = changed("level = 0.2", "level = 0.2\nsettle = 1.0\nsettle = 2.1")
    assert "line 10 states `settle` again, after line 9. Keep only one of" in " ".join(
        refused(text).split()
    )
    roles = changed("level = 0.2", "level = 0.2\nscale.input = 2.0\nscale.velocity = “1.0”")
    assert "line 10 has typographic characters" in refused(roles)
    first = GOOD.split("\n").index("[identify]") + 1
    again = refused(f"{GOOD}\n[identify]\nseed = 3\n")
    assert f"opens [identify] again, after line {first}." in again
    assert f"to the keys below line {first}" in again


@pytest.mark.parametrize("factors", ['{ input = "2" }\nscale.input = "3"',
                                     '{ input = "ab" }\nscale.input = 1000000000'])  # fmt: skip
def test_a_role_that_has_two_factors_of_text_is_refused(factors):
    assert "not valid TOML" in refused(changed("level = 0.2", f"level = 0.2\nscale = {factors}"))


def test_a_slip_before_what_is_nested_too_deeply_is_refused():
    """The text without the slip is read as far as Python follows it."""
    assert "not valid TOML" in refused(f"seed = .5\ndeep = {'[' * 5000}\n")


def test_slips_in_several_lines_are_told_of():
    text = changed('"sweep"', "“sweep”").replace('"beam"', "“beam”")
    assert (
        'Write line 3 as `name = "beam"`. Line 6 has the same mistake: correct that line too.'
        in refused(text)
    )


def test_an_escape_that_a_path_became_is_named():
    message = refused(changed('"sweep_*.h5"', r'"data\new\sweep.h5"').replace("\\s", "\\t"))
    (path,) = re.findall(r'Write forward slashes: ("[^"]+")', message)
    assert path == '"data/new/tweep.h5"'
    assert parse(changed('"sweep_*.h5"', path)).tests[0].files == ("data/new/tweep.h5",)


def test_decimal_commas_between_bounds_are_named():
    message = refused(changed("[5.0, 40.0]", "[5,5, 40,25]"))
    (band,) = re.findall(r"with decimal points, write (\[[^]]+\])", message)
    assert parse(changed("[5.0, 40.0]", band)).tests[0].band == (5.5, 40.25)


@pytest.mark.fault(52)
def test_all_errors_at_once():
    text = changed("gain", "gian").replace('"mm/s"', '"m/blink"').replace("= 4", "= -4")
    message = refused(text)
    assert "3 errors" in message
    assert all(word in message for word in ("gian", "m/blink", "num_chains"))


def test_no_test_at_all():
    assert "[[test]]: at least one" in refused("[campaign]\nname = 'x'")


def test_repeated_names():
    block = GOOD[GOOD.index("[[test]]") : GOOD.index("[identify]")] + 'name = "a"\n'
    assert "'a' is given to 2 tests" in refused(f"{block}\n{block}")


@settings(max_examples=60, deadline=None)
@given(text=st.text(max_size=80))
def test_any_text_is_refused_plainly(text):
    with pytest.raises(ConfigError):
        parse(text)


JOINT = "[joint]\nlaws = {laws}\n[[test]]"


@pytest.mark.parametrize(
    ("laws", "says"),
    [
        ('["bouc_wenn"]', "[joint] laws: Unknown law `bouc_wenn`; did you mean `bouc_wen`"),
        ('["bouc_wen", "bouc_wen"]', "[joint] laws: "),
        (
            '["cubic"]',
            "[identify] prior: alpha: unknown parameter of the chosen laws; law `bouc_wen` has",
        ),
        ("[]", "alpha: unknown parameter of the chosen laws; law `bouc_wen` has this parameter"),
        ('[""]', "[joint] laws: must be a string or a list of strings"),
        ("3", "[joint] laws: must be a string or a list of strings"),
    ],
)
def test_laws_that_cannot_be_meant(laws, says):
    assert says in refused(changed("[[test]]", JOINT.format(laws=laws)))


def test_laws_of_a_campaign():
    assert parse(GOOD).laws == ("bouc_wen",)
    assert parse(GOOD + "cubic = [0.0, 1e9]\n").laws == ("bouc_wen", "cubic")
    both = changed("[[test]]", JOINT.format(laws='["cubic", "bouc_wen"]'))
    assert parse(both + "cubic = [0.0, 1e9]\n").laws == ("cubic", "bouc_wen")
    alone = changed("[[test]]", JOINT.format(laws='"bouc_wen"')) + "cubic = [0.0, 1e9]\n"
    assert "cubic: unknown parameter of the chosen laws; law `cubic` has this" in refused(alone)
    linear = changed("[[test]]", JOINT.format(laws="[]")).replace("alpha = [400.0, 600.0]", "")
    assert parse(linear).laws == ()


def test_a_prior_beyond_what_the_laws_table_admits():
    text = changed("[[test]]", JOINT.format(laws='"jenkins_2"')).replace("alpha =", "slip_3 =")
    assert "slip_3: unknown parameter; did you mean `slip_" in refused(text)
    text = text.replace("slip_3 =", "slip_1 =").replace("[400.0, 600.0]", "[-1.0, 1.0]")
    assert "slip_1: must be positive, but its lower bound is -1" in refused(text)
    text = text.replace("slip_1 =", "slip_ratio_2 =").replace("[-1.0, 1.0]", "[0.5, 2.0]")
    assert "slip_ratio_2: must be at least 1, but its lower bound is 0.5" in refused(text)
    text = (
        text.replace("[0.5, 2.0]", "[-1.0, 1.0]")
        .replace("slip_ratio_2 =", "stiffness_2 =")
        .replace("[-1.0, 1.0]", "[1.0, 1e4]")
    )
    assert "stiffness_2 < omega_n^2 must hold everywhere" in refused(text)


def test_settings_of_a_script_are_checked_like_the_file():
    found = Identify.of({"num_chains": 2, "prior": {"zeta": [0.1, 0.2]}})
    assert dict(found) == {"num_chains": 2, "prior": {"zeta": (0.1, 0.2)}}
    assert (found.seed, found.draws((20, 30))) == (0, (20, 30))
    assert Identify.of({**found, "num_samples": 7}).draws((20, 30)) == (20, 7)
    with pytest.raises(ConfigError, match="num_chain: unknown key; did you mean `num_chains`"):
        Identify.of({"num_chain": 2})


ASSEMBLY = """
[assembly]
name = "beam 3"
torque = 8.0
sequence = 2
temperature = -3.5
"""


def test_an_assembly_states_what_a_fleet_needs():
    found = parse(GOOD + ASSEMBLY).assembly
    assert (found.name, found.torque, found.sequence, found.temperature) == ("beam 3", 8.0, 2, -3.5)
    assert parse(GOOD).assembly.torque is None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("torque = 0.0", "[assembly] torque: must be positive"),
        ("torque = -8", "[assembly] torque: must be positive"),
        ("sequence = 1.5", "[assembly] sequence: must be"),
        ("torqe = 8.0", "[assembly] torqe: unknown key; did you mean `torque`"),
    ],
)
def test_a_wrong_assembly_is_refused(line, message):
    assert message in refused(f"{GOOD}\n[assembly]\n{line}\n")


def test_one_torque_is_not_for_several_assemblies():
    head, rest = GOOD.split("[identify]", 1)
    test = head[head.index("[[test]]") :]
    two = head + "assembly = 'a'\n" + test + "assembly = 'b'\n[identify]" + rest
    assert parse(two).assembly.name == ""
    assert "[assembly]: describes one assembly, but the campaign has 2: a, b" in refused(
        two + "[assembly]\ntorque = 8.0\n"
    )


TEST = '[[test]]\nkind = "decay"\nfiles = "a.h5"\nchannels = { velocity = "v" }\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (TEST + "\n".join(f"k{i} = 1" for i in range(60_000)), "60000 unknown keys: k0, k1, k2"),
        (TEST + "\n".join(f"[t{i}]" for i in range(60_000)), "59980 more unknown tables"),
        ((TEST + "bad = 1\n") * 10_000, "has 10000 errors"),
    ],
)
def test_many_unknown_keys_take_bounded_time_and_words(text, says):
    begin = time.process_time()
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert says in caught.value.what
    assert len(str(caught.value)) < 100_000
    assert time.process_time() - begin < 20.0  # 70 us a key, where it took 2 ms and a word each


def test_a_campaign_file_that_holds_samples_is_refused_by_its_size(tmp_path):
    path = tmp_path / "campaign.toml"
    path.write_text(TEST + "\n".join(f"key_{i} = 1" for i in range(1_000_000)))
    begin = time.process_time()
    with pytest.raises(ConfigError, match="must be of 1 MiB at most"):
        read_spec(path)
    assert time.process_time() - begin < 1.0


@pytest.mark.parametrize(
    ("line", "expected"),
    [("", ("linear",)), ("compare_with = []", ()), ('compare_with = "cubic"', ("cubic",))],
)
def test_references_are_one_several_or_none(line, expected):
    assert Identify.of(tomllib.loads(line)).compare_with == expected

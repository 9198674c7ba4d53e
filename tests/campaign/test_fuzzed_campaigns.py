"""Any campaign or plan file: taken, or refused with the file's name; nothing else comes out."""

import random
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from jbw.campaign.schema import parse, read_spec
from jbw.campaign.settings import Identify
from jbw.campaign.tables import Head, TestSpec
from jbw.errors import ConfigError
from jbw.measurement.kinds import KINDS
from jbw.planning import EXAMPLE
from jbw.planning.description import parse as parse_plan
from jbw.planning.description import plan_table, read_description
from jbw.planning.proposals import SweepTable, TonesTable

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
[[test]]
kind = "stepped"
files = ["a.mat", "b.mat"]
fs = "Fs"
tones = [2.0, 3.0]
dwell = 2.0
settle = 1.0
channels = { force = "F[0]", displacement = "x - y" }
units = { force = "kN", displacement = "um" }
exclude = [0, "b*"]
[identify]
fit_levels = [0.2]
num_chains = 4
hold_out = "x"
[identify.prior]
omega_n = [100.0, 130.0]
alpha = [400.0, 600.0]
"""

PLAN = plan_table(("bouc_wen",)).model_fields

TEXTS = st.one_of(
    st.text(max_size=8),
    st.sampled_from(["V", "m/s", "../../x", "<script>alert(1)</script>", "\x1b[31m", "[/x]", "\0"]),
)
# TOML's own numbers, of which whole ones have no end.
NUMBERS = st.one_of(
    st.integers(), st.floats(), st.sampled_from([10**400, -(10**400), 0, -1, float("nan")])
)
VALUES = st.recursive(
    st.one_of(NUMBERS, st.booleans(), TEXTS, st.just("1979-05-27T07:32:00Z")),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(
            st.sampled_from(["input", "velocity", "omega_n", "zeta", "a b", "\x1b"]), inner,
            max_size=3,
        ),
    ),
    max_leaves=8,
)  # fmt: skip


def toml(value) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{quoted(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    units = "".join(f"\\U{ord(c):08x}" for c in text if not 0xD800 <= ord(c) < 0xE000)
    return f'"{units}"'


def table(heading, values) -> list[str]:
    return [heading, *(f"{quoted(key)} = {toml(value)}" for key, value in values.items())]


def some_of(keys, **always):
    """A table with some of the right keys, a few wrong ones, and whatever values."""
    names = st.one_of(st.sampled_from([*keys, "knd", "__class__"]), st.text(max_size=5))
    return st.dictionaries(names, VALUES, max_size=5).map(lambda drawn: drawn | always)


def taken_or_refused(check: Callable, source, file: str) -> None:
    """Call a check; its refusal must name the file, and hold nothing that steers a terminal."""
    try:
        found = check(source)
    except ConfigError as error:
        refused = str(error)
    else:
        assert found is not None
        return
    assert file in refused
    assert all(c.isprintable() or c == "\n" for c in refused)


@pytest.mark.fault(52)
@settings(max_examples=80, deadline=5000, suppress_health_check=list(HealthCheck))
@given(
    campaign=some_of(Head.model_fields),
    test=some_of(TestSpec.model_fields),
    identify=some_of(Identify.model_fields),
    kind=st.sampled_from(list(KINDS)),
)
@example(campaign={"gain": 10**400}, test={}, identify={}, kind="sweep")
@example(campaign={"name": "\x1b[2J"}, test={"\x1b[2J": 1}, identify={}, kind="sweep")
def test_any_values_under_any_keys(campaign, test, identify, kind):
    tables = {"[campaign]": campaign, "[[test]]": {"kind": kind} | test, "[identify]": identify}
    source = "\n".join(line for item in tables.items() for line in table(*item))

    def parsed(text):
        spec = parse(text)
        assert set(identify) <= set(Identify.model_fields)
        assert set(test) <= set(TestSpec.model_fields)
        assert spec.tests[0].channels
        return spec

    taken_or_refused(parsed, source, "campaign.toml")


@pytest.mark.fault(52)
@settings(max_examples=50, deadline=5000, suppress_health_check=list(HealthCheck))
@given(
    plan=some_of(PLAN, noise=1e-5, delta=3.0),
    sweep=some_of(SweepTable.model_fields),
    tones=some_of(TonesTable.model_fields),
    of_run=st.booleans(),
)
def test_any_values_of_a_plan(plan, sweep, tones, of_run):
    tables = {"[plan]": plan, "[sweep]": sweep, "[tones]": tones}
    source = "\n".join(line for item in tables.items() for line in table(*item))
    taken_or_refused(lambda text: parse_plan(text, of_run=of_run), source, "plan.toml")


PIECES = [
    b"nan", b"-inf", b"1e400", b"[]", b"{}", b"''", b"[[test]]", b"[campaign.x]", b"=", b"\0",
    b"\x1b[31m", b"\xff", b"\xef\xbb\xbf", b"[" * 2000, b"a." * 2000 + b"a = 1\n", b"'''", b"\\",
    b"1979-05-27", b"1" * 5000, b'"\\uD800"', b"true", b"[1, 'a']", b"\r", b"#",
]  # fmt: skip


def mutated(source: bytes, rng: random.Random) -> bytes:
    """A file with a few pieces put in, taken out, or in the place of a value."""
    for _ in range(rng.randint(1, 4)):
        place = rng.randrange(len(source) + 1)
        how = rng.choice(["insert", "remove", "byte", "value", "cut"])
        if how == "insert":
            source = source[:place] + rng.choice(PIECES) + source[place:]
        elif how == "remove":
            source = source[:place] + source[place + rng.randint(1, 20) :]
        elif how == "byte":
            source = source[:place] + bytes([rng.randrange(256)]) + source[place + 1 :]
        elif how == "cut" and rng.random() < 0.2:
            source = source[:place]
        else:
            lines = source.split(b"\n")
            given_ = [i for i, line in enumerate(lines) if b"=" in line]
            if given_:
                i = rng.choice(given_)
                lines[i] = lines[i].partition(b"=")[0] + b"= " + rng.choice(PIECES)
            source = b"\n".join(lines)
    return source


def bytes_are_taken_or_refused(folder, seed):
    rng = random.Random(seed)
    for name, source, check in (("c.toml", GOOD, read_spec), ("p.toml", EXAMPLE, read_description)):
        (folder / name).write_bytes(mutated(source.encode(), rng))
        taken_or_refused(check, folder / name, name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzzed")


@pytest.mark.fault(52)
@settings(max_examples=200, deadline=5000, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0))
def test_any_bytes(folder, seed):
    bytes_are_taken_or_refused(folder, seed)


@pytest.mark.release  # the same with fewer examples stands above
@pytest.mark.fault(52)
@settings(max_examples=10_000, deadline=5000, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0))
def test_very_many_bytes(folder, seed):
    bytes_are_taken_or_refused(folder, seed)

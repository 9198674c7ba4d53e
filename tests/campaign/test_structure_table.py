"""The [structure] table: what it takes, and what it refuses."""

import pytest

from jbw.campaign.load import Campaign
from jbw.campaign.schema import parse
from jbw.campaign.settings import Structured
from jbw.errors import ConfigError

TEXT = """[structure]
{}
[[test]]
name = "one"
kind = "{}"
files = "a.h5"
channels = {{ input = "u", velocity = "v" }}
units = {{ input = "V", velocity = "m/s" }}
"""


def parsed(stated, kind="sweep"):
    return parse(TEXT.format(stated, kind))


def test_a_campaign_in_memory_takes_the_keys_of_its_table(tmp_path):
    campaign = Campaign("beam", tmp_path, (), structure={"modes": (18.8, 57.2)})
    assert campaign.structure == Structured(modes=(18.8, 57.2))
    assert Campaign("beam", tmp_path, ()).structure is None
    with pytest.raises(ConfigError, match="Argument `structure`") as caught:
        Campaign("beam", tmp_path, (), structure={"mode": (18.8, 57.2)})
    assert "modes" in str(caught.value)


def test_modes_and_what_is_known_of_them_are_read():
    found = parsed(
        "modes = [18.8, 57.2]\ndriving_point = true\njoint_shape = [1.0, -0.8]"
    ).structure
    assert found is not None
    assert (found.modes, found.driving_point) == ((18.8, 57.2), True)
    assert found.joint_shape == (1.0, -0.8)
    assert (
        parse(
            TEXT.partition("[[test]]")[1] + TEXT.format("", "sweep").partition("[[test]]")[2]
        ).structure
        is None
    )


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("driving_point = true", r"\[structure\] modes: missing"),
        ("modes = [18.8, 18.8]", "must not repeat a frequency"),
        ("modes = [18.8, -57.2]", "must be positive"),
        ("modes = [1, 2, 3, 4, 5, 6]", "must be 5 at most, but are 6"),
        (
            "modes = [18.8, 57.2]\njoint_shape = [1.0]",
            "joint_shape: must have one number per mode, 2",
        ),
        ("modes = [18.8, 57.2]\njoint_shape = [1.0, 0]", "joint_shape: must not contain a 0"),
        ("modes = [18.8, 57.2]\nmode = 2", "unknown key; did you mean `modes`"),
    ],
)
def test_what_cannot_be_meant_is_refused(stated, said):
    with pytest.raises(ConfigError, match=said):
        parsed(stated)


def test_kinds_that_know_one_mode_are_refused_by_name():
    with pytest.raises(ConfigError, match=r"test `one` is of kind `noise`, .* leave the test out"):
        parsed("modes = [18.8, 57.2]", "noise")
    assert parsed("modes = [18.8]", "noise").structure is not None
    for kind in ("multisine", "decay"):
        assert parsed("modes = [18.8, 57.2]", kind).structure is not None


def test_priors_know_the_modes_parameters():
    text = TEXT.format("modes = [18.8, 57.2]", "sweep")
    found = parse(text + "[identify.prior]\nshape_2 = [0.5, 2.0]\n")
    assert found.settings.prior["shape_2"] == (0.5, 2.0)
    with pytest.raises(ConfigError, match="zeta_2: must be positive"):
        parse(text + "[identify.prior]\nzeta_2 = [-0.1, 0.1]\n")
    with pytest.raises(ConfigError, match="shape_3: unknown parameter"):
        parse(text + "[identify.prior]\nshape_3 = [0.5, 2.0]\n")


TWO = 'modes = [18.8, 57.2]\npoints = ["wing", "tip"]'
SEEN = 'points = { wing = "w", tip = "t" }\n'


def test_a_test_of_several_points_is_one_of_each():
    """The same records, another channel of the response, one run, and held out together."""
    text = TEXT.format(TWO, "sweep") + SEEN + '[identify]\nhold_out = ["one"]'
    tests = parse(text).tests
    assert [(test.name, test.point, test.run) for test in tests] == [
        ("one", "", "one"), ("one at wing", "wing", "one"), ("one at tip", "tip", "one"),
    ]  # fmt: skip
    assert [test.channels["velocity"] for test in tests] == ["v", "w", "t"]
    assert parse(text).settings.hold_out == ("one", "one at wing", "one at tip")


@pytest.mark.parametrize(
    ("stated", "added", "said"),
    [
        ("modes = [18.8, 57.2]", SEEN, "must name `wing`, where test `one` has a response, but"),
        (TWO, 'point = "nose"', "must name `nose`, .* but names wing, tip"),
        (TWO, 'point = "tip"\n' + SEEN, "points: must differ from `tip`"),
        (TWO, "points = {}", "must be a table such as"),
        (TWO, "points = { wing = 3 }", "`wing` needs a channel's name or path, but has 3"),
        ('modes = [18.8]\npoints = ["wing"]', "", "points: need two modes or more"),
        (
            'modes = [18.8, 57.2]\npoints = ["a", "a"]',
            "",
            "points: must be at most 4 different",
        ),
    ],
)
def test_points_that_cannot_be_meant_are_refused(stated, added, said):
    with pytest.raises(ConfigError, match=said):
        parse(TEXT.format(stated, "sweep") + added)

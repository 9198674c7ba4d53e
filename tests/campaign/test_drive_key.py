"""The key `drive`: where the campaign file contradicts itself, and which gain is whose."""

import pytest

from jbw.campaign.schema import parse
from jbw.campaign.tables import force_per_unit, gain_of
from jbw.errors import ConfigError

SOURCES = {
    "voltage": 'channels = { input = "u", velocity = "v" }\nunits = { input = "V" }',
    "force": 'channels = { force = "f", velocity = "v" }',
    "both": 'channels = { input = "u", force = "f", velocity = "v" }\nunits = { input = "V" }',
    "free": 'channels = { velocity = "v" }',
}


def campaign(*tests, head=""):
    blocks = [f"[campaign]\n{head}"]
    for i, (source, stated) in enumerate(tests):
        kind = "decay" if source == "free" else "sweep"
        blocks.append(f'[[test]]\nkind = "{kind}"\nname = "{i}"\nfiles = "a.h5"')
        blocks.append(f"{SOURCES[source]}\n{stated}")
    return parse("\n".join(blocks))


def test_the_drive_is_stated_or_follows():
    spec = campaign(
        ("voltage", ""), ("force", ""), ("both", ""), ("both", 'drive = "force"'), ("free", ""),
        ("free", 'drive = "voltage"'),
    )  # fmt: skip
    found = [test.driven_by for test in spec.tests]
    assert found == ["voltage", "force", "voltage", "force", "none", "voltage"]


@pytest.mark.parametrize(
    ("source", "stated", "says"),
    [
        ("force", 'drive = "voltage"', "drive: `voltage` needs the channel `input`"),
        ("voltage", 'drive = "none"', "drive: `none` is for free decays"),
        ("voltage", 'drive = "hammer"', "drive: "),
    ],
)
def test_a_drive_that_the_test_does_not_have_is_refused(source, stated, says):
    with pytest.raises(ConfigError) as caught:
        campaign((source, stated))
    assert says in str(caught.value)


BOTH = "gain = 15.0\nmodal_mass = 2.0"


def test_gain_and_modal_mass_stand_together_where_either_source_is():
    known = force_per_unit(campaign(("voltage", ""), ("force", ""), head=BOTH))
    assert (gain_of(known, "voltage"), gain_of(known, "force")) == (15.0, 0.5)
    only = force_per_unit(campaign(("voltage", ""), ("force", ""), head="modal_mass = 2.0"))
    assert (gain_of(only, "voltage"), gain_of(only, "force")) == (None, 0.5)
    with pytest.raises(ConfigError, match="gain or modal_mass, not both"):
        campaign(("voltage", ""), ("free", ""), head=BOTH)


def test_of_one_drive_the_number_is_that_of_all():
    known = force_per_unit(campaign(("voltage", ""), ("free", ""), head="gain = 15.0"))
    assert known == 15.0
    assert gain_of(known, "voltage") == 15.0


def test_a_mass_tells_nothing_of_a_voltage():
    known = force_per_unit(campaign(("voltage", ""), ("free", ""), head="modal_mass = 2.0"))
    assert (gain_of(known, "voltage"), gain_of(known, "force")) == (None, 0.5)
    of_force = force_per_unit(campaign(("force", ""), ("free", ""), head="modal_mass = 2.0"))
    assert gain_of(of_force, "force") == 0.5

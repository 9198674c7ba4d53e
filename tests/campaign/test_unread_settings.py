"""A setting that a campaign's tests cannot use is told, never ignored."""

import json
from pathlib import Path

import numpy as np
import pytest

import jbw
from jbw.campaign.check import unread
from jbw.campaign.schema import parse, read_spec
from jbw.cli import run
from jbw.errors import ConfigError

CAMPAIGNS = sorted((Path(jbw.__file__).parents[1] / "notebooks" / "campaigns").glob("*.toml"))
TESTS = {
    "decay": '{ velocity = "v" }',
    "sweep": '{ input = "u", velocity = "v" }',
    "loop": '{ displacement = "y", restoring_force = "f" }',
    "frf": '{ frequency = "w", velocity = "v" }\nunits = { velocity = "m/s/N" }',
}


def campaign(settings, *kinds, head=""):
    blocks = [f'[[test]]\nkind = "{k}"\nfiles = "a.h5"\nchannels = {TESTS[k]}' for k in kinds]
    return "\n".join([head, *blocks, "[identify]", settings])


@pytest.mark.parametrize(
    ("settings", "kinds", "name"),
    [
        ("fit_repeats = 2", ["frf", "loop"], "fit_repeats"),
        ("substeps = 2", ["frf"], "substeps"),
        ("modes = [18.8]", ["loop"], "modes"),
        ('fit = ["sweep", "noise"]', ["sweep"], "fit"),
        ('offsets = "runs"', ["sweep"], "offsets"),
        ('sampler = "nested"\nnum_warmup = 9', ["sweep"], "num_warmup"),
        ('coordinates = "products"\n[joint]\nlaws = "jenkins_3"', ["sweep"], "coordinates"),
        ('coordinates = "paper"\n[joint]\nlaws = "cubic"', ["sweep"], "coordinates"),
        ("prior = { gain = [1.0, 2.0] }", ["decay"], "prior gain"),
        ("prior = { zeta = [0.1, 0.2] }", ["loop"], "prior zeta"),
    ],
)
def test_what_no_test_reads_is_told(settings, kinds, name):
    (fault,) = unread(parse(campaign(settings, *kinds)))
    assert (fault.severity, fault.channel) == ("warning", name)
    assert f"`{name}` has no effect: " in fault.what
    assert not list(unread(parse(campaign("seed = 3", *kinds))))


def test_one_test_that_reads_it_is_enough():
    settings = 'fit_repeats = 2\nsubsteps = 1\noffsets = "runs"\nprior = { zeta = [0.1, 0.2] }'
    settings += '\ncoordinates = "products"'
    assert not list(unread(parse(campaign(settings, "frf", "loop", "decay"))))
    head = "[campaign]\ngain = 2.0"
    (fault,) = unread(parse(campaign("prior = { gain = [1.0, 2.0] }", "sweep", head=head)))
    assert "the campaign states the gain" in fault.what


@pytest.mark.parametrize(
    ("kinds", "says"),
    [
        (["sweep"], ["modal_mass"]),  # by voltage
        (["sweep", "decay"], ["modal_mass"]),
        (["decay"], []),
        (["sweep", "loop"], []),
    ],
)
def test_a_mass_beside_voltages_alone_is_told(kinds, says):
    spec = parse(campaign("seed = 3", *kinds, head="[campaign]\nmodal_mass = 2.0"))
    assert [fault.channel for fault in unread(spec)] == says
    bounded = parse(
        campaign("prior = { gain = [1.0, 2.0] }", "sweep", head="[campaign]\nmodal_mass = 2.0")
    )
    assert [fault.channel for fault in unread(bounded)] == ["modal_mass"]


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.stem)
def test_the_notebooks_campaigns_state_nothing_in_vain(path):
    assert not list(unread(read_spec(path)))


def test_check_shows_it_and_loading_warns_of_it(tmp_path, capsys):
    time = np.arange(4096) / 256.0  # as long as its band asks for
    wave = np.exp(-0.2 * time) * np.cos(60.0 * time)
    np.savetxt(tmp_path / "a.csv", np.c_[time, wave], delimiter=",", header="t,v", comments="")
    text = campaign('offsets = "runs"', "decay").replace("a.h5", "a.csv")
    units = 'units = { velocity = "m/s" }\nfs = 256.0\nband = [8.0, 11.0]\n[identify]'
    file = tmp_path / "campaign.toml"
    file.write_text(text.replace("[identify]", units))
    assert run(["check", str(file), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["channels"][0]
    assert (row["test"], row["channel"], row["status"]) == ("[identify]", "offsets", "warning")
    with pytest.warns(UserWarning, match=r"campaign.toml, \[identify\]: `offsets` has no effect"):
        jbw.load_campaign(file)


def test_many_unknown_priors_are_one_line():
    many = "".join(f"k{i} = [1.0, 2.0]\n" for i in range(500))
    with pytest.raises(ConfigError) as caught:
        parse(campaign("[identify.prior]\n" + many, "sweep"))
    assert "500 unknown parameters: k0, k1, k2, ...; state only" in str(caught.value)
    assert len(str(caught.value)) < 300

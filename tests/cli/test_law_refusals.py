"""Laws and priors that a campaign cannot mean: a sentence, the nearest known name, exit code 2."""

import pytest

from jbw.cli import run

CAMPAIGN = """
[joint]
laws = {laws}
[[test]]
kind = "sweep"
files = "a.h5"
channels = {{ input = "u", velocity = "v" }}
[identify]
prior = {{ {prior} }}
"""


@pytest.mark.parametrize("command", ["check", "identify"])
@pytest.mark.parametrize(
    ("laws", "prior", "says"),
    [
        ('"bouc_wenn"', "", "[joint] laws: Unknown law `bouc_wenn`; did you mean `bouc_wen`"),
        ('["jenkin_3"]', "", "[joint] laws: Unknown law `jenkin_3`; did you mean `jenkins_3`"),
        ('["cubic", "cubic"]', "", "[joint] laws: The law `cubic` is named twice."),
        (
            '"bouc_wen"',
            "alhpa = [1.0, 2.0]",
            "[identify] prior: alhpa: unknown parameter; did you mean `alpha`",
        ),
        (
            '["jenkins_3"]',
            "alpha = [1.0, 2.0]",
            "[identify] prior: alpha: unknown parameter of the chosen laws; law `bouc_wen` has",
        ),
    ],
)
def test_what_no_law_can_mean_is_refused(tmp_path, capsys, command, laws, prior, says):
    path = tmp_path / "campaign.toml"
    path.write_text(CAMPAIGN.format(laws=laws, prior=prior), encoding="utf-8")
    out = ["--out", str(tmp_path / "run")] if command == "identify" else []
    assert run([command, str(path), *out]) == 2
    stderr = " ".join(capsys.readouterr().err.split())
    assert stderr.count(says) == 1
    assert "campaign.toml has an error:" in stderr

"""How the command ends after a watch: with an alarm, without a comparison, or as before."""

from types import SimpleNamespace

import pytest

from jbw.cli import progress, run

SETTINGS = {"reference": 5, "amplitudes": [1e-3], "unit": "m", "false_alarms": 1e-3}
REFUSED, ALARM, QUIET = (
    {"kind": "refused"},
    {"kind": "watched", "alarm": "drift"},
    {"kind": "watched"},
)


@pytest.mark.parametrize(
    ("added", "code"),
    [([QUIET], 0), ([QUIET, REFUSED], 3), ([ALARM, QUIET], 6), ([REFUSED, ALARM], 6)],
)
def test_an_alarm_ends_with_six_and_a_refused_record_alone_with_three(
    tmp_path, monkeypatch, added, code
):
    added = [{**entry, "record": "a.csv", "values": [20.0, -5.0]} for entry in added]
    watched = SimpleNamespace(settings=SETTINGS, readings=[], added=added)
    monkeypatch.setattr("jbw.watch.watch.watch", lambda *_, **__: watched)
    monkeypatch.setattr(progress, "prepare_process", lambda: None)
    assert run(["watch", str(tmp_path)]) == code

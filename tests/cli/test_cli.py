"""The command line: what loads, exit codes, what goes to stdout and what to stderr."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console

import jbw.cli
from jbw.cli import next_command, run
from jbw.cli.identify import summary_lines
from jbw.cli.printing import show
from jbw.errors import ModelError, RunError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record
from jbw.results.run import RunSummary, StoredVerdict

UNITS = {"input": "V", "velocity": "m/s"}


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    for i in (1, 2):
        samples = {role: rng.normal(size=2000) for role in UNITS}
        write_hdf5(tmp_path / f"noise_{i}.h5", Record(1024.0, samples, UNITS))
    return tmp_path


def loaded_by(*arguments):
    """Modules of interest that a command loads, in a fresh process."""
    code = (
        "import sys\nfrom jbw.cli import run\n"
        f"code = run({list(arguments)!r})\n"
        "heavy = ('jax', 'arviz', 'arviz_base', 'matplotlib', 'numpy', 'scipy', 'rich', 'h5py', "
        "'xarray')\n"
        "print([m for m in heavy if m in sys.modules], code, file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ended.stderr.strip().splitlines()[-1]


def test_help_loads_click_only():
    assert loaded_by("--help") == "[] 0"


def test_python_runs_the_command_as_a_module():
    command = [sys.executable, "-m", "jbw", "nonsense"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "Usage: jbw [OPTIONS]" in ended.stderr


def test_check_loads_neither_jax_nor_plots(folder):
    assert run(["init", str(folder)]) == 0
    loaded = loaded_by("check", str(folder / "campaign.toml"))
    assert loaded.endswith(" 0")
    assert not any(name in loaded for name in ("jax", "arviz", "matplotlib"))


@pytest.mark.slow  # a process that reads and writes its answer
def test_a_look_loads_neither_jax_nor_plots_nor_xarray(folder):
    """It answers in seconds where a fit begins by compiling; priors on the default law included."""
    assert run(["init", str(folder)]) == 0
    campaign = folder / "campaign.toml"
    text = campaign.read_text(encoding="utf-8")
    campaign.write_text(text + "\n[identify.prior]\nalpha = [100.0, 900.0]\n", encoding="utf-8")
    loaded = loaded_by("look", str(campaign))
    assert loaded.endswith(" 0")
    assert not any(name in loaded for name in ("jax", "arviz", "matplotlib", "xarray"))


def test_help_and_version(capsys):
    assert run(["--help"]) == 0
    out = capsys.readouterr().out
    assert run(["more"]) == 0
    out += capsys.readouterr().out
    assert all(f"  {name} " in out for name in jbw.cli.COMMANDS if name != "more")
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"jbw, version {jbw.__version__}\n"


def test_after_a_full_disk_the_same_command_comes_again(monkeypatch, capsys):
    """The place is at fault: `jbw check` of the campaign would lead astray."""

    def full(*_, **__):
        raise RunError("The disk of `run` is full.", remedy="Free some space.")

    monkeypatch.setattr("jbw.cli.cli.main", full)
    assert run(["identify", "my beam.toml", "--out", "run"]) == RunError.exit_code
    stderr = capsys.readouterr().err
    assert "Next: jbw identify 'my beam.toml' --out run, after the correction" in stderr
    assert "jbw check" not in stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["chek"], "Did you mean 'check'?"),
        (["check"], "Missing argument"),
        (["check", "--jsn", "x"], "--json"),
        (["check", "none.toml"], "jbw init"),
    ],
)
def test_usage_and_configuration_end_with_2(capsys, arguments, says):
    assert run(arguments) == 2
    streams = capsys.readouterr()
    assert says in streams.err
    assert "Traceback" not in streams.err


def test_init_then_check(folder, capsys):
    assert run(["init", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "campaign.toml")
    assert run(["check", str(folder / "campaign.toml")]) == 0
    streams = capsys.readouterr()
    assert "1024 Hz" in streams.out
    assert streams.err == f"Next: jbw look {folder / 'campaign.toml'}\n"
    assert run(["init", str(folder)]) == 2
    assert "not overwritten" in capsys.readouterr().err


def test_init_print_writes_nothing(folder, capsys):
    before = sorted(folder.iterdir())
    assert run(["init", "--print", str(folder)]) == 0
    assert "[[test]]" in capsys.readouterr().out
    assert sorted(folder.iterdir()) == before


def test_data_errors_end_with_3_and_json_says_where(folder, capsys):
    run(["init", str(folder)])
    samples = {"input": np.ones(2000), "velocity": np.full(2000, np.nan)}
    write_hdf5(folder / "noise_2.h5", Record(1024.0, samples, UNITS))
    capsys.readouterr()
    assert run(["check", str(folder / "campaign.toml"), "--json"]) == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "error"
    for channel, word in zip(answer["channels"], ("constant", "2000 of 2000"), strict=True):
        assert channel["status"] == "error"
        assert word in channel["findings"][0]["what"]
        assert "noise_2.h5" in channel["findings"][0]["what"]
        assert "exclude" in channel["findings"][0]["remedy"]
    assert run(["check", str(folder / "campaign.toml")]) == 3
    assert "exclude" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (ModelError("What is wrong.", remedy="Do this."), 2, "Error: What is wrong.\nDo this."),
        (RunError("Disk full."), 1, "Error: Disk full."),
        (ZeroDivisionError("by zero"), 1, "Internal error: ZeroDivisionError: by zero"),
        (KeyboardInterrupt(), 5, "Interrupted"),
    ],
)
def test_errors_become_messages_and_exit_codes(monkeypatch, capsys, tmp_path, error, code, says):
    def fail(*_, **__):
        raise error

    monkeypatch.delenv("JBW_TRACEBACK", raising=False)
    monkeypatch.setattr("jbw.campaign.check.check_campaign", fail)
    (tmp_path / "x.toml").touch()
    assert run(["check", str(tmp_path / "x.toml")]) == code
    streams = capsys.readouterr()
    assert says in streams.err
    assert "Traceback" not in streams.err


def test_internal_error_tells_how_to_see_more(monkeypatch, capsys, tmp_path):
    (tmp_path / "x.toml").touch()
    monkeypatch.setattr("jbw.campaign.check.check_campaign", lambda *_, **__: 1 / 0)
    run(["check", str(tmp_path / "x.toml")])
    assert "JBW_TRACEBACK=1" in capsys.readouterr().err
    monkeypatch.setenv("JBW_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run(["check", str(tmp_path / "x.toml")])


def test_a_command_returns_its_exit_code(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["jbw", "--version"])
    with pytest.raises(SystemExit) as caught:
        jbw.cli.main()
    assert caught.value.code == 0


@pytest.mark.parametrize(
    ("arguments", "following"),
    [
        (["identify", "a b.toml"], "jbw check 'a b.toml'"),
        (["check", "x.toml"], "jbw check x.toml, after the correction"),
        (["predict", "run", "--tone", "3"], "jbw identify CAMPAIGN.toml --out run"),
        (["demo"], "jbw demo --help"),
        ([], None),
    ],
)
def test_every_failure_ends_with_the_next_command(arguments, following):
    assert next_command(arguments, "What is wrong.") == following
    assert next_command(arguments, "Write a campaign file with: jbw init FOLDER") is None


def test_with_json_an_error_is_json_too(capsys, tmp_path):
    path = tmp_path / "campaign.toml"
    path.write_text("[campaign]\nname = 3\n", encoding="utf-8")
    assert run(["identify", str(path), "--json", "--out", str(tmp_path / "run")]) == 2
    streams = capsys.readouterr()
    failure = json.loads(streams.out)["error"]
    assert failure["kind"] == "ConfigError"
    assert "name" in failure["what"]
    assert failure["exit_code"] == 2
    assert failure["next"] == f"jbw check {path}"
    assert f"Next: jbw check {path}" in streams.err


def test_every_command_that_answers_takes_json():
    for name in jbw.cli.COMMANDS:
        command = jbw.cli.cli.get_command(None, name)
        options = {option for parameter in command.params for option in parameter.opts}
        assert name in ("completion", "schema") or "--json" in options, name


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_for_every_shell(shell, capsys):
    assert run(["completion", shell]) == 0
    assert "_JBW_COMPLETE" in capsys.readouterr().out


def test_bash_completes_commands_and_codes():
    def completed(words, number):
        ended = subprocess.run(
            [sys.executable, "-c", "from jbw.cli import main; main()"],
            capture_output=True, text=True, check=False,
            env={"_JBW_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(number)},
        )  # fmt: skip
        return {line.partition(",")[2] for line in ended.stdout.splitlines()}

    assert completed("jbw ide", 1) == {"identify", "identifiability"}
    assert completed("jbw explain ess_", 2) == {"ess_bulk", "ess_tail", "ess_weights"}


def test_table_1_loses_columns_on_a_narrow_screen_but_no_digits(monkeypatch, capsys):
    row = {"map": 0.0044708, "mean": 0.0044709, "sd": 3.8152e-06, "cv": 8.5e-4, "kl": 4.7056}
    row |= {"ess_bulk": 1716.4, "r_hat": 1.001, "truth": 0.00444, "z": 8.05}
    step = {"parameters": {"alpha_delta": row}, "statements": [], "verdict": {"status": "failed"}}
    summary = {
        "campaign": "toy", "steps": {"third_order_paper": step}, "comparison": {},
        "predictions": {}, "verdict": {"status": "ok", "findings": []},
    }  # fmt: skip
    widest = ("MAP", "mean", "sd", "CV", "KL", "ESS", "R-hat", "truth", "z")
    for width, columns in ((160, widest), (80, ("mean", "sd", "R-hat"))):
        monkeypatch.setattr(
            "jbw.cli.printing.console", lambda width=width: Console(width=width, highlight=False)
        )
        show(*summary_lines(RunSummary.read(summary)))
        printed = capsys.readouterr().out
        assert "…" not in printed
        assert max(map(len, printed.splitlines())) <= width
        head = next(line for line in printed.splitlines() if "parameter" in line).split()
        assert head == ["step", "parameter", *columns, "verdict"]
        assert "0.0044709" in printed


def test_a_warning_of_several_tests_is_told_once(capsys):
    from jbw.campaign.check import Check, Row
    from jbw.cli.check import _lines
    from jbw.measurement.faults.fault import doubt

    sign = doubt("velocity", "The sign may be turned.", "It adds pi.", "Set turn.")
    other = doubt("velocity", "It lags by 2 ms.", "It adds phase.", "Set delay.")
    rows = tuple(
        Row(test, "laser", "velocity", "m/s", 256.0, 3, "warning", faults)
        for test, faults in (("low", (sign,)), ("high", (sign, other)))
    )
    show(*list(_lines(Check("beam", rows, 0, ())))[1:])
    assert capsys.readouterr().out.splitlines() == [
        "warning low, high, laser: The sign may be turned.",
        "    It adds pi.",
        "    Set turn.",
        "warning high, laser: It lags by 2 ms.",
        "    It adds phase.",
        "    Set delay.",
    ]


NINE = ["init", "check", "look", "identify", "report", "predict", "laws", "diff", "export"]


def test_help_shows_nine_commands_and_where_the_others_are(capsys):
    assert run(["--help"]) == 0
    printed = capsys.readouterr().out
    assert re.findall(r"^  ([a-z]+)  ", printed.partition("Begin:")[2], re.MULTILINE) == NINE
    assert printed.rstrip().endswith("jbw more")
    assert run(["more"]) == 0
    others = re.findall(r"^  ([a-z]+)  ", capsys.readouterr().out, re.MULTILINE)
    assert sorted(others + NINE + ["more"]) == sorted(jbw.cli.COMMANDS)
    assert run(["more", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)) == others


@pytest.mark.parametrize("name", sorted(jbw.cli.COMMANDS))
def test_every_command_has_its_help_whether_it_is_listed_first_or_not(name, capsys):
    assert run([name, "--help"]) == 0
    assert f"Usage: jbw {name} " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("status", "strict", "code"),
    [
        ("ok", True, 0),
        ("usable", False, 0),
        ("usable", True, 4),
        ("failed", False, 4),
        ("not assessed", False, 4),
    ],
)
def test_a_usable_verdict_ends_with_0_unless_strict(status, strict, code, capsys):
    from pathlib import Path

    from jbw.cli.identify import ended

    found = StoredVerdict.read(
        {"status": status, "findings": [{"code": "misfit", "status": status}]}
    )
    assert ended(found, Path("run"), strict=strict) == code
    named = "predict" if code == 0 else "explain"
    assert f"Next: jbw {named}" in capsys.readouterr().err

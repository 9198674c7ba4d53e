"""Chains under way: a live line each on a terminal, plain lines elsewhere; colours when wanted."""

import io
import logging
import os
import re
import select
import subprocess
import sys
import time

import numpy as np
import pytest
from rich.console import Console

from jbw.cli import progress
from jbw.cli.progress import (
    LOOK_S,
    PLAIN_S,
    SILENT_S,
    Teller,
    called,
    chain_sentence,
    effective,
    telling,
)
from jbw.inference.lanes import at_points
from jbw.inference.samplers.chunked_run import SoFar


def so_far(
    done=300, total=425, num_draws=275, divergences=(0, 2, 0, 0), left_s=100.0, in_rounds=False
):
    rng = np.random.default_rng(0)
    draws = {"alpha": rng.normal(size=(4, num_draws)), "zeta": rng.normal(size=(4, num_draws))}
    counts = None if divergences is None else np.array(divergences)
    return SoFar(done, total, draws if num_draws else {}, counts, left_s, in_rounds)


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("jbw.cli.progress.perf_counter", lambda: now[0])
    return now


def told_on(terminal, clock, events):
    """What a teller writes for (seconds later, what is known) one after the other."""
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=terminal, width=110, highlight=False))
    for seconds, so_far_known in events:
        clock[0] += seconds
        say.chains("joint", so_far_known)
    say("Done")
    return stream.getvalue()


def test_where_there_is_no_terminal_a_line_now_and_then(clock):
    printed = told_on(
        False, clock, [(PLAIN_S + 1, so_far(10, 425, 0)), (1, so_far()), (PLAIN_S, so_far())]
    )
    lines = printed.splitlines()
    assert len(lines) == 3
    assert lines[0].endswith("joint posterior: 10 of 425 steps, warming up, 100 s left")
    assert "joint posterior: 300 of 425 steps, " in lines[1]
    assert "2 divergences" in lines[1]
    assert "\x1b" not in printed


def test_a_quick_posterior_says_nothing(clock):
    printed = told_on(False, clock, [(0.1, so_far(100)), (0.1, so_far(425, 425))])
    assert printed.splitlines() == ["[  0.2 s] Done"]


def test_on_a_terminal_every_chain_has_its_line(clock):
    printed = told_on(True, clock, [(LOOK_S + 1, so_far())])
    assert "joint posterior" in printed
    for chain in range(1, 5):
        assert f"chain {chain}" in printed
    assert printed.count("300/425") >= 4  # drawn again when the live lines end
    assert "2 divergences" in printed
    assert printed.count("left") >= 4
    assert printed.rstrip().endswith("Done")


def test_five_seconds_of_silence_are_broken_by_what_is_under_way(clock):
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=False, width=110, highlight=False))
    say.beat()  # nothing is under way
    say("Fitting")
    for seconds, lines in ((3.5, 1), (1.0, 2), (3.5, 2), (1.0, 3)):
        clock[0] += seconds
        say.beat()
        assert len(stream.getvalue().splitlines()) == lines
    assert stream.getvalue().splitlines()[-1] == "[  9.0 s] ... Fitting, for 9 s so far"
    # A warning is no work: what was under way is told on.
    say.remark("warning: a doubt")
    clock[0] += 12.0
    say.beat()
    assert stream.getvalue().splitlines()[-2:] == [
        "[  9.0 s] warning: a doubt",
        "[ 21.0 s] ... Fitting, for 21 s so far",
    ]
    say("Done")
    say.beat()
    assert len(stream.getvalue().splitlines()) == 6


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("joint", "joint posterior"),
        ("joint_amis", "joint posterior, weighed points"),
        ("joint_ridge_amis", "joint posterior, along the ridge, weighed points"),
        ("joint_wide_nuts", "joint posterior, wider prior bounds, nuts"),
        ("decay_elliptical_slice", "posterior of free decays, elliptical slice"),
        ("third_order_nuts", "Step 3, nuts"),
        ("mine", "mine"),
        (
            "joint_1",
            "joint posterior, round 2: drawn again, because chains disagreed or draws were too few",
        ),
        (
            "joint_nuts_2",
            "joint posterior, nuts, round 3: "
            "drawn again, because chains disagreed or draws were too few",
        ),
    ],
)
def test_what_is_under_way_is_named_in_plain_words(name, words):
    assert called(name) == words


def test_rounds_of_points_are_no_steps():
    sentence = chain_sentence("joint_amis", so_far(3, 64, left_s=None, in_rounds=True))
    assert sentence.startswith("joint posterior, weighed points: round 3 of 64 at most, ")
    # Four groups of 275 independent draws: together worth about as many, within a tenth.
    found = re.search(r"at most, ([\d,]+) effective draws; at least 400 are needed", sentence)
    worth = float(found[1].replace(",", ""))
    assert 0.9 * 1100 < worth < 1.1 * 1100
    assert "steps" not in sentence


def test_what_is_under_way_within_a_stage_is_told_of_that_stage_alone(clock):
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=False, width=110, highlight=False))
    say("Fitting")
    say.within("start 2 of 11")
    clock[0] += SILENT_S + 1
    say.beat()
    assert stream.getvalue().splitlines()[-1].endswith("... Fitting: start 2 of 11, for 5 s so far")
    for points in (1024, 512):
        say.count(points)
    clock[0] += SILENT_S + 1
    say.beat()
    assert stream.getvalue().splitlines()[-1].endswith("so far, 1,536 model evaluations")
    say("Drawing")
    clock[0] += SILENT_S + 1
    say.beat()
    assert stream.getvalue().splitlines()[-1].endswith("... Drawing, for 5 s so far")


def test_evaluations_of_the_model_are_counted():
    with telling("Fitting") as say:
        at_points(lambda theta, _: theta["x"], {"x": np.zeros(70)})
        at_points(lambda theta, _: theta["x"], {"x": np.zeros(30)})
        assert say._count == 100


def test_a_message_is_one_line_in_a_file_however_long(clock):
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=False, width=40, highlight=False))
    say("Joint posterior: all parameters from 7 groups of data, which is a long line")
    clock[0] += SILENT_S + 1
    say.beat()
    say.remark("warning: " + "a doubt " * 20)
    assert len(stream.getvalue().splitlines()) == 3


def test_the_first_line_comes_before_what_is_heavy(monkeypatch, capsys):
    heard = []

    def heavy():
        heard.append(capsys.readouterr().err)

    monkeypatch.setattr(progress, "prepare_process", heavy)
    with progress.computing():
        pass
    assert progress.STARTING in heard[0]


def test_messages_within_a_stage_come_by_the_log_and_leave_it_as_it_was(monkeypatch, capsys):
    log = logging.getLogger("jbw.progress")
    before = log.level, log.propagate, list(log.handlers)
    monkeypatch.setattr(progress, "SILENT_S", 0.05)
    monkeypatch.setattr(progress, "BEAT_S", 0.02)
    with progress.telling("Fitting"):
        log.info("start %d of %d", 2, 3)
        time.sleep(0.3)
    assert "... Fitting: start 2 of 3, for 0 s so far" in capsys.readouterr().err
    assert (log.level, log.propagate, list(log.handlers)) == before


def screen(written):
    """Lines of a terminal after what was written: up a line, erase it, carriage return, newline."""
    lines, at = [""], 0
    for code, text in re.findall(r"\x1b\[([?\d;]*[A-Za-z])|([^\x1b\r\n]+|\r|\n)", written):
        if code.endswith("A"):
            at -= int(code[:-1] or 1)
        elif code == "2K":
            lines[at] = ""
        elif text == "\n":
            at += 1
            lines += [""] * (at == len(lines))
        elif text != "\r" and not code:
            lines[at] = text
    return [line for line in lines if line]


def test_on_a_terminal_one_line_is_written_over(clock, monkeypatch):
    """Ninety beats leave the milestones alone, as a terminal of 80 columns shows them."""
    pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
    monkeypatch.setenv("TERM", "xterm")
    master, slave = pty.openpty()
    written = []
    with open(slave, "w", encoding="utf-8") as stream:
        say = Teller(Console(file=stream, width=80, highlight=False))

        def after(event, *printed):
            event(*printed)
            written.append(os.read(master, 4096).decode())  # or the terminal would be full

        def shown():
            while select.select([master], [], [], 0.5)[0]:  # a terminal hands on when it likes
                written.append(os.read(master, 4096).decode())
            return screen("".join(written))

        after(say, "Reading")
        after(say, "Joint posterior")
        for beat in range(90):
            clock[0] += 1.0
            if beat < SILENT_S:
                say.beat()
            else:
                after(say.beat)
        assert len(shown()) == 3
        assert shown()[-1] == "[ 90.0 s] ... Joint posterior, for 90 s so far"
        after(say, "Done")
        printed = shown()
    os.close(master)
    assert [line[10:] for line in printed] == ["Reading", "Joint posterior", "Done"]


def test_a_terminal_that_rewrites_nothing_gets_lines(clock, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=True, width=80, highlight=False))
    say("Fitting")
    for _ in range(11):
        clock[0] += 1.0
        say.beat()
    assert len(stream.getvalue().splitlines()) == 3


def test_a_live_line_that_stands_still_is_no_silence(clock):
    stream = io.StringIO()
    say = Teller(Console(file=stream, force_terminal=True, width=110, highlight=False))
    say("Joint posterior")
    clock[0] += LOOK_S + 1
    say.chains("joint", so_far())
    clock[0] += PLAIN_S + 1
    say.beat()
    written = stream.getvalue()
    assert "... Joint posterior, for 13 s so far" in written
    assert "chain 4" in written[written.rindex("chain 1") :]  # the chains stay above it
    say("Done")


def test_no_time_left_is_told_before_it_is_known():
    assert "left" not in chain_sentence("joint", so_far(left_s=None))
    assert chain_sentence("joint", so_far()).endswith("100 s left")


def test_a_command_that_is_silent_is_heard(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SILENT_S", 0.05)
    monkeypatch.setattr(progress, "BEAT_S", 0.02)
    with progress.computing() as say:
        say("Compiling")
        time.sleep(0.5)
    assert "... Compiling, for 0 s so far" in capsys.readouterr().err


def test_independent_draws_are_worth_themselves_and_few_are_not_judged():
    assert effective({}) is None
    assert effective({"a": np.zeros((2, 3))}) is None
    worth = effective({"a": np.random.default_rng(1).normal(size=(3, 2000))})
    # The estimate of the effective number of 2000 independent draws scatters by some 5 %.
    np.testing.assert_allclose(worth, 2000, rtol=0.25)
    assert effective({"a": np.ones((2, 100))}) == [0.0, 0.0]  # chains that never moved


def test_a_sampler_without_divergences_names_none():
    assert "divergences" not in chain_sentence("joint", so_far(divergences=None))


def test_no_color_is_heeded(tmp_path):
    code = (
        "from rich.text import Text\nfrom jbw.cli.printing import console\n"
        "console().print(Text('failed', 'bold red'))"
    )
    for environment, coloured in (({}, True), ({"NO_COLOR": "1"}, False)):
        ended = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True,
            env={"PATH": "", "FORCE_COLOR": "1", "TERM": "xterm-256color", **environment},
        )  # fmt: skip
        assert ("\x1b[1;31m" in ended.stdout) == coloured
        assert "failed" in ended.stdout

"""CPU seconds of tests: `pytest --measure` writes them; tiers and order are chosen by them.

For each file `tests/durations.json` stores the tests of at least `LEAST` seconds without compiled
code, and marked tests. The seconds include a test's call, its own fixtures, its share of fixtures
that several tests of the file use, and the processes that it starts; what a session makes once,
such as the toy run, counts for no test. A test above `LONG` belongs to the slow tier; a test
without an entry counts as quick.
"""

import json
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

import pytest

try:
    from resource import RUSAGE_CHILDREN, getrusage
# Windows has no such count: processes that a test starts are not counted there.
except ImportError:
    getrusage = None

TABLE = Path(__file__).parent / "durations.json"
LEAST, LONG = 0.5, 1.0  # [s]


def spent():
    """Return the CPU seconds of this process and of the child processes that have ended."""
    children = getrusage(RUSAGE_CHILDREN) if getrusage else None
    return time.process_time() + (children.ru_utime + children.ru_stime if children else 0.0)


def measured():
    """Return the stored CPU seconds by file and test."""
    return json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}


def split(nodeid):
    """Return file and name of a test."""
    path, _, name = nodeid.partition("::")
    return path, name


def is_marked(item):
    """Return whether a test has a mark that makes it slow."""
    return any(item.get_closest_marker(name) for name in ("slow", "release"))


def merged(table, seconds, whole):
    """Return the table with new times, and without other entries of files that ran as a `whole`."""
    files = defaultdict(dict, {path: dict(r) for path, r in table.items() if path not in whole})
    for nodeid, value in seconds.items():
        path, name = split(nodeid)
        files[path][name] = round(value, 1)
    lasting = {
        path: {name: value for name, value in sorted(rows.items()) if value >= LEAST}
        for path, rows in sorted(files.items())
    }
    return {path: rows for path, rows in lasting.items() if rows}


def without_the_gone(table, collected):
    """Return the table without tests that no longer exist, for files with all tests collected."""
    files = {split(nodeid)[0] for nodeid in collected}
    return {
        path: {name: value for name, value in rows.items() if f"{path}::{name}" in collected}
        if path in files
        else rows
        for path, rows in table.items()
    }


class Meter:
    """A counter of the CPU seconds of each test of a session, which reports long tests."""

    def __init__(self, config):
        self.config, self.writes = config, config.getoption("measure")
        # A slow test stays slow if another test of its tier has compiled their common program.
        self.least = LONG + 0.1 if config.option.markexpr.startswith("slow") else LEAST
        self.seconds = {}  # by test
        self.fixtures, self.users = {}, defaultdict(list)  # by file and name of a shared fixture
        self.so_far = 0.0  # of all shared fixtures
        self.collected, self.fast = set(), set()  # tests, and those of the fast tier that ran

    @pytest.hookimpl(wrapper=True)
    def pytest_collection_modifyitems(self, items):
        """Record which tests exist; run long files first, so that none is alone at the end."""
        self.collected, table = {item.nodeid for item in items}, measured()
        result = yield  # -m selects tests here
        files = Counter()
        for item in items:
            path, name = split(item.nodeid)
            files[path] += table.get(path, {}).get(name, LONG if is_marked(item) else 0.0)
        items.sort(key=lambda item: -files[split(item.nodeid)[0]])
        return result

    def own(self, began, before):
        """Return the CPU seconds since `began`, without those of shared fixtures made since."""
        return spent() - began - (self.so_far - before)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        """Count a shared fixture separately, not for the first test that uses it."""
        began, before = spent(), self.so_far
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                seconds = self.own(began, before)
                self.so_far += seconds
                self.fixtures[request.node.nodeid, fixturedef.argname] = seconds

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """Count the CPU seconds of a test, and record which fixtures of its file it uses."""
        began, before = spent(), self.so_far
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = self.own(began, before)
            if not is_marked(item):
                self.fast.add(item.nodeid)
            for name in item.fixturenames:
                self.users[split(item.nodeid)[0], name].append(item.nodeid)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self):
        """Add to each test its share of fixtures; pass all times to the main process."""
        for key, seconds in self.fixtures.items():
            for nodeid in self.users[key]:
                self.seconds[nodeid] += seconds / len(self.users[key])
        if hasattr(self.config, "workeroutput"):
            self.config.workeroutput |= {
                "seconds": self.seconds, "tests": [*self.collected], "fast": [*self.fast],
            }  # fmt: skip

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node):
        """Collect the times of a process that ends."""
        found = getattr(node, "workeroutput", {})
        self.seconds |= found.get("seconds", {})
        self.collected |= set(found.get("tests", ()))
        self.fast |= set(found.get("fast", ()))

    def pytest_terminal_summary(self, terminalreporter):
        """Report the files that take longest; write the table, or report which tests are long."""
        table, files = measured(), Counter()
        for nodeid, seconds in self.seconds.items():
            files[split(nodeid)[0]] += seconds
        if not files:  # No test ran.
            return
        terminalreporter.section(f"{sum(files.values()):.0f} CPU seconds, most of them in")
        for path, seconds in files.most_common(10):
            terminalreporter.write_line(f"{seconds:7.1f} s  {path}")
        if self.writes:
            if not any("::" in argument for argument in self.config.args):
                table = without_the_gone(table, self.collected)
            partly = {split(nodeid)[0] for nodeid in self.collected - set(self.seconds)}
            whole = {split(nodeid)[0] for nodeid in self.seconds} - partly
            # A marked test stays in the table even if it is quick, so that it is not unknown.
            lasting = {
                nodeid: seconds if nodeid in self.fast else max(seconds, self.least)
                for nodeid, seconds in self.seconds.items()
            }
            text = json.dumps(merged(table, lasting, whole), indent=1, ensure_ascii=False)
            TABLE.write_text(text + "\n", encoding="utf-8")
            return
        known = {f"{path}::{name}" for path, rows in table.items() for name in rows}
        new = {n: self.seconds[n] for n in self.fast - known if self.seconds[n] > LONG}
        if new:
            terminalreporter.section("tests of the fast tier above one CPU second, not measured")
            for nodeid, seconds in sorted(new.items(), key=lambda pair: -pair[1]):
                terminalreporter.write_line(f"{seconds:7.1f} s  {nodeid}")
            terminalreporter.write_line("pytest --measure FILE puts them into the table")


def pytest_addoption(parser):
    parser.addoption(
        "--measure", action="store_true",
        help="write the CPU seconds of the tests that run into tests/durations.json",
    )  # fmt: skip


def pytest_configure(config):
    if config.option.markexpr == "slow":  # Tests that wait for a release do so here, too.
        config.option.markexpr = "slow and not release"
    if config.getoption("measure"):
        folder = tempfile.TemporaryDirectory()  # Nothing is compiled before.
        config.add_cleanup(folder.cleanup)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = folder.name  # for processes that tests start
        if jax := sys.modules.get("jax"):  # JAX has already read the environment.
            jax.config.update("jax_compilation_cache_dir", folder.name)
    config.pluginmanager.register(Meter(config), "meter")

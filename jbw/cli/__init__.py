"""The command line: a group whose commands load when called, and the handling of errors.

Results go to stdout, progress and messages to stderr. Exit codes: 0 ok, 1 internal, 2 usage or
configuration, 3 data, 4 finished but not trustworthy, 5 interrupted, 6 alarm of a watch.
"""

import errno
import json
import os
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from jbw import __version__
from jbw.errors import JbwError, RunError
from jbw.memory import out_of_memory
from jbw.report.messages import commands as messages

INTERRUPTED = 5

# Headings of `jbw --help` and of `jbw more`, and the module of each command. The help line of a
# command is printed without importing its module.
FIRST = {
    "Begin": {"init": "check", "check": "check", "look": "look"},
    "Identify": {"identify": "identify", "report": "result", "predict": "predict"},
    "Compare and export": {"laws": "laws", "diff": "diff", "export": "result"},
}
MORE = {
    "Learn": {"demo": "identify", "explain": "about", "docs": "about"},
    "Around an identification": {
        "resume": "identify",
        "identifiability": "identify",
        "plan": "plan",
    },
    "Several joints, over time": {
        "status": "status",
        "collect": "collect",
        "population": "population",
        "watch": "watch",
    },
    "Check the method": {"sbc": "studies", "compare": "studies"},
    "Editors and shells": {"schema": "about", "completion": "about"},
}
COMMANDS = {
    name: file for group in (*FIRST.values(), *MORE.values()) for name, file in group.items()
} | {"more": "about"}
# Error numbers of operating systems for a disk or folder that is full or cannot be written.
UNWRITABLE = tuple(
    getattr(errno, name)
    for name in ("ENOSPC", "EFBIG", "EDQUOT", "EROFS", "EACCES", "EPERM")
    if hasattr(errno, name)  # not defined on every system
)
# word in XLA's out-of-memory errors, which have a separate error type
EXHAUSTED = "RESOURCE_EXHAUSTED"
OF_CAMPAIGNS = ("identify", "look", "identifiability", "compare", "laws", "predict")
OF_RUNS = ("report", "predict", "export", "compare", "plan", "resume")


class LazyGroup(click.Group):
    """A group that imports a command's module only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands in the usual order of work."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command with a given name; its module is imported now."""
        if cmd_name not in COMMANDS:
            return None
        return getattr(import_module(f"jbw.cli.{COMMANDS[cmd_name]}"), cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the named command; a misspelt name ends in an error with the nearest name."""
        if args[0] not in COMMANDS and not args[0].startswith("-"):
            nearest = get_close_matches(args[0], COMMANDS, n=1)
            ctx.fail(messages.no_command(args[0], nearest[0] if nearest else ""))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help lines of the basic commands, grouped by purpose, without imports."""
        write_commands(formatter, FIRST)
        formatter.write_paragraph()
        formatter.write_text(messages.MORE)


def write_commands(formatter: click.HelpFormatter, groups: Mapping[str, Iterable[str]]) -> None:
    """Write groups of commands: a heading, and one help line per command."""
    widest = max(len(name) for names in groups.values() for name in names)
    for heading, names in groups.items():
        with formatter.section(heading):
            formatter.write_dl([(f"{name:<{widest}}", messages.SHORT[name]) for name in names])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="jbw")
def cli() -> None:
    """Identify bolted joints from vibration records."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command from the console and exit with its exit code, never with a bare traceback."""
    for stream in (sys.stdout, sys.stderr):
        # The console may not be able to encode the characters of a file's name.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    `arguments` are the command line without the program's name; those of the process when None.
    """
    try:
        code: Any = cli.main(arguments, prog_name="jbw", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("Interrupted.", err=True)
        return INTERRUPTED
    except JbwError as error:
        _tell(error, sys.argv[1:] if arguments is None else arguments)
        return error.exit_code
    except BrokenPipeError:  # The program that reads stdout has ended its reading, as `head` does.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # A disk or folder failed while some file was written.
        if error.errno not in UNWRITABLE or os.environ.get("JBW_TRACEBACK"):
            return _internal(error)
        place = f"{error.filename}" if error.filename else "A file"
        unwritten = RunError(
            f"{place} cannot be written: {error.strerror}.",
            remedy="Free some space, make the folder writable, or choose another place.",
        )
        _tell(unwritten, sys.argv[1:] if arguments is None else arguments)
        return unwritten.exit_code
    except Exception as error:  # Any other exception is an internal error of jbw.
        if not (isinstance(error, MemoryError) or EXHAUSTED in str(error)):
            return _internal(error)
        _tell(exhausted := out_of_memory(error), sys.argv[1:] if arguments is None else arguments)
        return exhausted.exit_code
    return code if isinstance(code, int) else 0


def _internal(error: Exception) -> int:
    """Print the message on an internal error; return its exit code, or raise it on request."""
    if os.environ.get("JBW_TRACEBACK"):
        raise error
    click.echo(f"Internal error: {type(error).__name__}: {error}", err=True)
    click.echo(messages.FAULT, err=True)
    return JbwError.exit_code


def _tell(error: JbwError, arguments: Sequence[str]) -> None:
    """Print an error on stderr, and as JSON on stdout if `--json` was given."""
    following = next_command(arguments, str(error))
    if following and isinstance(error, RunError):
        # The disk is at fault and not the input, so the same command works once there is space.
        following = f"jbw {shlex.join(arguments)}, after the correction"
    click.echo(f"Error: {error}", err=True)
    if following:
        click.echo(f"Next: {following}", err=True)
    if "--json" in arguments:
        failure = {"kind": type(error).__name__, "what": error.what, "why": error.why}
        failure |= {"remedy": error.remedy, "exit_code": error.exit_code, "next": following}
        click.echo(json.dumps({"error": failure}, indent=1, ensure_ascii=False))


def next_command(arguments: Sequence[str], message: str) -> str | None:
    """Return the command to type after an error; None if the message already names one."""
    if "jbw " in message or not arguments:
        return None
    command, rest = arguments[0], arguments[1:]
    campaign = next((word for word in rest if word.endswith(".toml")), None)
    if command == "check" and campaign:
        return f"jbw check {shlex.quote(campaign)}, after the correction"
    if command in OF_CAMPAIGNS and campaign:
        return f"jbw check {shlex.quote(campaign)}"
    folder = next((word for word in rest if not word.startswith("-")), None)
    if command in OF_RUNS and folder:
        return messages.identify_again(shlex.quote(folder))
    return f"jbw {command} --help"

"""The errors that jbw raises on purpose: what is wrong, why it matters, what to do."""

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

logger = logging.getLogger("jbw")


class JbwError(Exception):
    """The base class of all deliberate errors; its text has one line each for what, why and remedy.

    Args:
        what: The field, file, channel or sample, the requirement and the value found.
        why: Why it matters, if that is not obvious.
        remedy: What the caller can do about it.

    Examples:
        An error says what is wrong and what to do, and has the exit code of the command:

        >>> import jbw
        >>> try:
        ...     jbw.load_campaign("campaign.toml")
        ... except jbw.JbwError as error:
        ...     print(error.what)
        ...     print(error.remedy)
        ...     print(error.exit_code)
        Campaign file `campaign.toml` does not exist.
        Write a campaign file with: jbw init FOLDER
        2
    """

    exit_code = 1

    def __init__(self, what: str, *, why: str = "", remedy: str = "") -> None:
        self.what, self.why, self.remedy = map(printable, (what, why, remedy))
        lines = (self.what, self.why, self.remedy)
        super().__init__("\n".join(line for line in lines if line))


def printable(text: str) -> str:
    """Return text with control characters spelled out, because a file must not control a terminal.

    Args:
        text: Text that may quote a file; its line breaks are kept.
    """
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


class ConfigError(JbwError, ValueError):
    """The error for a campaign file, an option or a prior that is not valid as written.

    Examples:
        An option that cannot be meant is refused with what must hold and what was found:

        >>> import jbw
        >>> jbw.rig.measure(repeats=0)
        Traceback (most recent call last):
            ...
        jbw.errors.ConfigError: Argument `repeats` must be at least 1, but is 0.
    """

    exit_code = 2


class DataError(JbwError, ValueError):
    """The error for a file, channel or record that cannot be used as it is.

    Examples:
        A missing file is refused with what its folder holds:

        >>> import jbw
        >>> jbw.read("hit_1.csv")
        Traceback (most recent call last):
            ...
        jbw.errors.DataError: File `hit_1.csv` does not exist.
        Correct `hit_1.csv`: folder `.` has no files.
    """

    exit_code = 3


class ModelError(JbwError, ValueError):
    """The error for parameters or a model that the theory does not allow.

    Examples:
        The exponent of a Bouc-Wen law must be positive:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(118.0, 0.004, alpha=500.0, delta=340.0, gamma=33.0, nu=0.0)
        >>> jbw.hysteresis_rate(joint, v=0.1, z=0.5)
        Traceback (most recent call last):
            ...
        jbw.errors.ModelError: Parameter `nu` must be greater than 0, but nu = 0.
    """

    exit_code = 2


class RunError(JbwError, RuntimeError):
    """The error for a run's folder, disk or lock that prevents the work.

    Examples:
        Results are never mixed with what a folder holds:

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p05V"], repeats=1)
        >>> path = jbw.rig.write(campaign, "beam")
        >>> jbw.rig.write(campaign, "beam")
        Traceback (most recent call last):
            ...
        jbw.errors.RunError: Folder beam must be new or empty, but contains a campaign.
        Choose another folder, or remove beam.
    """

    exit_code = 1


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Add a name to the front of the messages of errors raised inside, unless they contain it."""
    try:
        yield
    except JbwError as error:
        if name in error.what:
            raise
        what = f"{name}: {error.what}"
        raise type(error)(what, why=error.why, remedy=error.remedy) from None


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return "Did you mean ...?" with the most similar known name, or an empty text."""
    lowered = {other.lower(): other for other in names}
    nearest = get_close_matches(name.lower(), list(lowered), n=1, cutoff=0.4)
    return f"Did you mean `{lowered[nearest[0]]}`? " if nearest else ""


def reason_of(error: Exception) -> str:
    """Return the reason of a failure in one sentence, from the error's text or its type."""
    text = error.what if isinstance(error, JbwError) else f"{type(error).__name__}: {error}"
    return printable(" ".join(text.split())).rstrip(".: ") + "."


class Attempts:
    """Attempts to make the items of a result; a failed item is reported, and all others are made.

    Attributes:
        said: One sentence for every part that could not be made.
        report: Function that is called with each sentence at once, and with progress.
    """

    def __init__(self, report: Callable[[str], Any] = logger.info) -> None:
        self.said: list[str] = []
        self.report = report

    def make[Made, Otherwise](
        self, what: str, build: Callable[[], Made], otherwise: Otherwise
    ) -> Made | Otherwise:
        """Return the result of `build`; if it raises, report `what` and return `otherwise`."""
        try:
            return build()
        except Exception as error:
            sentence = f"{what} could not be made and is left out: {reason_of(error)}"
            logger.debug(sentence, exc_info=error)
            self.said.append(sentence)
            self.report(sentence)
            return otherwise

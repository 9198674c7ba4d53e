"""The findings of every verdict by code: sentence, explanation and remedy."""

from collections.abc import Mapping
from typing import Any

from jbw.errors import ConfigError
from jbw.report.messages import calibration, convergence, identifiability, model_adequacy
from jbw.report.messages.message import Message, page, written

FINDINGS: dict[str, Message] = {
    message.code: message
    for topic in (convergence, identifiability, model_adequacy, calibration)
    for message in topic.MESSAGES
}


def register(message: Message) -> Message:
    """Add a finding that an extension defines, so that jbw can print its sentence everywhere.

    Raises:
        ConfigError: Another entry has that code.
    """
    if message.code in FINDINGS:
        raise ConfigError(
            f"The code of a new finding must be unique, but `{message.code}` is a finding of jbw.",
            remedy="Register the new finding under another code.",
        )
    FINDINGS[message.code] = message
    return message


def sentence_of(entry: str, values: Mapping[str, Any], *, passed: bool) -> str:
    """Return the sentence of a finding with its values, for a check that passed or failed."""
    message = FINDINGS[entry]
    return written((passed and message.passed) or message.sentence, values)


def remedy_of(entry: str, values: Mapping[str, Any]) -> str:
    """Return the remedy of a finding with its values."""
    return written(FINDINGS[entry].remedy, values)


def explanations() -> dict[str, str]:
    """Return a dictionary from the code of each finding to its page of explanation."""
    return {code: page(message) for code, message in FINDINGS.items() if message.explanation}

"""The command `jbw explain CODE`."""

from difflib import get_close_matches
from importlib.resources import files

import click

from jbw.cli.options import json_option
from jbw.cli.printing import show_json


def pages() -> dict[str, str]:
    """Code of a finding to what it means."""
    text = (files("jbw.cli") / "explanations.md").read_text(encoding="utf-8")
    sections = [section.partition("\n") for section in text.split("\n## ")[1:]]
    return {code.strip(): page.strip() for code, _, page in sections}


def _codes(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    return [code for code in pages() if code.startswith(incomplete)]


@click.command()
@click.argument("code", required=False, shell_complete=_codes)
@json_option
def explain(code: str | None, json_: bool) -> None:
    """Say what a finding of the verdict means, what it looks at, and what to do.

    Without CODE, all findings by name.
    """
    known = pages()
    if code is not None and code not in known:
        nearest = get_close_matches(code, known, n=1)
        guess = f" Did you mean '{nearest[0]}'?" if nearest else ""
        raise click.UsageError(f"No finding is called '{code}'.{guess} All: jbw explain")
    asked = known if code is None else {code: known[code]}
    if json_:
        show_json(asked)
    else:
        click.echo("\n".join(known) if code is None else f"{code}\n\n{known[code]}")

"""The command `jbw explain CODE`."""

from difflib import get_close_matches
from importlib.resources import files

import click


def pages() -> dict[str, str]:
    """Code of a finding to what it means."""
    text = (files("jbw.cli") / "explanations.md").read_text(encoding="utf-8")
    sections = [section.partition("\n") for section in text.split("\n## ")[1:]]
    return {code.strip(): page.strip() for code, _, page in sections}


@click.command()
@click.argument("code", required=False)
def explain(code: str | None) -> None:
    """Say what a finding of the verdict means, what it looks at, and what to do.

    Without CODE, all findings by name.
    """
    known = pages()
    if code is None:
        click.echo("\n".join(known))
        return
    if code not in known:
        nearest = get_close_matches(code, known, n=1)
        guess = f" Did you mean '{nearest[0]}'?" if nearest else ""
        raise click.UsageError(f"No finding is called '{code}'.{guess} All: jbw explain")
    click.echo(f"{code}\n\n{known[code]}")

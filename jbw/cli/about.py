"""The commands about jbw itself: documentation, explained words, JSON Schemas, completion."""

import re
import sys
import webbrowser
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click
from click.shell_completion import get_completion_class

from jbw.cli.options import json_option
from jbw.cli.printing import answer, show_json
from jbw.errors import RunError
from jbw.report.messages import commands as messages
from jbw.report.messages.commands import NO_NAME, nothing_called, parameter_explained
from jbw.report.messages.findings import explanations
from jbw.report.messages.words import words

PACKAGE = Path(__file__).parents[1]


def parameters() -> dict[str, str]:
    """Return, for every parameter of all laws, its meaning, symbol, unit and laws as text."""
    from jbw.oscillator.laws import LAWS, vocabulary  # loads JAX
    from jbw.quantities import BY_NAME

    of_laws = {
        name: [law.name for law in LAWS.values() if name in names_of_law(law)]
        for name in vocabulary()
    }
    quantities = {**BY_NAME, **vocabulary()}
    return {
        name: parameter_explained(quantity, of_laws.get(name, ()))
        for name, quantity in quantities.items()
    }


def names_of_law(law: Any) -> set[str]:
    """Return the names of a law's parameters and products."""
    of_products = {product.quantity.name for product in law.products}
    return {quantity.name for quantity in law.table} | of_products


def law_explained(name: str) -> str | None:
    """Return what a law of the joint describes, with its parameters; None for other names."""
    from jbw.oscillator.laws import LAWS  # loads JAX

    if (law := LAWS.get(name)) is None:
        return None
    summary = " ".join((law.__doc__ or "").split("\n\n")[0].split())
    return messages.law_explained(summary, [quantity.name for quantity in law.table], name)


def explained(name: str) -> str | None:
    """Return the meaning of a finding, word, table column, parameter or law; None for others."""
    plain = " ".join(name.split())
    for meanings in (explanations(), words()):
        for spelling in (plain, plain.lower(), plain.lower().partition(" [")[0]):
            if spelling in meanings:
                return meanings[spelling]
    # Some laws have one parameter of the same name.
    texts = parameters().get(plain) or at_joint(plain), law_explained(plain)
    return "\n".join(filter(None, texts)) or None


def at_joint(name: str) -> str | None:
    """Return the meaning of a parameter with a joint's name, such as alpha@bolt_1; else None."""
    from jbw.quantities import AT, motion_factors_in

    parameter, _, joint = name.partition(AT)
    if factor := motion_factors_in([name]).get(name):
        return parameter_explained(factor, ())
    return parameters().get(parameter) if joint else None


@click.command()
@click.argument(
    "code", required=False, metavar="[NAME]",
    shell_complete=lambda _, __, start: [
        name for name in (*explanations(), *words()) if name.startswith(start)
    ],
)  # fmt: skip
@json_option
def explain(code: str | None, json_: bool) -> None:
    """Explain a finding, a parameter, a law, a table column or a word of the results.

    For a finding of the verdict: what the check examines, and what to do if it fails. Without NAME,
    all findings, one per line.
    """
    if code is None:
        lines = {name: in_one_line(page) for name, page in explanations().items()}
        widest = max(map(len, lines))
        answer(
            json_, explanations(),
            saved="\n".join(f"{name:<{widest}}  {line}" for name, line in lines.items()),
        )  # fmt: skip
        click.echo(NO_NAME, err=True)
        return
    page = explained(code)
    if page is None:
        names = {name.lower(): name for name in (*explanations(), *words(), *parameters())}
        nearest = get_close_matches(code.lower(), names, n=1)
        raise click.UsageError(nothing_called(code, names[nearest[0]] if nearest else ""))
    answer(json_, {code: page}, saved=f"{code}\n\n{page}")


def in_one_line(page: str) -> str:
    """Return the first sentence of a finding's page, which states what the check examines."""
    sentence = re.match(r"(?:Check: )?(.+?)(?:[.;:]\s|[.;:]?$)", " ".join(page.split()))
    return "" if sentence is None else sentence[1]


@click.command()
@json_option
def more(json_: bool) -> None:
    """List the commands that `jbw --help` leaves out."""
    from jbw.cli import MORE, write_commands
    from jbw.report.messages.commands import SHORT

    formatter = click.get_current_context().make_formatter()
    write_commands(formatter, MORE)
    named = {name: SHORT[name] for names in MORE.values() for name in names}
    answer(json_, named, saved=formatter.getvalue().strip("\n"))


@click.command()
@click.argument("file", type=click.Choice(["campaign", "plan"]), default="campaign")
@click.option("--json", is_flag=True, expose_value=False, help="Print JSON; this is the default.")
def schema(file: str) -> None:
    """Print the JSON Schema of a campaign file, or of a plan file.

    With it, an editor that supports JSON Schema for TOML completes keys, shows their meaning and
    marks errors: write `jbw schema > campaign.schema.json`, and as the file's first line `#:schema
    campaign.schema.json` (Even Better TOML, taplo, tombi).
    """
    from jbw.campaign.document import json_schema
    from jbw.campaign.schema import CampaignFile
    from jbw.planning.description import plan_file

    model = plan_file() if file == "plan" else CampaignFile
    show_json(json_schema(model))


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the script that completes the commands and options of jbw in SHELL.

    For bash, put `eval "$(jbw completion bash)"` into ~/.bashrc; for zsh, the same with zsh into
    ~/.zshrc; for fish, write the output to ~/.config/fish/completions/jbw.fish.
    """
    from jbw.cli import cli

    shell_completion = get_completion_class(shell)
    if shell_completion is None:  # never happens, because Click supports all three shells
        raise click.UsageError(f"Click completes nothing in {shell}.")
    click.echo(shell_completion(cli, {}, "jbw", "_JBW_COMPLETE").source())


def first_page(package: Path) -> Path:
    """Return the path of the documentation's first page, installed or built in a clone.

    Raises:
        RunError: The documentation is in neither place.
    """
    clone = package.parent
    folders = [package / "site", *([clone / "site"] if (clone / "mkdocs.yml").is_file() else [])]
    for folder in folders:
        if (page := folder / "index.html").is_file():
            return page
    raise RunError(
        f"The documentation is not built: file {folders[-1] / 'index.html'} does not exist.",
        remedy="Build the documentation in a clone of jbw: "
        'pip install -e ".[docs]" && mkdocs build',
    )


@click.command()
@json_option
def docs(json_: bool) -> None:
    """Print the path of the documentation; on a terminal, also open a browser with it.

    It is read from files and needs no network.
    """
    page = first_page(PACKAGE).resolve()
    answer(json_, {"page": str(page)}, saved=str(page))
    if not json_ and sys.stdout.isatty():
        webbrowser.open(page.as_uri())

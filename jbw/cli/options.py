"""Options that several commands share."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from jbw.errors import ConfigError
from jbw.report.formats import FORMATS, formats_of
from jbw.report.messages import commands as messages

PICTURES = tuple(f".{name}" for name in FORMATS)
Option = Callable[[Callable[..., Any]], Callable[..., Any]]

json_option = click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
verbose_option = click.option(
    "--verbose", is_flag=True, help="Print all steps, statements, errors and findings."
)
outside_option = click.option(
    "--allow-outside", is_flag=True, help="Read files outside the campaign's folder."
)
strict_option = click.option(
    "--strict", is_flag=True, help="Return exit code 4 unless the verdict is ok."
)


figures_option = click.option(
    "--figures",
    metavar="FORMATS",
    default="",
    callback=lambda _, __, value: formats_of(filter(None, value.split(",")), "Option --figures"),
    help="Also write every figure of the report to figures/, as png, svg, pdf, or several of "
    "these separated by commas.",
)


class CampaignPath(click.Path):
    """Option type for a campaign file or its folder, which must exist; it imports nothing slow."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the path of the campaign file; raise a ConfigError if it cannot be read."""
        from jbw.campaign.document import CAMPAIGN, campaign_in, require_file

        path = Path(str(super().convert(value, param, ctx)))
        if path.is_dir():
            path = campaign_in(path) or path
        require_file(path, *CAMPAIGN)
        return path


campaign_argument = click.argument("campaign", type=CampaignPath(path_type=Path))
given_argument = click.argument(
    "given", metavar="CAMPAIGN|RECORD...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
run_argument = click.argument(
    "folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path)
)


def campaigns_given(given: Sequence[Path], mass: float | None = None) -> list[Path]:
    """Return the campaign files named by the arguments; announce drafted files on stderr.

    A modal mass [kg] becomes part of a drafted campaign.
    """
    from jbw.campaign.document import CAMPAIGN, is_campaign, require_file

    # Nothing in the records has to be read, because campaign files are given.
    if mass is None and all(map(is_campaign, given)):
        for path in given[:1]:
            require_file(path, *CAMPAIGN)
        return list(given)
    from jbw.cli.given import campaigns_of

    return campaigns_of(given, lambda sentence: click.echo(sentence, err=True), mass)


def one_campaign(given: Sequence[Path]) -> Path:
    """Return the one campaign file named by the arguments.

    Raises:
        UsageError: The arguments stand for several campaigns.
    """
    campaign, *others = campaigns_given(given)
    if others:
        raise click.UsageError(messages.one_at_a_time(str(campaign), str(others[0])))
    return campaign


def figure_option(what: str, example: str) -> Option:
    """Return the option `--figure FILE`; the file's suffix determines the format."""

    def picture(_: Any, __: Any, path: Path | None) -> Path | None:
        if path is not None and path.suffix not in PICTURES:
            raise ConfigError(
                f"Option --figure must end in one of {', '.join(PICTURES)}, but is {path}.",
                remedy=f"Use a file name with one of these endings, for example {example}.",
            )
        return path

    return click.option(
        "--figure",
        type=click.Path(dir_okay=False, writable=True, path_type=Path),
        callback=picture,
        help=f"Draw {what} against amplitude into this file (.png, .svg or .pdf).",
    )


def out_option(where: str) -> Option:
    """Return the option `--out DIR`; its help states the default folder."""
    return click.option(
        "--out",
        type=click.Path(file_okay=False, path_type=Path),
        help=f"New or empty folder to write to; by default {where}.",
    )


def seed_option(otherwise: str = "", default: int | None = None) -> Option:
    """Return the option `--seed N`; its help states where the default comes from."""
    default_words = f", the {otherwise}'s by default" if otherwise else ""
    return click.option(
        "--seed", type=int, default=default, show_default=default is not None,
        help=f"Seed of all random numbers{default_words}.",
    )  # fmt: skip

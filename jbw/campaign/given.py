"""The input of a command: campaign files, folders with one, or records to draft one from."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

from jbw.campaign.draft import (
    Draft,
    measurement_files,
    shared_name,
    start_campaign,
    write_campaign,
)
from jbw.campaign.written import CAMPAIGN, NAMED, campaign_in, is_campaign, require_file
from jbw.errors import ConfigError
from jbw.report.messages import draft as messages

Tell = Callable[[str], None]


def campaigns_of(given: Sequence[Path], tell: Tell, mass: float | None = None) -> list[Path]:
    """Return the campaign files that paths stand for, in their order.

    A folder stands for the campaign file in it; where it holds records alone, their campaign is
    drafted and written there. Records that are named are drafted into one campaign, which is
    written beside them under the name that the first has, without its number where it has others.

    Args:
        given: Campaign files, folders or records.
        tell: Called with a sentence for every file written and every guess in it.
        mass: Modal mass that goes into what is drafted [kg].

    Raises:
        ConfigError: A path that does not exist or may not be read, a folder of neither campaign nor
            records, records of several folders, a campaign file of their name that holds others, or
            a mass beside a campaign file.
        DataError: No record can be read.
    """
    named = [path for path in given if not (is_campaign(path) or path.is_dir())]
    for path in named:
        require_file(path, "Record", messages.NAME_RECORD)
    campaigns = []
    for path in given:
        if path not in named:
            is_folder = path.is_dir()
            campaigns.append(_of_folder(path, tell, mass) if is_folder else _there(path, mass))
        elif path is named[0]:
            campaigns.append(_of_records(named, tell, mass))
    return campaigns


def _there(campaign: Path, mass: float | None) -> Path:
    """Return a campaign file that is there already; refuse a modal mass, which it states itself."""
    if mass is not None:
        what, remedy = messages.mass_of_campaign(str(campaign), f"{mass:g}")
        raise ConfigError(what, remedy=remedy)
    return campaign


def _of_folder(folder: Path, tell: Tell, mass: float | None) -> Path:
    if (campaign := campaign_in(folder)) is not None:
        return _there(campaign, mass)
    if any(folder.glob("*.toml")) or not measurement_files(folder):
        require_file(folder, *CAMPAIGN)  # which names one of several, or the command that drafts
    return _written(start_campaign(folder, mass=mass), folder / NAMED, tell)


def _of_records(records: Sequence[Path], tell: Tell, mass: float | None) -> Path:
    folders = {path.resolve().parent for path in records}
    if len(folders) > 1:
        what, why, remedy = messages.several_folders(sorted(map(str, folders)))
        raise ConfigError(what, why=why, remedy=remedy)
    draft = start_campaign(records[0].parent, files=records, mass=mass)
    first, *others = records
    path = first.with_name(f"{shared_name(first) if others else first.stem}.toml")
    if not path.exists():
        return _written(draft, path, tell)
    require_file(path, *CAMPAIGN)
    if _files_of(path.read_text("utf-8")) != _files_of(draft.text):
        what, why, remedy = messages.other_records(str(path))
        raise ConfigError(what, why=why, remedy=remedy)
    tell(messages.drafted_before(str(path)))
    return _there(path, mass)


def _files_of(text: str) -> list[object]:
    """Return what the tests of a campaign file name as their files, in any order."""
    try:
        tests = tomllib.loads(text).get("test", [])
        return sorted((test.get("files") for test in tests), key=str)
    except (tomllib.TOMLDecodeError, AttributeError, TypeError):
        return []  # of a file that is none: no draft has no test


def _written(draft: Draft, path: Path, tell: Tell) -> Path:
    write_campaign(draft, path.parent, path.name)
    tell(messages.drafted(str(path)))
    for assumed in draft.assumed:
        tell(f"CHECK: {assumed}")
    return path

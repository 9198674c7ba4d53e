"""The input of a command: campaign files, their folders, or records without a campaign."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

from jbw.campaign.document import CAMPAIGN, NAMED, campaign_in, is_campaign, require_file
from jbw.campaign.draft import (
    Draft,
    folders_of_records,
    measurement_files,
    shared_name,
    start_campaign,
    write_campaign,
)
from jbw.errors import ConfigError
from jbw.report.messages import draft as messages

Tell = Callable[[str], None]


def campaigns_of(given: Sequence[Path], tell: Tell, mass: float | None = None) -> list[Path]:
    """Return the campaign files for given paths; draft one for records without a campaign.

    A folder refers to the campaign file in it; if it contains only records, their campaign is
    drafted and written there; if it contains only folders of either, to all of these. Named
    records are drafted into one campaign, which is written next to them. Its name is that of the
    first record, without its number if there are several.

    Args:
        given: Campaign files, folders, records, or patterns of their names.
        tell: Function that is called with a sentence for every written file and every guess.
        mass: Modal mass for the drafted campaign [kg].

    Raises:
        ConfigError: A path does not exist or cannot be read; a folder has neither campaign nor
            records; the records are in several folders; a campaign file of their name is for other
            records; or a mass is given for an existing campaign file.
        DataError: No record can be read.
    """
    given = [each for path in given for each in _matching(path)]
    named = [path for path in given if not (is_campaign(path) or path.is_dir())]
    for path in named:
        require_file(path, "Record", messages.NAME_RECORD)
    campaigns = []
    for path in given:
        if path not in named:
            is_folder = path.is_dir()
            campaigns += _of_folder(path, tell, mass) if is_folder else [_there(path, mass)]
        elif path is named[0]:
            campaigns.append(_of_records(named, tell, mass))
    return campaigns


def _matching(path: Path) -> list[Path]:
    """Return the paths that match a pattern such as `hit_*.csv`; other paths unchanged."""
    is_pattern = not path.exists() and any(mark in path.name for mark in "*?")
    return (sorted(path.parent.glob(path.name)) if is_pattern else []) or [path]


def _there(campaign: Path, mass: float | None) -> Path:
    """Return an existing campaign file; raise a ConfigError if `mass` is given too."""
    if mass is not None:
        what, remedy = messages.mass_of_campaign(str(campaign), f"{mass:g}")
        raise ConfigError(what, remedy=remedy)
    return campaign


def _of_folder(folder: Path, tell: Tell, mass: float | None) -> list[Path]:
    if (campaign := campaign_in(folder)) is not None:
        return [_there(campaign, mass)]
    if below := folders_of_records(folder):
        return [campaign for path in below for campaign in _of_folder(path, tell, mass)]
    if any(folder.glob("*.toml")) or not measurement_files(folder):
        # The error asks the user to name one of several files, or names the command for a draft.
        require_file(folder, *CAMPAIGN)
    return [_written(start_campaign(folder, mass=mass), folder / NAMED, tell)]


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
    """Return the sorted `files` entries of all tests of a campaign file; empty if it is invalid."""
    try:
        tests = tomllib.loads(text).get("test", [])
        return sorted((test.get("files") for test in tests), key=str)
    except (tomllib.TOMLDecodeError, AttributeError, TypeError):
        return []  # Every draft has tests, so that an invalid file never equals a draft.


def _written(draft: Draft, path: Path, tell: Tell) -> Path:
    write_campaign(draft, path.parent, path.name)
    tell(messages.drafted(str(path)))
    for assumed in draft.assumed:
        tell(f"CHECK: {assumed}")
    return path

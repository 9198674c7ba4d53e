"""The file formats of saved figures."""

from collections.abc import Iterable

from jbw.errors import ConfigError

FORMATS = ("png", "svg", "pdf")


def formats_of(names: Iterable[str], source: str) -> tuple[str, ...]:
    """Return the named file formats, each once; raise an error for an unknown one.

    `source` tells error messages where the names are given.

    Raises:
        ConfigError: A name is no format.
    """
    formats = tuple(dict.fromkeys(name.strip().lower().removeprefix(".") for name in names))
    for name in formats:
        if name not in FORMATS:
            raise ConfigError(
                f"{source} must name formats among {', '.join(FORMATS)}, but one is {name!r}.",
                remedy="Name one or more of the listed formats, for example pdf.",
            )
    return formats

"""The base of stored results: a JSON object in types."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Number = float | None  # None where the number is unknown or infinite


class Stored(BaseModel):
    """A value that is stored as a JSON object."""

    model_config = ConfigDict(extra="allow", frozen=True)

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> Self:
        """Return the value of a JSON object."""
        return cls.model_validate(record)

    def plain(self) -> dict[str, Any]:
        """Return the JSON object: the fields that were read or set."""
        return self.model_dump(exclude_unset=True, by_alias=True)

    def replaced(self, **fields: Any) -> Self:
        """Return the value with some fields replaced."""
        return self.model_copy(update=fields)


class StoredRow(Stored):
    """A row of a table by name; the name is its key in the file."""

    name: str = Field(default="", exclude=True)


def _with_names[Row: StoredRow](rows: dict[str, Row]) -> dict[str, Row]:
    return {name: row.replaced(name=name) for name, row in rows.items()}


type ByName[Row: StoredRow] = Annotated[dict[str, Row], AfterValidator(_with_names)]

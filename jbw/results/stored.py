"""The base type of stored results: a JSON object with typed fields."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

Number = float | None  # This is None where the number is unknown or infinite.


def finite(value: Any) -> Number:
    """Return a number as it is stored: None for NaN, infinity and None."""
    return float(value) if value is not None and math.isfinite(value) else None


class Stored(BaseModel):
    """A value that is stored as a JSON object."""

    model_config = ConfigDict(extra="allow", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _without_null(cls, record: Any) -> Any:
        """Omit a null that an earlier version wrote if the field now has another default."""
        if not isinstance(record, Mapping):
            return record
        filled = {
            name
            for name, field in cls.model_fields.items()
            if field.default is not None and not field.is_required()
        }
        return {key: x for key, x in record.items() if x is not None or key not in filled}

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> Self:
        """Convert a JSON object to this type."""
        return cls.model_validate(record)

    def plain(self) -> dict[str, Any]:
        """Return the JSON object with only those fields that were read or set."""
        return self.model_dump(exclude_unset=True, by_alias=True)

    def replaced(self, **fields: Any) -> Self:
        """Return a copy in which some fields are replaced."""
        return self.model_copy(update=fields)


class StoredRow(Stored):
    """A named row of a table; the name is its key in the file."""

    name: str = Field(default="", exclude=True)


def _with_names[Row: StoredRow](rows: dict[str, Row]) -> dict[str, Row]:
    return {name: row.replaced(name=name) for name, row in rows.items()}


type ByName[Row: StoredRow] = Annotated[dict[str, Row], AfterValidator(_with_names)]

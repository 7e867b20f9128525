"""Files that describe a recording, as models: each entry with its type, range, and the remedy that
an error ends with."""

from __future__ import annotations

import reprlib
from decimal import Decimal
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from fieldgrid.core import quoted, shortened

LIMIT = 10**9
"""No length, angle or offset is as large."""


class EntryTable(BaseModel):
    """A table of entries: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


Model = TypeVar("Model", bound=EntryTable)


def entry(remedy: str, default: Any = ..., **limits: Any) -> Any:
    """An entry; without a default it must be there. `remedy` is what to do when it cannot be."""
    return Field(default=default, description=remedy, **limits)


def _number(value: object) -> Decimal:
    is_number = isinstance(value, (int, float, Decimal)) and not isinstance(value, bool)
    number = Decimal(value) if is_number else Decimal("nan")  # type: ignore[arg-type]
    if not number.is_finite() or abs(number) >= 100 * LIMIT:
        raise ValueError("is no number")
    return number


Exact = Annotated[Decimal, BeforeValidator(_number)]
"""A finite number as it stands in the file, to the last nanosecond."""


def _metres(value: object) -> float:
    number = float(_number(value))
    if abs(number) >= LIMIT:
        raise ValueError("is too large")
    return number


Number = Annotated[float, BeforeValidator(_metres)]
"""A finite number of metres, degrees or pixels."""

Positive = Annotated[Number, Field(gt=0.0)]


class MisfitError(ValueError):
    """Why a document does not fit its model, as the end of a sentence after the file's name."""


def fitted(model: type[Model], document: Any) -> Model:
    """The document as a model. Raises MisfitError with the first thing that is wrong."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        # A key that is not known may be the misspelt one that is missing.
        first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    # The innermost table and entry at a place, and the entry's key.
    table: type[EntryTable] = model
    info, key = None, ""
    for part in map(str, first["loc"]):
        if part not in table.model_fields:
            break
        info, key = table.model_fields[part], part
        for kind in (info.annotation, *get_args(info.annotation)):
            if isinstance(kind, type) and issubclass(kind, EntryTable):
                table = kind
    value = first["input"]
    value = shortened(value, 60) if isinstance(value, Decimal) else reprlib.repr(value)
    if first["type"] == "extra_forbidden":
        known = ", ".join(table.model_fields)
        raise MisfitError(f": {quoted(first['loc'][-1])} is not a setting; known are {known}.")
    if info is None:
        raise MisfitError(f" holds {value}; give a table.")
    if first["type"] == "missing":
        raise MisfitError(f" lacks {key}; {info.description}.")
    if first["type"] == "model_type":
        raise MisfitError(f": {key} is {value}; give a table [{key}].")
    why = f", which {first['ctx']['error']}" if first["type"] == "value_error" else ""
    raise MisfitError(f": {key} is {value}{why}; {info.description}.")

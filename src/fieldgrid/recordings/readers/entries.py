"""Files that describe a recording, as models: each entry with its type, range, and the remedy that
an error ends with."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Collection
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from fieldgrid.core import (
    MAX_BYTES,
    RecordingError,
    parse_json,
    parse_toml,
    quoted,
    shortened,
)
from fieldgrid.recordings.files import read_text

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


Number = Annotated[
    float, BeforeValidator(lambda value: float(_number(value))), Field(gt=-LIMIT, lt=LIMIT)
]
"""A finite number of metres, degrees or pixels."""

Positive = Annotated[Number, Field(gt=0.0)]


_PARSERS: dict[str, Callable[[str, Callable[[str], Any]], Any]] = {
    "TOML": parse_toml,
    "JSON": parse_json,
}


def read_document(
    path: Path,
    kind: Literal["TOML", "JSON"],
    error: type[RecordingError] = RecordingError,
    number: Callable[[str], Any] = float,
) -> Any:
    """What a file of this kind holds, its numbers with a point made by `number`; an error of the
    type `error` for a file that is not of the kind."""
    text = read_text(path, MAX_BYTES, error)
    try:
        return _PARSERS[kind](text, number)
    except (ValueError, ArithmeticError) as problem:
        raise error(f"{path} is not {kind}: {problem}; correct it.") from problem


def fitted(
    model: type[Model],
    document: Any,
    where: str,
    error: type[RecordingError] = RecordingError,
    remarks: Collection[str] = (),
) -> Model:
    """The document as a model, without the `remarks`, keys of which nothing is read. Raises an
    `error` with the first thing that is wrong; `where` is what it calls the document."""
    if isinstance(document, dict):
        document = {key: value for key, value in document.items() if key not in remarks}
    try:
        return model.model_validate(document)
    except ValidationError as problem:
        # A key that is not known may be the misspelt one that is missing.
        first = min(problem.errors(), key=lambda one: one["type"] != "extra_forbidden")
    raise error(where + _misfit(model, first, remarks))


def _misfit(model: type[EntryTable], first: Any, remarks: Collection[str]) -> str:
    """What does not fit, as the end of a sentence after the name of the document."""
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
        more = f"; for remarks there are {', '.join(remarks)}" if remarks else ""
        return f": {quoted(first['loc'][-1])} is not a setting; known are {known}{more}."
    if info is None:
        return f" holds {value}; give a table with {next(iter(table.model_fields))}."
    if first["type"] == "missing":
        return f" lacks {key}; {info.description}."
    if first["type"] == "model_type":
        return f": {key} is {value}; give a table [{key}]."
    why = f", which {first['ctx']['error']}" if first["type"] == "value_error" else ""
    return f": {key} is {value}{why}; {info.description}."

"""What the page may have done: sessions taken out and put back, marks, exports.

Each change of a map is one transaction, and is refused where the map is no longer the one that the
user saw when saying yes.
"""

from __future__ import annotations

import shutil
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MAX_CORNERS, MAX_TEXT, MapFile, Mark, MarkKind
from fieldgrid.view.exports import write_export
from fieldgrid.view.maps import ShownMap, ShownSource

Body = TypeVar("Body", bound=BaseModel)
Text = Annotated[str, Field(min_length=1, max_length=200)]
Words = Annotated[str, Field(max_length=MAX_TEXT)]
Metres = Annotated[float, Field(gt=-1e6, lt=1e6)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class SessionChange(_Strict):
    """Take a session out of the map, or put it back; `version` is that of the map as seen."""

    version: Text
    action: Literal["remove", "restore"]
    session: Text


class NewMark(_Strict):
    """Add a mark: a point of one corner or a polygon; `version` is that of the map as seen."""

    version: Text
    kind: Literal["keepout", "free", "obstacle", "place"]
    corners: Annotated[list[tuple[Metres, Metres]], Field(min_length=1, max_length=MAX_CORNERS)]
    name: Words
    note: Words
    author: Words


class MarkChange(_Strict):
    """Take a mark out of the map, or put it back; `version` is that of the map as seen."""

    version: Text
    action: Literal["remove", "restore"]
    mark: Annotated[int, Field(ge=1)]


class Export(_Strict):
    """Write a part of the map: all of it, or what lies within `bounds`."""

    format: Text
    layer: Text
    bounds: tuple[Metres, Metres, Metres, Metres] | None = None
    cell_m: Annotated[float, Field(gt=0.0, lt=100.0)] | None = None


def change_session(shown: ShownSource, asked: SessionChange) -> Response:
    """Remove or restore a session."""
    with _changing(shown, asked.version) as universal:
        is_removal = asked.action == "remove"
        change = universal.remove_session if is_removal else universal.restore_session
        change(asked.session)
    return JSONResponse({})


def add_mark(shown: ShownSource, asked: NewMark) -> Response:
    """Add a mark; says its number."""
    texts = asked.name.strip(), asked.note.strip(), asked.author.strip()
    with _changing(shown, asked.version) as universal:
        (number,) = universal.add_marks([Mark(MarkKind(asked.kind), tuple(asked.corners), *texts)])
    return JSONResponse({"id": number})


def change_mark(shown: ShownSource, asked: MarkChange) -> Response:
    """Remove or restore a mark."""
    with _changing(shown, asked.version) as universal:
        change = universal.remove_marks if asked.action == "remove" else universal.restore_marks
        change([asked.mark])
    return JSONResponse({})


def export(shown: ShownSource, asked: Export) -> Response:
    """Send a file, which is removed from the server's disk once it was sent."""
    bounds = None if asked.bounds is None else Bounds(*asked.bounds)
    with shown.open_alone() as universal:
        file, folder = write_export(
            universal, shown.name, Selection(bounds, asked.cell_m, asked.layer), asked.format
        )
    return FileResponse(
        file,
        filename=file.name,
        headers={"Cache-Control": "no-store"},
        background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True),
    )


@contextmanager
def _changing(shown: ShownSource, version: str) -> Iterator[MapFile]:
    """The map, to be changed; ConfigError for a farm, and for a map of another version."""
    if not isinstance(shown, ShownMap):
        raise ConfigError(f"{shown.path} is a folder of maps, for looking; change its maps.")
    with shown.open(writable=True) as universal:
        shown.check_version(version)
        yield universal


def handler(
    model: type[Body],
    act: Callable[[ShownSource, Body], Response],
    picked: Callable[[Request], ShownSource],
) -> Callable[[Request], Awaitable[Response]]:
    """What answers a post: its JSON checked, then acted upon in a thread."""

    async def handle(request: Request) -> Response:
        shown = picked(request)
        try:
            # In JSON a pair of numbers is a list, which a strict model takes for a tuple from JSON.
            asked = model.model_validate_json(await request.body())
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "the request"
            raise ConfigError(f"{where[:80]}: {first['msg'][:120]}.") from error
        return await run_in_threadpool(act, shown, asked)

    return handle

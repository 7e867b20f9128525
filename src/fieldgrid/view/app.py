"""The web application: what each address answers. It knows HTTP; the modules beside it know maps.

No path comes from a request: maps, sessions and layers are looked up in what the server was started
with and in the maps themselves.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import anyio.to_thread
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from fieldgrid.core import ConfigError, FieldgridError, MapError, MapWriteError, quoted
from fieldgrid.geometry import Bounds, TileIndex
from fieldgrid.maps import LAYERS, DrivenMap, MapFile
from fieldgrid.view import actions, drives, exports, layers, page
from fieldgrid.view.about import describe_map
from fieldgrid.view.features import route_table
from fieldgrid.view.maps import ShownSource
from fieldgrid.view.pictures import find_picture
from fieldgrid.view.security import Access, Guard
from fieldgrid.view.why import explain

if TYPE_CHECKING:
    from fieldgrid.field import ChangedObject


# What changed between two times as objects, for the page.


MOST_CELLS = 20_000_000
"""Cells that are looked through for one answer: some seconds."""


def changed_objects(
    universal: MapFile, before: str, after: str, bounds: Bounds | None
) -> list[dict[str, Any]]:
    """The objects that changed between two sessions, the surest first, as `find_changes` has them.

    `geometry` is as that of features: kind 3 and rings of (E, N), metres. Raises ConfigError for
    a part of more than 20 million cells, and as `find_changes` does.
    """
    from fieldgrid.field import find_changes  # brings 40 MB of libraries

    west_m, south_m, east_m, north_m = universal.bounds if bounds is None else bounds
    if (east_m - west_m) * (north_m - south_m) > MOST_CELLS * universal.cell_m**2:
        raise ConfigError("That is too much of the map to look for changed objects; zoom in.")
    return [_as_dict(one) for one in find_changes(universal, before, after, bounds=bounds)]


def _as_dict(one: ChangedObject) -> dict[str, Any]:
    is_moved = math.isfinite(one.from_east_m)
    parts = getattr(one.area, "geoms", (one.area,))
    polygons = [(part.exterior, *part.interiors) for part in parts]
    return {
        "id": one.id,
        "kind": one.kind.value,
        "geometry": [
            [3, [[[round(e, 3), round(n, 3)] for e, n in ring.coords] for ring in rings]]
            for rings in polygons
        ],
        "east_m": round(one.east_m, 3),
        "north_m": round(one.north_m, 3),
        "from": [round(one.from_east_m, 3), round(one.from_north_m, 3)] if is_moved else None,
        "area_m2": round(one.area_m2, 3),
        "length_m": round(one.length_m, 2),
        "width_m": round(one.width_m, 2),
        "confidence": round(one.confidence, 3),
        "stood": list(one.stood),
        "freed": list(one.freed),
    }


_THREADS = 4
"""Requests that read maps at once: each may hold some tens of megabytes."""

_MAX_LEVEL = 24
_MAX_TILE = 1 << 26
_FOREVER = {"Cache-Control": "private, max-age=31536000, immutable"}
_FRESH = {"Cache-Control": "no-store"}
_STATUSES: dict[type[Exception], int] = {MapWriteError: 503, MapError: 409, Exception: 400}
"""Statuses by the kinds of errors, of which the first that fits counts."""


class Viewer(NamedTuple):
    """What is shown, and what may be done with it."""

    maps: tuple[ShownSource, ...]
    access: Access
    writable: bool
    recordings: tuple[Path, ...]
    routes: tuple[Path, ...] = ()

    def picked(self, request: Request) -> ShownSource:
        """The map that a request is about, once it is sure that it is the one that its page was
        told of."""
        number = _whole(request.path_params["map"], 0, len(self.maps) - 1)
        self.maps[number].check_same()
        return self.maps[number]


def make_app(viewer: Viewer) -> Starlette:
    """The application for a viewer."""

    def about(request: Request) -> Response:
        return _json(
            {
                "maps": [describe_map(k, one) for k, one in enumerate(viewer.maps)],
                "writable": viewer.writable,
                "formats": exports.formats(),
            }
        )

    def tile(request: Request) -> Response:
        shown = viewer.picked(request)
        level = _whole(request.path_params["level"], 0, _MAX_LEVEL)
        place = TileIndex(
            _whole(request.path_params["ty"], -_MAX_TILE, _MAX_TILE),
            _whole(request.path_params["tx"], -_MAX_TILE, _MAX_TILE),
        )
        layer = request.path_params["layer"]
        query = request.query_params
        if layer == "change":
            drawn = _change_tile(shown, level, place, query.get("from", ""), query.get("to", ""))
        elif layer == "density" and "sessions" not in query:
            drawn = shown.density(level, place)
        else:
            drawn = _layer_tile(shown, layer, level, place, query.get("sessions"))
        # The address has the version of the file, so that what is kept never gets old.
        headers = _FOREVER if query.get("v") == shown.version() else _FRESH
        if drawn is None:
            return Response(status_code=204, headers=headers)
        return Response(drawn, media_type="image/png", headers=headers)

    def scale(request: Request) -> Response:
        shown, layer = viewer.picked(request), _layer(request.path_params["layer"])
        return _json(_scale(shown, layer)._asdict())

    def track(request: Request) -> Response:
        shown = viewer.picked(request)
        with shown.open() as universal:
            name = _session_name(universal, request.path_params["session"])
        return _json(shown.kept(("track", name), partial(drives.track, session=name)))

    def frames(request: Request) -> Response:
        shown = viewer.picked(request)
        chosen = request.query_params.get("sessions")
        sessions = None if chosen is None else set(_session_numbers(chosen))
        bounds = _bounds(request.query_params.get("bounds", ""))
        return _json(drives.frames_within(shown.frames(bounds), bounds, sessions))

    def cell(request: Request) -> Response:
        query = request.query_params
        east_m, north_m = _metres(query.get("east", "")), _metres(query.get("north", ""))
        chosen = query.get("sessions")
        with viewer.picked(request).open() as universal:
            names = None if chosen is None else _session_names(universal, chosen)
            return _json(explain(universal, east_m, north_m, names))

    def image(request: Request) -> Response:
        shown, query = viewer.picked(request), request.query_params
        with shown.open() as universal:
            name = _session_name(universal, query.get("session", ""))
        names, hashes = shown.kept(("images", name), partial(_images, session=name)).get(
            query.get("frame", ""), ((), ())
        )
        number = _whole(query.get("image", ""), 0, max(len(names) - 1, 0))
        if not names:
            raise ConfigError("The map has no such frame, or no images of it.")
        folders = (Path(), shown.folder, *viewer.recordings)
        sha256 = hashes[number] if number < len(hashes) else ""
        jpeg, width_px, height_px = find_picture(names[number], sha256, folders)
        return Response(
            jpeg,
            media_type="image/jpeg",
            headers=_FRESH | {"X-Image-Size": f"{width_px} {height_px}"},
        )

    def features(request: Request) -> Response:
        shown = viewer.picked(request)
        with shown.open() as universal:
            routes = [route_table(path, universal.datum) for path in viewer.routes]
        return _json({"tables": shown.features() + routes})

    def changes(request: Request) -> Response:
        shown, query = viewer.picked(request), request.query_params
        between, part = (query.get("from", ""), query.get("to", "")), query.get("bounds", "")

        def find(universal: DrivenMap) -> list[dict[str, Any]]:
            single = _single(universal)
            before, after = (_session_name(single, number) for number in between)
            return changed_objects(single, before, after, _bounds(part) if part else None)

        return _json({"objects": shown.kept(("changes", *between, part), find)})

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        anyio.to_thread.current_default_thread_limiter().total_tokens = _THREADS
        yield

    one = "/api/maps/{map}"
    routes = [
        *page.routes(),
        Route("/api/maps", about),
        Route(f"{one}/tiles/{{layer}}/{{level}}/{{ty}}/{{tx}}", tile),
        Route(f"{one}/scales/{{layer}}", scale),
        Route(f"{one}/tracks/{{session}}", track),
        Route(f"{one}/frames", frames),
        Route(f"{one}/cell", cell),
        Route(f"{one}/image", image),
        Route(f"{one}/features", features),
        Route(f"{one}/changes", changes),
        _post(f"{one}/export", actions.Export, actions.export, viewer),
    ]
    if viewer.writable:
        routes += [
            _post(f"{one}/sessions", actions.SessionChange, actions.change_session, viewer),
            _post(f"{one}/marks", actions.NewMark, actions.add_mark, viewer),
            _post(f"{one}/marks/change", actions.MarkChange, actions.change_mark, viewer),
        ]
    return Starlette(
        routes=routes,
        middleware=[Middleware(Guard, access=viewer.access)],
        exception_handlers={FieldgridError: _failed},
        lifespan=lifespan,
    )


def _post(
    path: str,
    model: type[actions.Body],
    act: Callable[[ShownSource, actions.Body], Response],
    viewer: Viewer,
) -> Route:
    return Route(path, actions.handler(model, act, viewer.picked), methods=["POST"])


def _failed(request: Request, error: Exception) -> Response:
    status = next(code for kind, code in _STATUSES.items() if isinstance(error, kind))
    return JSONResponse({"error": str(error)}, status, headers=_FRESH)


def _json(value: Any) -> Response:
    return JSONResponse(value, headers=_FRESH)


def _scale(shown: ShownSource, layer: str) -> layers.Scale:
    return shown.kept(("scale", layer), partial(layers.scale_of, layer=layer))


def _layer_tile(
    shown: ShownSource, layer: str, level: int, place: TileIndex, sessions: str | None
) -> bytes | None:
    scale = _scale(shown, _layer(layer))
    with shown.open() as universal:
        bounds, cell_m = layers.tile_bounds(universal, level, place)
        names = None if sessions is None else _session_names(universal, sessions)
        if names == []:
            return None
        view = universal.read(bounds, cell_m, layers=[layer], sessions=names)
    return layers.draw_layer(view, layer, scale)


def _change_tile(
    shown: ShownSource, level: int, place: TileIndex, before: str, after: str
) -> bytes | None:
    with shown.open() as universal:
        single = _single(universal)
        bounds, cell_m = layers.tile_bounds(single, level, place)
        names = [_session_name(single, number) for number in (before, after)]
        change = single.diff(names[0], names[1], bounds, cell_m).change
    return layers.encode(change, change > 0) if change.any() else None


def _single(universal: DrivenMap) -> MapFile:
    if not isinstance(universal, MapFile):
        raise ConfigError("What changed is told of one map; open that map alone.")
    return universal


def _images(
    universal: DrivenMap, session: str
) -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    return {
        frame.frame_id: (frame.images, frame.images_sha256) for frame in universal.frames(session)
    }


def _layer(name: str) -> str:
    if name not in LAYERS:
        raise ConfigError(f"There is no layer {quoted(name)}; there are {', '.join(LAYERS)}.")
    return name


def _session_names(universal: DrivenMap, numbers: str) -> list[str]:
    """The names of sessions that a request counts, as in `0.2.3`; none for an empty text."""
    infos = universal.sessions()
    found = []
    for number in _session_numbers(numbers):
        if number >= len(infos):
            raise ConfigError(f"The map has no session number {number}; load the page again.")
        found.append(infos[number].name)
    return found


def _session_name(universal: DrivenMap, number: str) -> str:
    names = _session_names(universal, number)
    if len(names) != 1:
        raise ConfigError(f"{quoted(number)} is no session; give the number of one.")
    return names[0]


def _session_numbers(text: str) -> list[int]:
    return [_whole(part, 0, 100_000) for part in text.split(".") if part]


def _whole(text: str, least: int, most: int) -> int:
    digits = text.removeprefix("-")
    if not (digits.isascii() and digits.isdigit() and len(digits) < 10):
        raise ConfigError(f"{quoted(text)} is no whole number.")
    value = int(text)
    if not least <= value <= most:
        raise ConfigError(f"{value} is outside {least}..{most}.")
    return value


def _metres(text: str) -> float:
    try:
        value = float(text[:40])
    except ValueError:
        value = math.nan
    if not abs(value) < 1e6:
        raise ConfigError(f"{quoted(text)} are no metres of the map.")
    return value


def _bounds(text: str) -> Bounds:
    values = [_metres(part) for part in text.split(",", 4)]
    if len(values) != 4:
        raise ConfigError("Bounds are west,south,east,north in metres.")
    return Bounds(*values)

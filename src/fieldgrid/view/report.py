"""A map as one HTML file that needs nothing else: to be sent, and looked at without installation.

It holds the page, the density as far down its pyramid as fits, the drives thinned, frames and
features; not the evidence of single cells.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import ConfigError, mentions, refuse_input, replacing
from fieldgrid.geometry import Bounds
from fieldgrid.view import drives, layers, page, pyramid
from fieldgrid.view.about import describe_map
from fieldgrid.view.features import read_features, route_table
from fieldgrid.view.maps import ShownMap, shown_maps

MAX_BYTES = 20_000_000
"""Of the whole file; what a mail takes."""

_ROWS = 40_000
"""Of all drives together: about 100 bytes each."""

_EVERYWHERE = Bounds(-1e6, -1e6, 1e6, 1e6)

_DATA = 'id="fieldgrid-data"'
"""The element with what the page shows; only a file that has it is replaced."""


class Report(NamedTuple):
    """What was written: its size, and the cells that the finest level of each map has."""

    size_bytes: int
    cells_m: tuple[float, ...]


def write_report(
    paths: Sequence[Path],
    out: Path,
    *,
    routes: Sequence[Path] = (),
) -> Report:
    """Write maps into one self-contained HTML file, with routes from files over them.

    Levels that would make it larger than 20 MB are left out, the finest first. Raises
    MapError for a path that is no map, ConfigError where not even the coarsest level fits and for a
    file that is no route or a name that does not end in .html, MapExistsError for an existing file
    that is no such page, or is read here.
    """
    if not paths:
        raise ConfigError("There is no map to show; name one.")
    if out.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"{out.name} ends in none of .html, .htm; choose one of them.")
    refuse_input(out, [*paths, *routes])
    for path in paths:
        if path.is_dir():
            raise ConfigError(
                f"{path} is a folder; a page to send is of maps. Name maps of the folder, or leave "
                "out --html to look at all of them."
            )
    maps = shown_maps(paths)
    title = ", ".join(shown.name for shown in maps)
    parts = [_without_tiles(shown, _ROWS // len(maps), routes) for shown in maps]
    data: dict[str, Any] = {
        "about": {"maps": [], "writable": False, "formats": []},
        "maps": parts,
    }
    taken = len(_document(data, title))
    for number, (shown, part) in enumerate(zip(maps, parts, strict=True)):
        about = describe_map(number, shown)
        _add_tiles(shown, about, part, (MAX_BYTES - taken) // len(maps) - len(json.dumps(about)))
        data["about"]["maps"].append(about)
    document = _document(data, title)
    if len(document) > MAX_BYTES:
        raise ConfigError(
            f"{out.name} would have {len(document) / 1e6:.1f} MB, more than {MAX_BYTES / 1e6:.1f}; "
            "give fewer maps."
        )
    with replacing(out, ours=partial(mentions, mark=_DATA.encode()), what="a page") as draft:
        draft.write_bytes(document)
    return Report(len(document), tuple(one["cell_m"] for one in data["about"]["maps"]))


def _without_tiles(shown: ShownMap, rows: int, routes: Sequence[Path]) -> dict[str, Any]:
    with pyramid.stored(shown.path) as connection:
        features = read_features(connection)
    with shown.open() as universal:
        features += [route_table(path, universal.datum) for path in routes]
        active = [(k, info.name) for k, info in enumerate(universal.sessions()) if info.active]
        return {
            "tiles": {},
            "scale": layers.scale_of(universal, "density")._asdict(),
            "tracks": {
                str(k): drives.track(universal, name, max(rows // len(active), 100))
                for k, name in active
            },
            "frames": drives.frames_within([drives.frame_table(universal)], _EVERYWHERE, None),
            "features": features,
        }


def _add_tiles(shown: ShownMap, about: dict[str, Any], part: dict[str, Any], room: int) -> None:
    """Put in the density from the finest level that fits, and say so in what is told of the map."""
    with pyramid.stored(shown.path) as connection:
        levels = pyramid.read_levels(connection)
        finest = pyramid.finest_within(connection, levels, room)
        part["tiles"] = {
            f"{level - finest}/{ty}/{tx}": base64.b64encode(picture).decode()
            for level, ty, tx, picture in pyramid.pictures(connection, levels, finest)
        }
    # Coarser cells are a lattice of their own, whose level 0 is the finest that is here.
    about["cell_m"] *= 2**finest
    about["levels"] -= finest
    about["layers"] = [layer for layer in about["layers"] if layer["name"] == "density"]


def _document(data: dict[str, Any], title: str) -> bytes:
    """The page with all that it loads inside; its policy lets it run nothing else."""
    script, style = page.read_file("viewer.js"), page.read_file("viewer.css")
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; "
        "img-src blob: data:"
    )
    # In JSON a `<` may be written so, and then ends no element.
    told = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    name = title.replace("&", "&amp;").replace("<", "&lt;")
    return b"".join(
        (
            b'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">'.encode(),
            b'<meta name="viewport" content="width=device-width, initial-scale=1">',
            b'<meta name="color-scheme" content="light dark">',
            f"<title>{name}</title>".encode(),
            b'<link rel="icon" href="data:,"><style>', style, b"</style></head><body>",
            b"<noscript>This page draws maps with JavaScript.</noscript>",
            f'<script type="application/json" {_DATA}>'.encode(), told.encode(), b"</script>",
            b"<script>", script, b"</script>\n<!--\n", page.read_file("licences.txt"),
            b"\n-->\n</body></html>\n",
        )
    )  # fmt: skip


def _hash(content: bytes) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content).digest()).decode()}'"

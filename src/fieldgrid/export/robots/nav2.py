"""A map as Nav2's map server loads it: a YAML file, a picture, and where on Earth it lies.

The server's rules are met by the old loader and the vectorised one alike, which differ in what
they do at a threshold itself: no grey that is written lies on one. `docs/exports.md` has them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fieldgrid.core import (
    ConfigError,
    Flag,
    Int64,
    MapExistsError,
    UInt8,
    mentions,
    quoted,
    replacing_folder,
    setting,
)
from fieldgrid.export.cells.tiles import Whole, cut
from fieldgrid.export.georeference import extent, georeference
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.export.robots.speed import SpeedOptions, filter_parameters, speed_mask
from fieldgrid.export.together import text_writer, write_together
from fieldgrid.maps import OCCUPIED, UNKNOWN_OCCUPANCY, Readable, Selection

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""The thresholds of the YAML file. With a free threshold of 0.25, which is common too, the grey
205 of unknown cells would be read as free."""

_FREE_GREY, _UNKNOWN_GREY, _OCCUPIED_GREY = 254, 205, 0
_RAW_UNKNOWN = 255
_ENDINGS = (".yaml", ".yml")
_SPEED_ENDINGS = (".speed.pgm", ".speed.yaml", ".speed.params.yaml")
_MOST_CHARACTERS = 10_000  # of the small files beside a map
_INDEX = "index.yaml"
_GEOREFERENCE = b"fieldgrid_georeference"

TILE_CELLS = 4096
"""Cells along a side of a tile of what is too large for one map."""

MODES: dict[str, tuple[str, ...]] = {
    "trinary": ("pgm", "png"),
    "scale": ("png",),  # unknown is what is transparent
    "raw": ("pgm", "png"),
}
"""The modes of the map server, and the pictures that can hold each; the first is the usual one."""


class Nav2Options(SpeedOptions):
    """How the map server is to read the picture, and where a vehicle is to be slow."""

    mode: Literal["trinary", "scale", "raw"] = setting(
        "trinary", "meaning of the grey values", flag=Flag("--mode", "trinary|scale|raw")
    )
    image: Literal["pgm", "png"] | None = setting(
        None,
        "image format",
        usual="pgm, of scale png",
        flag=Flag("--image", "pgm|png"),
    )

    def picture(self) -> str:
        """The kind of picture. ConfigError for one that cannot hold the mode."""
        kind = MODES[self.mode][0] if self.image is None else self.image
        if kind not in MODES[self.mode]:
            raise ConfigError(
                f"A Nav2 map in mode {self.mode} cannot be a picture of kind {quoted(kind)}; "
                f"give {' or '.join(MODES[self.mode])}."
            )
        return kind


def export_nav2(
    universal: Readable,
    path: Path,
    selection: Selection,
    options: Nav2Options,
    *,
    overwrite: bool,
) -> Exported:
    """Write a part of a map for Nav2's map server: `OUT.yaml`, its picture, `OUT.georef.json`, and
    the keep-outs as a mask for Nav2's keepout filter: `OUT.keepout.yaml` with its picture; where a
    speed of slow zones is given, those for the speed filter, too: `OUT.speed.yaml` with its picture
    and `OUT.speed.params.yaml`; where none is given, those of the map that is replaced go, unless
    they are not as this function writes them.

    The curve of the options makes an occupancy of the density. `trinary` keeps free and obstacle;
    doubt is read back as unknown. `scale` and `raw` keep each of 0..100 and unknown exactly. The
    picture's first row is the northernmost; x is east, y is north, in metres from the datum.
    Keep-outs are occupied in both: in the map for who loads no mask, in the mask for who plans on
    another map.

    A part of more than 25 million cells is too large for one map: it is cut into maps of up to
    4096 x 4096 cells in the folder `OUT.tiles`, of which `index.yaml` is the list.

    The files appear when all are complete, and take the places of others at once. Raises
    ConfigError for what cannot be asked, MapExistsError, MapWriteError.
    """
    if path.suffix.lower() not in _ENDINGS:
        raise ConfigError(f"{path.name} does not end in .yaml, as a Nav2 map's name does.")
    options.picture(), options.curve()
    whole = Whole(*selection.cells(universal))
    if whole.is_large and options.slow_percent is not None:
        raise ConfigError(
            f"{whole.window.width} x {whole.window.height} cells are too large for one Nav2 map, "
            "and a speed mask is of one; give smaller --bounds or a larger --cell."
        )
    if whole.is_large:
        return _export_tiles(universal, path, selection, options, whole, overwrite=overwrite)
    part = _Part(universal, path, selection, options)
    speed = [path.with_suffix(ending) for ending in _SPEED_ENDINGS]
    old = [file for file in speed if file.exists()] if options.slow_percent is None else []
    paths = write_together(
        part.writers(),
        overwrite=overwrite,
        ours=lambda file: mentions(file.with_suffix(".georef.json"), _GEOREFERENCE),
        what="a Nav2 map",
        gone=old if _is_speed_of(path) else (),
    )
    rows = (
        ("mode", options.mode),
        ("cells", f"{whole.window.width} x {whole.window.height} of {whole.lattice.cell_m:g} m"),
        *_rows(part.counts),
    )
    if gone := [file.name for file in old if not file.exists()]:
        rows += (("removed with the old map", ", ".join(gone)),)
    if left := [file.name for file in old if file.exists()]:
        rows += (("left: not of the old map, or changed", ", ".join(left)),)
    about = {"mode": options.mode, **_counted(part.counts)}
    about |= extent(whole.lattice, whole.window, universal.datum)
    return Exported((paths[-1], *paths[:-1]), rows, about)


def _export_tiles(
    universal: Readable,
    path: Path,
    selection: Selection,
    options: Nav2Options,
    whole: Whole,
    *,
    overwrite: bool,
) -> Exported:
    folder = path.with_suffix(".tiles")
    size = f"{whole.window.width} x {whole.window.height} of {whole.lattice.cell_m:g} m"
    if path.exists():
        raise MapExistsError(
            f"{path} exists, and {size} cells are too large for one Nav2 map: tiles of it would be "
            f"in {folder.name} beside that; remove it, or give another name or a larger --cell."
        )
    counts, tiles = np.zeros(5, np.int64), []
    with replacing_folder(
        folder,
        overwrite=overwrite,
        ours=lambda found: mentions(found / _INDEX, _GEOREFERENCE),
        what="tiles of a Nav2 map",
    ) as draft:
        for tile in cut(universal, selection, whole, TILE_CELLS):
            part = _Part(universal, draft / f"{tile.name}.yaml", tile.selection, options)
            for file, write in part.writers().items():
                write(file)
            counts += part.counts
            names = {"yaml": f"{tile.name}.yaml", "keepout": f"{tile.name}.keepout.yaml"}
            tiles.append({**names, **tile.about(whole.lattice)})
        about = georeference(whole.lattice, whole.window, universal.datum)
        (draft / _INDEX).write_text(
            _dumped({**about, "mode": options.mode, "layer": selection.layer, "tiles": tiles}),
            encoding="utf-8",
        )
    rows = (
        ("too large for one map", f"{size}: {len(tiles)} tiles of up to {TILE_CELLS} a side"),
        ("index of the tiles", f"{folder.name}/{_INDEX}"),
        ("mode", options.mode),
        *_rows(counts),
    )
    about = {"mode": options.mode, "tiles": len(tiles), **_counted(counts)}
    about |= extent(whole.lattice, whole.window, universal.datum)
    return Exported((folder,), rows, about)


class _Part:
    """The files of one Nav2 map."""

    def __init__(
        self, universal: Readable, path: Path, selection: Selection, options: Nav2Options
    ) -> None:
        self._path, self._layer, self._options = path, selection.layer, options
        counted = ("count",) if options.slow_percent and options.slow_seen_by else ()
        view = selection.view(universal, counted, decide=selection.layer)
        decision = view.decision(options.curve().least_drop_m)
        self._lattice, self._window, self._datum = view.lattice, view.window, view.datum
        self._occupancy = options.curve().occupancy(*decision)
        self._keepout = np.zeros(view.window.shape, np.int8)
        if decision.keepout is not None:
            self._keepout[decision.keepout] = OCCUPIED
        self._slow: npt.NDArray[np.int8] | None = None
        if options.slow_percent is not None:
            self._slow = speed_mask(view, self._occupancy, self._keepout, options)

    @property
    def counts(self) -> Int64:
        """How many cells are free, in doubt, obstacles, unknown and kept out of."""
        free, occupied, unknown = (
            int(np.count_nonzero(self._occupancy == value))
            for value in (0, OCCUPIED, UNKNOWN_OCCUPANCY)
        )
        doubt = self._occupancy.size - free - occupied - unknown
        return np.array([free, doubt, occupied, unknown, np.count_nonzero(self._keepout)])

    def writers(self) -> dict[Path, Callable[[Path], object]]:
        """What writes each file, the YAML file last."""
        path, mode, kind = self._path, self._options.mode, self._options.picture()
        curve = self._options.curve()
        mask, mask_picture = path.with_suffix(".keepout.yaml"), path.with_suffix(".keepout.pgm")
        picture, georef = path.with_suffix(f".{kind}"), path.with_suffix(".georef.json")
        about = {
            **georeference(self._lattice, self._window, self._datum),
            "image": picture.name,
            "mode": mode,
            "layer": self._layer,
            "cost_curve": {
                "free_up_to": curve.free_up_to,
                "obstacle_above": curve.obstacle_above,
                "shape": curve.shape,
                "least_seen": curve.least_seen,
                # JSON has no infinity.
                "least_drop_m": curve.least_drop_m if math.isfinite(curve.least_drop_m) else None,
            },
        }
        found: dict[Path, Callable[[Path], object]] = {}
        if self._slow is not None:
            slow, slow_mask, parameters = (path.with_suffix(ending) for ending in _SPEED_ENDINGS)
            found = {
                slow: _picture_writer(self._slow, "raw", "pgm"),
                slow_mask: text_writer(self._yaml(slow.name, "raw")),
                parameters: text_writer(_dumped(filter_parameters(slow_mask.name))),
            }
        return {
            **found,
            picture: _picture_writer(self._occupancy, mode, kind),
            mask_picture: _picture_writer(self._keepout, "trinary", "pgm"),
            mask: text_writer(self._yaml(mask_picture.name, "trinary")),
            georef: text_writer(json.dumps(about, indent=2, ensure_ascii=False) + "\n"),
            path: text_writer(self._yaml(picture.name, mode)),
        }

    def _yaml(self, picture: str, mode: str) -> str:
        bounds = self._lattice.bounds(self._window)
        return _dumped(
            _server_yaml(
                picture, mode, float(self._lattice.cell_m), (bounds.west_m, bounds.south_m)
            )
        )


def _server_yaml(
    picture: str, mode: str, cell_m: float, corner: tuple[float, float]
) -> dict[str, Any]:
    """The YAML file of a picture, by the lower left corner of its lower left pixel."""
    return {
        "image": picture,
        "mode": mode,
        "resolution": cell_m,
        "origin": [corner[0] + 0.0, corner[1] + 0.0, 0.0],  # -0.0 looks odd
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
    }


def _is_speed_of(path: Path) -> bool:
    """Whether the files of a speed mask beside a map are what :func:`export_nav2` has written."""
    picture, mask, parameters = (path.with_suffix(ending) for ending in _SPEED_ENDINGS)
    if mask.with_suffix(".georef.json").exists():  # a map of that name, without a mask's purpose
        return False
    if _text(parameters) != _dumped(filter_parameters(mask.name)):
        return False
    form = _dumped(_server_yaml(picture.name, "raw", 0.0, (0.0, 0.0)))
    # Between these are the side of the cells and the corner of the picture.
    begin, end = form[: form.index("resolution")], form[form.index("negate") :]
    found = _text(mask)
    return not mask.exists() or (found.startswith(begin) and found.endswith(end))


def _text(path: Path) -> str:
    """What a small file says; nothing of one that cannot be read."""
    with suppress(OSError, ValueError), path.open(encoding="utf-8") as file:
        return file.read(_MOST_CHARACTERS)
    return ""


def greys(mode: str) -> UInt8:
    """The grey of each occupancy, uint8 [102]: 0..100, and unknown in the last place (-1)."""
    occupancy = np.arange(OCCUPIED + 1)
    if mode == "raw":
        return np.append(occupancy, _RAW_UNKNOWN).astype(np.uint8)
    doubt = np.full(OCCUPIED + 1, float(_UNKNOWN_GREY))
    if mode == "scale":
        # A step of occupancy is 1.16 greys, so each has one whose rounding leads back to it.
        share = FREE_THRESH + (OCCUPIED_THRESH - FREE_THRESH) * occupancy / OCCUPIED
        doubt = np.rint(255.0 * (1.0 - share))
    doubt[0], doubt[OCCUPIED] = _FREE_GREY, _OCCUPIED_GREY
    return np.append(doubt, _UNKNOWN_GREY).astype(np.uint8)


def _picture_writer(
    occupancy: npt.NDArray[np.int8], mode: str, kind: str
) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        from PIL import Image

        assert UNKNOWN_OCCUPANCY == -1  # which is how the last grey is found
        grey = greys(mode)[occupancy[::-1]]
        if mode == "scale":
            opaque = (occupancy[::-1] != UNKNOWN_OCCUPANCY).astype(np.uint8) * np.uint8(255)
            grey = np.stack([grey, opaque], axis=-1)
        Image.fromarray(grey).save(file, format={"pgm": "PPM", "png": "PNG"}[kind])

    return write


def _dumped(content: dict[str, Any]) -> str:
    import yaml

    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000))


def _rows(counts: Int64) -> tuple[tuple[str, str], ...]:
    *known, keepout = counts.tolist()
    return (
        ("free, in doubt, obstacle, unknown", ", ".join(map(str, known))),
        ("kept out of", str(keepout)),
    )


def _counted(counts: Int64) -> dict[str, Any]:
    """Cells of each kind, and those to be kept out of."""
    kinds = ("free", "in_doubt", "obstacle", "unknown", "kept_out_of")
    return dict(zip(kinds, counts.tolist(), strict=True))


register_export_format(
    ExportFormat(
        "nav2",
        _ENDINGS,
        "Nav2 map, keep-out mask: YAML, pictures",
        export_nav2,
        Nav2Options,
        Holds.OCCUPANCY,
        several=True,
        readers="Nav2's map server",
        limits="2.5·10^7 cells a map, else tiles",
    )
)

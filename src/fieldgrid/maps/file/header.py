"""What never changes in a map: its datum, its base cells and its transfer rule."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import (
    ConfigError,
    DatumError,
    FieldgridError,
    MapError,
    parse_json,
    quoted,
    shortened,
)
from fieldgrid.geometry import TILE_CELLS, Datum, Lattice
from fieldgrid.maps.file import schema
from fieldgrid.maps.layers.declaration import ChannelGroup
from fieldgrid.maps.layers.registry import ALL_LAYERS, GROUPS, kept_groups
from fieldgrid.maps.transfer import CELL_WEIGHT, Transfer

OLDEST_VERSION = schema.OTHER_TABLES_VERSION
"""Of the formats that are read."""

_SAME_ANGLE_DEG = 1e-9
_SAME_HEIGHT_M = 1e-3


class MapHeader(NamedTuple):
    """The settings that a map was made with, and the channel groups that its tiles hold."""

    datum: Datum
    lattice: Lattice
    transfer: Transfer
    groups: tuple[str, ...]
    version: int = schema.FORMAT_VERSION

    @property
    def is_old(self) -> bool:
        """Whether the next change brings the map to the present format."""
        return self.version < schema.FORMAT_VERSION

    @property
    def has_other_tables(self) -> bool:
        """Whether the tables of evidence are not those of today."""
        return self.version == schema.OTHER_TABLES_VERSION

    def known_groups(self) -> tuple[ChannelGroup, ...]:
        """The channel groups of the map's tiles that this program knows."""
        known = (GROUPS[name] for name in self.groups if name in GROUPS)
        return tuple(group for group in known if not group.derived)

    def writable_groups(self, path: Path) -> tuple[ChannelGroup, ...]:
        """The channel groups of the map's tiles, all of which a change must bring up to date;
        ConfigError when this program does not know one."""
        unknown = [name for name in self.groups if name not in GROUPS]
        if unknown:
            raise ConfigError(
                f"{path} holds the channel group {quoted(unknown[0])}, which no imported module "
                "knows; import the module that registers it, install the package that has it, or "
                "drop it with `fieldgrid repair`."
            )
        return self.known_groups()

    def keeping(self, layers: Collection[str] | None) -> MapHeader:
        """The settings of a map of the present format whose tiles hold the core and some layers;
        None for those that they hold, as far as they are known here."""
        groups = kept_groups(layers or ())
        if layers is None:
            held = {*groups, *self.groups}
            groups = tuple(name for name in kept_groups([ALL_LAYERS]) if name in held)
        return self._replace(groups=groups, version=schema.FORMAT_VERSION)

    def lattice_of(self, cell_m: float | None) -> Lattice:
        """The lattice for a cell size; the map's own when none is given, or up to rounding."""
        own = self.lattice
        if cell_m is None or math.isclose(cell_m, own.cell_m, rel_tol=1e-9):
            return own
        return Lattice(cell_m)

    def is_datum(self, datum: Datum) -> bool:
        """Whether a datum is that of the map, up to rounding."""
        own = self.datum
        return (
            abs(datum.lat_deg - own.lat_deg) <= _SAME_ANGLE_DEG
            and abs(datum.lon_deg - own.lon_deg) <= _SAME_ANGLE_DEG
            and abs(datum.height_m - own.height_m) <= _SAME_HEIGHT_M
        )

    def check_datum(self, path: Path, datum: Datum) -> None:
        """Raise DatumError unless `datum` is that of the map."""
        if not self.is_datum(datum):
            raise DatumError(
                f"The datum of {path} is {self.datum.described()} for good, not "
                f"{datum.described()}; build with the map's own, with --append or --datum-from "
                f"{path}, or make another map."
            )

    def check_settings(
        self,
        path: Path,
        cell_m: float | None,
        transfer: Transfer | None,
        layers: Collection[str],
    ) -> None:
        """Raise ConfigError when a cell size, a rule or a layer is given that is not the map's."""
        if layers and not set(kept_groups(layers)) <= set(self.groups):
            raise ConfigError(
                f"The tiles of {path} do not hold {', '.join(layers)}; leave the layers out to add "
                "to it (they can be read all the same), or add them with `fieldgrid repair "
                "--layers`."
            )
        if self.lattice_of(cell_m) != self.lattice:
            raise ConfigError(
                f"{path} has cells of {self.lattice.cell_m} m, not {cell_m} m; leave the cell "
                "size out to add to it (it can be read with another), or make another map."
            )
        if transfer not in (None, self.transfer):
            raise ConfigError(
                f"{path} is made with the {self.transfer} rule, not {transfer}; leave the rule "
                "out to add to it (it can be read with another), or make another map."
            )


def read_header(connection: sqlite3.Connection, path: Path) -> MapHeader:
    """The settings of a map; MapError when the file is none, is damaged or is too new."""
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    tables = {
        row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")
    }
    if application_id != schema.APPLICATION_ID or "fieldgrid_meta" not in tables:
        kind = "a GeoPackage of something else" if "gpkg_contents" in tables else "another database"
        raise MapError(f"{path} is not a fieldgrid map but {kind}. Check the name.")
    pages, page_bytes, mode = (
        connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("page_count", "page_size", "journal_mode")
    )
    # With a write-ahead log the last pages may be in the log, and SQLite looks after them.
    if mode != "wal" and (found := path.stat().st_size) < pages * page_bytes:
        raise cut_short(path, found, pages * page_bytes)
    header = read_settings(connection, path)
    expected = {*schema.OWN_TABLES, *schema.LAYERS}
    if header.has_other_tables:
        expected -= {"fieldgrid_grid"}
    missing = sorted(expected - tables)
    if missing:
        raise MapError(f"{path} is damaged: it has no table {missing[0]}. Restore a copy.")
    return header


def read_settings(connection: sqlite3.Connection, path: Path) -> MapHeader:
    """The settings of a file that is a map, as they are now: another program may have brought it up
    to date."""
    meta = dict(connection.execute("SELECT key, value FROM fieldgrid_meta").fetchall())
    try:
        version = int(meta["format_version"])
        if version > schema.FORMAT_VERSION:
            raise MapError(
                f"{path} has format version {version}, and this fieldgrid reads up to "
                f"{schema.FORMAT_VERSION}; update fieldgrid to open it."
            )
        if version < OLDEST_VERSION:
            raise MapError(
                f"{path} has format version {version}, of before the first release; build it again "
                "from its recordings."
            )
        groups = tuple(str(name) for name in parse_json(meta.get("channel_groups", "[]")))
        for key, value in (("tile_cells", TILE_CELLS), ("cell_weight", CELL_WEIGHT)):
            if meta[key] != str(value):
                raise ValueError(f"{key} is {quoted(meta[key])}, not {value}")
        if version > schema.OTHER_TABLES_VERSION and "density" not in groups:
            raise ValueError(f"its tiles hold {', '.join(groups) or 'nothing'}, and no density")
        return MapHeader(
            Datum(*(float(meta[f"datum_{key}"]) for key in ("lat_deg", "lon_deg", "height_m"))),
            Lattice(float(meta["cell_m"])),
            Transfer(meta["transfer"]),
            groups,
            version,
        )
    except MapError:
        raise
    except (KeyError, TypeError, ValueError, FieldgridError) as error:
        raise MapError(
            f"{path} is damaged: its settings cannot be read ({shortened(error)}). Restore a copy."
        ) from error


def check_plane(connection: sqlite3.Connection, path: Path, datum: Datum) -> None:
    """Raise MapError when the plane that a GIS is told of is not that of the map's datum."""
    *_, own = schema.reference_systems(datum)
    found = connection.execute(
        "SELECT srs_name, srs_id, organization, organization_coordsys_id, definition, description "
        "FROM gpkg_spatial_ref_sys WHERE srs_id = ?",
        (schema.SRS_ID,),
    ).fetchone()
    if found == own:
        return
    # Another version of PROJ may have put the same definition in other words.
    same_words = found is not None and (*found[:4], found[5]) == (*own[:4], own[5])
    if not (same_words and datum.is_crs_wkt(str(found[4]))):
        name = "none" if found is None else found[0]
        raise MapError(
            f"The datum of {path} is {datum.described()}, which is not that of its plane in "
            f"gpkg_spatial_ref_sys ({name}): one of them has been changed. Restore a copy."
        )


def cut_short(path: Path, found: int, whole: int) -> MapError:
    """The error for a file that has fewer bytes than it says."""
    return MapError(
        f"{path} has {found} of {whole} bytes: it was not copied to the end, or without its "
        f"journal; copy it again, with {path.name}-journal where there is one."
    )

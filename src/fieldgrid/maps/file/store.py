"""Opening a map file: to read it, to add to it, or to make a new one."""

from __future__ import annotations

import os
from collections.abc import Collection
from functools import partial
from pathlib import Path

from fieldgrid.core import Draft, MapError, mentions
from fieldgrid.geometry import Datum, Lattice
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.database import (
    USUAL_PATIENCE,
    Patience,
    check_beside,
    connect,
    explained,
    keep_one_file,
    reading,
    whole_bytes,
    writing,
)
from fieldgrid.maps.file.header import MapHeader, cut_short, read_header
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.root import seal
from fieldgrid.maps.file.upgrade import read_as_is
from fieldgrid.maps.health.row_sums import begin_sums
from fieldgrid.maps.layers.registry import kept_groups
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.transfer import Transfer
from fieldgrid.maps.vector.styles import refresh_styles

DEFAULT_CELL_M = 0.05


def open_map(
    path: str | Path,
    *,
    datum: Datum | None = None,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
    layers: Collection[str] = (),
    writable: bool = False,
    patience: Patience = USUAL_PATIENCE,
) -> MapFile:
    """Open a map: to read it, or with `datum` or `writable` to change it.

    `writable` is for a map that exists, whatever its datum. With `datum` a map that does not
    exist is made, with cells of `cell_m` (0.05 m when not given), the `transfer` rule (centre
    when not given) and `layers` as `create_map` takes them. A map that exists keeps its own:
    another datum raises DatumError, another cell size, rule or layer ConfigError. A file that is
    absent, foreign, damaged or of a newer format raises MapError. One of an older format is read as
    it is, and upgraded by the first change. `patience` is how long a change waits for another
    writer, and a reader for its commit.
    """
    path = Path(path)
    if datum is not None and not path.exists():
        return create_map(path, datum, cell_m=cell_m, transfer=transfer, layers=layers)
    if not path.is_file():
        if path.exists():
            raise MapError(f"{path} is a folder, a pipe or a device; give the file of a map.")
        if path.is_symlink():
            raise MapError(
                f"{path} leads to {os.readlink(path)}, which is not there; connect the drive or "
                "network folder that it is on, or correct the link."
            )
        raise MapError(f"There is no map {path}; check the name, or build it first.")
    writable = writable or datum is not None
    if path.stat().st_size == 0:
        raise MapError(
            f"{path} is not a fieldgrid map: it is empty, as a copy that never began or a full "
            "disk leaves it; copy it again."
        )
    try:
        connection = connect(path, path, writable=writable, patience=patience)
    except MapError as error:
        found, whole = path.stat().st_size, whole_bytes(path)
        if found < whole:
            raise cut_short(path, found, whole) from error
        raise
    try:
        with reading(connection, path):
            header = read_header(connection, path)
        if header.has_other_tables:
            read_as_is(connection)
        if datum is not None:
            header.check_datum(path, datum)
        header.check_settings(path, cell_m, transfer, layers)
        if writable:
            with explained(path, writing=True):
                keep_one_file(connection, durable=True)
    except BaseException:
        connection.close()
        raise
    return MapFile(path, connection, header, writable=writable, patience=patience)


def create_map(
    path: str | Path,
    datum: Datum,
    *,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
    layers: Collection[str] = (),
    overwrite: bool = False,
) -> MapFile:
    """Make a new map, which appears at `path` when its block ends with a session in it.

    Until then it is a file of another name beside `path`, and a map that is to be overwritten
    is untouched. Its tiles hold the core, and `layers`: names of layers or of their subjects
    (`frames`, `terrain`, `standing`, `time`), or `all`. Raises MapExistsError when `path` exists
    and may not be overwritten, ConfigError for a layer that is not there.
    """
    path = Path(path)
    check_beside(path)
    lattice = Lattice(DEFAULT_CELL_M if cell_m is None else cell_m)
    header = MapHeader(datum, lattice, transfer or Transfer.CENTRE, kept_groups(layers))
    draft = Draft(
        path,
        overwrite=overwrite,
        advice="--append to add a session to it, ",
        ours=partial(mentions, mark=b"fieldgrid_session"),  # the name of a table
        what="a map",
    )
    try:
        connection = connect(draft.file, path, writable=True)
    except BaseException:
        draft.discard()
        raise
    universal = MapFile(path, connection, header, writable=True, draft=draft)
    try:
        with explained(path, writing=True):
            keep_one_file(connection, durable=False)  # it is synced once, before it is published
        with writing(connection, path):
            schema.create(connection, datum, TileMatrixSet(lattice), header.transfer, header.groups)
            refresh_styles(connection)
            seal(connection)
            begin_sums(connection)
    except BaseException:
        universal.discard()
        raise
    return universal


def read_datum(path: str | Path) -> Datum:
    """The datum of an existing map, for what is to be added to it."""
    with open_map(path) as universal:
        return universal.datum

"""A route from a file."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import (
    ConfigError,
    Float64,
    LimitError,
    bounded_lines,
    check_document,
    counted_rows,
    file_bytes,
    parse_json,
)
from fieldgrid.geometry import Datum


def read_route(path: str | Path, datum: Datum) -> Float64:
    """The lines of a GeoJSON file (RFC 7946: longitude, latitude), or the poses of a table with
    the columns east_m and north_m (`.csv`): [n, 2] metres east and north.

    Several lines follow each other, apart by a row of NaN. Raises ConfigError for a file that
    cannot be read, and one that has no line.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return read_poses(path, "east_m", "north_m")
    with _reading(path, "GeoJSON with lines in it") as size:
        check_document(size, path, ConfigError)
        places = [_places(line) for line in _lines(parse_json(path.read_bytes()))]
    if not places:
        raise ConfigError(f"{path} has no line; give GeoJSON with a LineString.")
    parts = []
    for lon_lat in places:
        east, north, _ = datum.to_enu(lon_lat[:, 1], lon_lat[:, 0], datum.height_m)
        parts += [np.stack([east, north], axis=1), np.full((1, 2), np.nan)]
    return np.concatenate(parts[:-1])


def _places(line: Any) -> Float64:
    """Longitude and latitude [n, 2] of the positions of a line, which may have a height."""
    if not line or any(len(point) < 2 for point in line):
        raise ValueError("a position has no two numbers")
    return np.fromiter(
        (value for point in line for value in point[:2]), np.float64, 2 * len(line)
    ).reshape(-1, 2)


def read_poses(path: Path, *columns: str) -> Float64:
    """Columns of numbers of a table of poses [n, columns], the first two east and north in metres.

    Raises ConfigError for a file that cannot be read as one.
    """
    with (
        _reading(path, "table of poses, as `fieldgrid route -o route.csv` writes it"),
        path.open(encoding="utf-8-sig", newline="") as file,
    ):
        table = csv.DictReader(bounded_lines(file, path))
        if not set(columns) <= set(table.fieldnames or ()):
            raise ValueError(f"it has no columns {' and '.join(columns)}")
        poses = np.array(
            [[float(row[name]) for name in columns] for row in counted_rows(table, path)]
        )
        if len(poses) < 2 or not np.isfinite(poses[:, :2]).all():
            raise ValueError("it has not two poses in metres")
    return poses


@contextmanager
def _reading(path: Path, what: str) -> Iterator[int]:
    """The size of a file. An error of reading it becomes one that says that it is not `what`."""
    try:
        yield file_bytes(path)
    except (ConfigError, LimitError):
        raise
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; check the name.") from error
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        csv.Error,
    ) as error:
        raise ConfigError(f"{path} is no {what} ({error}).") from error


def _lines(thing: Any) -> Iterator[Any]:
    """The coordinates of every LineString in a GeoJSON object."""
    kind = thing["type"]
    if kind == "FeatureCollection":
        for feature in thing["features"]:
            yield from _lines(feature)
    elif kind == "Feature":
        if thing["geometry"] is not None:
            yield from _lines(thing["geometry"])
    elif kind == "GeometryCollection":
        for geometry in thing["geometries"]:
            yield from _lines(geometry)
    elif kind == "LineString":
        yield thing["coordinates"]
    elif kind == "MultiLineString":
        yield from thing["coordinates"]

"""A map as a table of its observed cells: CSV and Parquet.

A row a cell, piece by piece of the map: `east_m`, `north_m` of its centre in the map's plane,
`lat_deg`, `lon_deg` of that point, the layer that was asked for, and `n`, how many frames observed
the cell. Cells that nothing is known of have no row. What the columns mean, and the datum, stand
beside a CSV as CSV on the Web says, and inside a Parquet file as metadata of its schema.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, ConfigError, Float64, Settings, mentions, replacing
from fieldgrid.export.registry import Exported, ExportFormat, register_export_format, require
from fieldgrid.export.together import text_writer, write_together
from fieldgrid.geometry import Datum
from fieldgrid.maps import LAYERS, MapFile, Selection

_ROWS = 1 << 16
"""Rows that are formatted at a time: 64 k of text are some MB."""

_PLACES = {"east_m": 4, "north_m": 4, "lat_deg": 9, "lon_deg": 9}
"""Decimals of a CSV: 0.1 mm."""


def export_csv(
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write the observed cells as CSV, and their metadata as `PATH-metadata.json` (CSVW)."""
    beside = path.with_name(path.name + "-metadata.json")
    rows = 0

    def write_cells(file: Path) -> None:
        nonlocal rows
        with file.open("w", encoding="ascii", newline="") as out:
            for table in _tables(universal, selection):
                if rows == 0:
                    out.write(",".join(table) + "\r\n")
                for start in range(0, len(table["n"]), _ROWS):
                    part = slice(start, start + _ROWS)
                    cells = [_text(name, values[part]) for name, values in table.items()]
                    out.write("\r\n".join(map(",".join, zip(*cells, strict=True))) + "\r\n")
                rows += len(table["n"])
        _refuse_empty(rows, path)

    write_together(
        {
            beside: text_writer(json.dumps(_csvw(path, universal, selection), indent=1) + "\n"),
            path: write_cells,
        },
        overwrite=overwrite,
        ours=lambda file: mentions(beside, b"http://www.w3.org/ns/csvw"),
        what="a CSV",
    )
    return Exported((path, beside), (("cells", str(rows)),), {"cells": rows})


def export_parquet(
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write the observed cells as GeoParquet 1.1: points in the map's plane, with their bounds.

    Raises ConfigError when pyarrow is not installed.
    """
    require("Writing Parquet", "tables", "pyarrow")
    import pyarrow
    import pyarrow.parquet

    rows = 0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    with (
        replacing(
            path,
            overwrite=overwrite,
            ours=lambda file: mentions(file, b"fieldgrid"),
            what="a Parquet table",
        ) as file,
        ExitStack() as open_things,
    ):
        writer: Any = None
        for table in _tables(universal, selection):
            places = np.column_stack([table["east_m"], table["north_m"]])
            if len(places):
                low = np.minimum(low, places.min(axis=0))
                high = np.maximum(high, places.max(axis=0))
            batch = pyarrow.table({**table, **_geometry(places)})
            if writer is None:
                schema = batch.schema.with_metadata(
                    {"fieldgrid": json.dumps(_about(universal, selection))}
                )
                writer = open_things.enter_context(
                    pyarrow.parquet.ParquetWriter(file, schema, compression="zstd")
                )
            writer.write_table(batch.cast(writer.schema))
            rows += len(batch)
        _refuse_empty(rows, path)
        writer.add_key_value_metadata(
            {"geo": json.dumps(_geoparquet(universal.datum, [*low.tolist(), *high.tolist()]))}
        )
    return Exported((path,), (("cells", str(rows)),), {"cells": rows})


def _geometry(places: Float64) -> dict[str, Any]:
    """Points east and north [n, 2] as WKB, and the bounds of each, by which readers filter."""
    import pyarrow

    wkb = np.empty(len(places), dtype=[("order", "u1"), ("type", "<u4"), ("place", "<f8", 2)])
    wkb["order"], wkb["type"], wkb["place"] = 1, 1, places
    offsets = np.arange(len(places) + 1, dtype=np.int32) * wkb.itemsize
    buffers = [None, pyarrow.py_buffer(offsets), pyarrow.py_buffer(wkb.tobytes())]
    east, north = (pyarrow.array(column) for column in places.T)
    bounds = {"xmin": east, "ymin": north, "xmax": east, "ymax": north}
    return {
        "geometry": pyarrow.Array.from_buffers(pyarrow.binary(), len(places), buffers),
        "bbox": pyarrow.StructArray.from_arrays(list(bounds.values()), list(bounds)),
    }


def _geoparquet(datum: Datum, bounds: list[float]) -> dict[str, Any]:
    """The metadata of a file by GeoParquet 1.1."""
    return {
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": {
            "geometry": {
                "encoding": "WKB",
                "geometry_types": ["Point"],
                "crs": datum.crs_json(),
                "edges": "planar",
                "bbox": bounds,
                "covering": {
                    "bbox": {side: ["bbox", side] for side in ("xmin", "ymin", "xmax", "ymax")}
                },
            }
        },
    }


def _refuse_empty(rows: int, path: Path) -> None:
    if rows == 0:
        raise ConfigError(
            f"No cell was observed in what {path.name} would hold; give other bounds or another "
            "--at."
        )


def _tables(universal: MapFile, selection: Selection) -> Iterator[dict[str, AnyArray]]:
    """The observed cells of each block, a column each."""
    with selection.blocks(universal, ("count",)) as blocks:
        for view in blocks.views:
            j, i = np.nonzero(view.observed)
            east_m, north_m = view.lattice.centres(view.window)
            east_m, north_m = east_m[i], north_m[j]
            lat_deg, lon_deg, _ = view.datum.to_geodetic(east_m, north_m, np.zeros(len(i)))
            columns = {"east_m": east_m, "north_m": north_m, "lat_deg": lat_deg, "lon_deg": lon_deg}
            if selection.layer != "count":
                columns[selection.layer] = view.layer(selection.layer)[j, i]
            yield {**columns, "n": view.layer("count")[j, i]}


def _text(name: str, values: AnyArray) -> list[str]:
    if name in _PLACES:
        return list(map(f"%.{_PLACES[name]}f".__mod__, values.tolist()))
    if values.dtype.kind == "f":
        return [f"{value:.7g}" for value in values.tolist()]
    return list(map(str, values.tolist()))


def _about(universal: MapFile, selection: Selection) -> dict[str, Any]:
    """What a table needs to be understood by itself."""
    return {
        "datum": datum_values(universal.datum),
        "crs_wkt": universal.datum.crs_wkt("WKT2_2019"),
        "cell_m": selection.cell_m or universal.cell_m,
        "layer": selection.layer,
        "at": selection.at,
        "columns": {name: says for name, _, says in _columns(selection.layer)},
    }


def datum_values(datum: Datum) -> dict[str, float]:
    """The datum as plain numbers: WGS84, degrees and metres above the ellipsoid."""
    return {"lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg, "height_m": datum.height_m}


def _columns(layer: str) -> list[tuple[str, str, str]]:
    """Name, type in XML Schema's words, and meaning of each column."""
    found = [
        ("east_m", "double", "centre of the cell, metres east of the datum"),
        ("north_m", "double", "centre of the cell, metres north of the datum"),
        ("lat_deg", "double", "WGS84 latitude of the centre, in the datum's plane"),
        ("lon_deg", "double", "WGS84 longitude of the centre, in the datum's plane"),
    ]
    if layer != "count":
        kind = "float" if LAYERS[layer].dtype.startswith("f") else "integer"
        found.append((layer, kind, LAYERS[layer].meaning))
    return [*found, ("n", "integer", LAYERS["count"].meaning)]


def _csvw(path: Path, universal: MapFile, selection: Selection) -> dict[str, Any]:
    """Metadata by the W3C's Model for Tabular Data, which a CSV itself has no room for."""
    columns = [
        {"name": name, "titles": name, "datatype": kind, "dc:description": says}
        for name, kind, says in _columns(selection.layer)
    ]
    return {
        "@context": "http://www.w3.org/ns/csvw",
        "url": path.name,
        "tableSchema": {"columns": columns},
        "notes": [
            {key: value for key, value in _about(universal, selection).items() if key != "columns"}
        ],
    }


register_export_format(
    ExportFormat(
        "csv",
        (".csv",),
        "a row for each observed cell",
        export_csv,
        readers="spreadsheets, R",
    ),
    ExportFormat(
        "parquet",
        (".parquet",),
        "the same as GeoParquet, points",
        export_parquet,
        readers="pandas, geopandas, DuckDB",
        extras=("tables",),
    ),
)

"""Obstacles as points: LAS and LAZ by laspy, and PLY.

A point stands in the middle of each obstacle cell, on the ground there: at the height of the ground
where the drives tell it, else at that of the vehicle when it saw the cell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from fieldgrid.core import AnyArray, mentions, replacing
from fieldgrid.export.georeference import extent
from fieldgrid.export.options import ObstacleOptions
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format, require
from fieldgrid.maps import MapFile, Selection

_HEIGHTS = ("ground", "height", "max_height", "count")
_SCALE_M = 0.001
_SOFTWARE = "fieldgrid obstacles"
_IS_OURS = partial(mentions, mark=_SOFTWARE.encode())
_COUNT_DIGITS = 20
_EARTH_2R_M = 12.75e6
"""Twice the Earth's radius: how far the plane that touches the datum is above the ellipsoid."""


_POINT = np.dtype(
    [
        *(("x", "<f8"), ("y", "<f8"), ("z", "<f8")),
        *(("density", "u1"), ("frames", "<u4"), ("ground_known", "u1"), ("height_m", "<f4")),
    ]
)
"""An obstacle cell: its centre and height in metres from the datum in its plane; what was seen of
it; whether the ground there was seen, or is taken from the vehicle's height; and how high it stands
above the ground, NaN where that is not known."""


def export_las(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: ObstacleOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write the obstacles as LAS 1.4, of a path that ends in .laz packed as LAZ.

    x and y are in the map's plane, whose system stands in the file; z is metres above the WGS84
    ellipsoid. The intensity is the density, and so is the dimension `density`; `frames` saw the
    cell, `height_m` is how high the obstacle stands, or NaN, and `ground_known` is 1 where z is
    the ground and 0 where it is the vehicle's height.
    Raises ConfigError when laspy is not installed; other errors as in `export_ply`.
    """
    require(f"Writing {path.name}", "clouds", "laspy")
    import laspy
    from laspy.vlrs.known import WktCoordinateSystemVlr

    datum = universal.datum
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.generating_software = _SOFTWARE
    header.scales = np.full(3, _SCALE_M)
    header.offsets = np.array([0.0, 0.0, np.floor(datum.height_m)])
    header.vlrs.append(WktCoordinateSystemVlr(datum.crs_wkt("WKT1_GDAL")))
    header.global_encoding.wkt = True
    for name, kind, says in (
        ("density", "u1", "0 to 255"),
        ("frames", "u4", "that saw the cell"),
        ("ground_known", "u1", "1: z is the ground's"),
        ("height_m", "f4", "above the ground, or NaN"),
    ):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind, says))
    counts = Counter[str]()
    with (
        replacing(path, overwrite=overwrite, ours=_IS_OURS, what="a LAS of obstacles") as file,
        file.open("wb") as stream,
        laspy.open(
            stream,
            mode="w",
            header=header,
            do_compress=path.suffix.lower() == ".laz",
            laz_backend=laspy.LazBackend.Lazrs,
            closefd=False,
        ) as writer,
    ):
        for points in _points(universal, selection, options.obstacle_above, counts):
            record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
            record.x, record.y = points["x"], points["y"]
            bulge_m = (points["x"] ** 2 + points["y"] ** 2) / _EARTH_2R_M
            record.z = datum.height_m + points["z"] + bulge_m
            record.intensity = points["density"]
            for name in ("density", "frames", "ground_known", "height_m"):
                record[name] = points[name]
            record.return_number[:] = record.number_of_returns[:] = 1
            writer.write_points(record)
    return _exported(universal, path, selection, counts)


def export_ply(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: ObstacleOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write the obstacles as binary PLY: x east, y north, z up, metres from the datum in its plane.

    With each vertex go `density`, the `frames` that saw the cell, and `ground_known`: 1 where z is
    the ground, 0 where it is the vehicle's height; `height_m` is how high the obstacle stands above
    it, or NaN. Comments name the datum. Raises MapExistsError
    when `path` exists and may not be overwritten, MapWriteError when it cannot be written.
    """
    counts = Counter[str]()
    with (
        replacing(path, overwrite=overwrite, ours=_IS_OURS, what="a PLY of obstacles") as file,
        file.open("wb") as stream,
    ):
        stream.write(_ply_header(universal, 0))
        for points in _points(universal, selection, options.obstacle_above, counts):
            stream.write(points.tobytes())
        stream.seek(0)
        stream.write(_ply_header(universal, counts["points"]))
    return _exported(universal, path, selection, counts)


def _exported(
    universal: MapFile, path: Path, selection: Selection, counts: Counter[str]
) -> Exported:
    with selection.blocks(universal) as blocks:
        place = extent(blocks.lattice, blocks.window, universal.datum)
    rows = (
        ("points", str(counts["points"])),
        ("on ground that was seen", str(counts["on_seen_ground"])),
        ("datum", universal.datum.described()),
    )
    about = {name: counts[name] for name in ("points", "on_seen_ground")}
    return Exported((path,), rows, {**place, **about})


def _points(
    universal: MapFile, selection: Selection, above: int, counts: Counter[str]
) -> Iterator[AnyArray]:
    """The obstacle cells, block by block; adds their numbers to `counts`."""
    with selection.blocks(universal, _HEIGHTS, decide="density") as blocks:
        for view in blocks.views:
            worst, seen, _ = view.decision()
            j, i = np.nonzero((worst > above) & (seen > 0.0))
            if not len(i):
                continue
            east_m, north_m = view.lattice.centres(view.window)
            ground_m, vehicle_m = (
                view.layer(name)[j, i].astype(np.float64) for name in _HEIGHTS[:2]
            )
            known = np.isfinite(ground_m)
            counts.update(points=len(i), on_seen_ground=int(known.sum()))
            columns: tuple[AnyArray, ...] = (
                east_m[i],
                north_m[j],
                np.nan_to_num(np.where(known, ground_m, vehicle_m)),
                worst[j, i].astype(np.uint8),
                view.layer("count")[j, i].astype(np.uint32),
                known,
                view.layer("max_height")[j, i].astype(np.float32),
            )
            yield np.rec.fromarrays(columns, dtype=_POINT)


def _ply_header(universal: MapFile, count: int) -> bytes:
    """The header, of one length whatever the count."""
    datum, digits = universal.datum, str(count)
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {_SOFTWARE}: x east, y north, z up, metres in the plane that touches the datum",
        f"comment datum {datum.lat_deg!r} {datum.lon_deg!r} degrees, {datum.height_m!r} m, WGS84",
        f"comment {'-' * (_COUNT_DIGITS - len(digits))}",
        f"element vertex {digits}",
        *(f"property double {axis}" for axis in "xyz"),
        "property uchar density",
        "property uint frames",
        "property uchar ground_known",
        "property float height_m",
        "end_header",
    ]
    return "".join(f"{line}\n" for line in lines).encode("ascii")


register_export_format(
    ExportFormat(
        "las",
        (".las", ".laz"),
        "a point for each obstacle cell",
        export_las,
        ObstacleOptions,
        Holds.SHAPES,
        readers="CloudCompare, QGIS, PDAL",
        extras=("clouds",),
    ),
    ExportFormat(
        "ply",
        (".ply",),
        "the same as PLY, metres from the datum",
        export_ply,
        ObstacleOptions,
        Holds.SHAPES,
        readers="CloudCompare, MeshLab, Open3D",
    ),
)

"""ISO 11783-10 task data, version 4.3, for tractor terminals and farm management.

A field with its boundary, the obstacles as polygons, and guidance: each drive's forward stretches
as curves, or lanes and tracks as swaths; and a task with a grid of zones, obstacle, in doubt, free,
where a terminal would else take what nobody has seen for free. The boundary is that of mapped
ground, not of the land register.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fieldgrid.core import (
    AnyArray,
    ConfigError,
    UInt8,
    printable,
    replacing,
    replacing_folder,
    working_beside,
)
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format, require
from fieldgrid.export.shapes.features import feature_layers
from fieldgrid.export.shapes.guidance import (
    DECIMALS,
    NAME,
    TaskdataOptions,
    decimal,
    drive_groups,
    lane_groups,
    points,
    polygon_of,
    polygons,
)
from fieldgrid.export.together import is_zip
from fieldgrid.geometry import (
    FREE_UP_TO,
    OBSTACLE_ABOVE,
    Bounds,
    FeatureLayer,
    Status,
    continued_deg,
)
from fieldgrid.maps import (
    OCCUPIED,
    UNKNOWN_OCCUPANCY,
    CostCurve,
    MapFile,
    MapView,
    MarkKind,
    Selection,
)

if TYPE_CHECKING:
    from fieldgrid.field import Planting


MAX_GRID_CELLS = 50_000_000
"""A terminal that takes a grid at all takes one of some megabytes."""

_BOUNDARY_TOLERANCE_M = 0.5
_SAMPLES = 3
"""Each cell of the grid is the worst of 3 x 3 points in it: it lies askew to the map's cells."""


_POINTS = 1 << 20
"""Sample points that are placed at a time."""


_FILES = ("TASKDATA.XML", "GRD00001.bin")


ZONES = ("not observed", "free", "in doubt", "obstacle", "keep-out")
"""What a terminal shows of the zones of the grid, by their codes."""

UNSEEN, FREE, DOUBT, OBSTACLE, KEEPOUT = range(len(ZONES))


def export_taskdata(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: TaskdataOptions,
    *,
    overwrite: bool,
    planting: Planting | None = None,
    areas: Sequence[tuple[str, Any]] = (),
) -> Exported:
    """Write a folder with TASKDATA.XML and GRD00001.bin; by convention it is called TASKDATA. With
    a path that ends in .zip that folder is packed into the file, as farm software takes it. The
    guidance is that of the options, or the lanes of `planting`; `areas` are further polygons of the
    field, metres east and north, with what each is called.

    Raises ConfigError when isoxml is not installed, and for a grid that is too large for a
    terminal.
    """
    require("Writing task data", "isoxml", "isoxml")
    from isoxml.models.base import v4 as iso

    obstacles, drives, footprints = feature_layers(
        universal, selection, options, ("obstacle", "trajectory", "footprint")
    )
    grid = zone_grid(selection.view(universal, decide="density"), options.obstacle_above)
    if planting is None and options.guidance == "lanes":
        from fieldgrid.field import find_rows  # brings 50 MB of libraries

        planting = find_rows(
            universal, crop=options.crop, bounds=selection.bounds,
            obstacle_above=options.obstacle_above, at=selection.at,
        )  # fmt: skip
        if not planting.lanes:
            raise ConfigError(
                "No lanes were found in the map; --crop says which rows to look for, and "
                "--guidance drives needs none."
            )

    groups = drive_groups(drives, universal.datum) if planting is None else lane_groups(planting)
    field = _field(universal, selection.area(universal), obstacles, footprints, groups)
    for says, shape in areas:
        field.polygons += polygons(shape, iso.PolygonType.Other, says, universal.datum)
    what = "exported task data"
    if path.suffix.lower() == ".zip":
        names = {f"TASKDATA/{name}" for name in _FILES}
        ours = partial(is_zip, check=lambda archive: set(archive.namelist()) == names)
        with (
            replacing(path, overwrite=overwrite, ours=ours, what=what) as file,
            working_beside(file) as folder,
        ):
            _write(folder, field, grid)
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                for name in _FILES:
                    archive.write(folder / name, f"TASKDATA/{name}")
    else:
        # A terminal's own task data hold more: the logs of its work, which are nowhere else.
        with replacing_folder(
            path,
            overwrite=overwrite,
            ours=lambda folder: {entry.name for entry in folder.iterdir()} == set(_FILES),
            what=what,
        ) as draft:
            _write(draft, field, grid)
    rows, columns = grid.zones.shape
    guidance = "guidance curves" if planting is None else "swaths"
    patterns = sum(len(group.guidance_patterns) for group in groups)
    return Exported(
        (path,),
        (
            ("obstacles", str(len(obstacles.geometry))),
            (guidance, str(patterns)),
            ("grid of zones", f"{columns} x {rows}"),
        ),
        {
            "obstacles": len(obstacles.geometry),
            guidance.replace(" ", "_"): patterns,
            "grid_of_zones": [columns, rows],
        },
    )


class ZoneGrid(NamedTuple):
    """Codes of zones, uint8 [north, east], row 0 in the south, and where they lie in degrees."""

    zones: UInt8
    south_deg: float
    west_deg: float
    cell_north_deg: float
    cell_east_deg: float


def zone_grid(view: MapView, obstacle_above: int = OBSTACLE_ABOVE) -> ZoneGrid:
    """The view's classes on a grid along meridians and parallels, of cells as large as its own.

    A cell is the worst of what its nine sample points fall into; not observed is better than in
    doubt, so that no obstacle is lost, and worse than free.
    """
    datum, bounds, cell_m = view.datum, view.bounds, view.lattice.cell_m
    corners_east = np.array([bounds.west_m, bounds.east_m, bounds.west_m, bounds.east_m])
    corners_north = np.array([bounds.south_m, bounds.south_m, bounds.north_m, bounds.north_m])
    lat_deg, lon_deg, _ = datum.to_geodetic(corners_east, corners_north, np.zeros(4))
    lon_deg = continued_deg(lon_deg, datum.lon_deg)
    lat0, lon0, _ = datum.to_geodetic(
        np.array([0.0, cell_m, 0.0]), np.array([0.0, 0.0, cell_m]), np.zeros(3)
    )
    lon0 = continued_deg(lon0, datum.lon_deg)
    step_north, step_east = float(lat0[2] - lat0[0]), float(lon0[1] - lon0[0])
    south, west = round(float(lat_deg.min()), DECIMALS), round(float(lon_deg.min()), DECIMALS)
    rows = int(np.ceil((lat_deg.max() - south) / step_north))
    columns = int(np.ceil((lon_deg.max() - west) / step_east))
    if rows * columns > MAX_GRID_CELLS:
        raise ConfigError(
            f"A grid of {columns} x {rows} cells is over {MAX_GRID_CELLS / 1e6:.0f} million, too "
            "large for a terminal; give a larger --cell or smaller --bounds."
        )
    zones = np.empty((rows, columns), dtype=np.uint8)
    severity = _severity(view, obstacle_above)
    together = max(1, _POINTS // columns)
    for first in range(0, rows, together):
        part = np.arange(first, min(first + together, rows))[:, None]
        worst = np.zeros((len(part), columns), dtype=np.uint8)
        for a in range(_SAMPLES):
            lat = south + (part + (a + 0.5) / _SAMPLES) * step_north
            for b in range(_SAMPLES):
                lon = west + (np.arange(columns) + (b + 0.5) / _SAMPLES) * step_east
                np.maximum(worst, _sampled(view, severity, lat, lon), out=worst)
        zones[first : first + len(part)] = _BY_SEVERITY[worst]
    west = west + 360.0 if west < -180.0 else west
    return ZoneGrid(zones, south, west, step_north, step_east)


_BY_SEVERITY = np.array([FREE, UNSEEN, DOUBT, OBSTACLE, KEEPOUT], dtype=np.uint8)


def _severity(view: MapView, obstacle_above: int) -> UInt8:
    """0 free, 1 not observed, 2 in doubt, 3 obstacle, 4 keep-out."""
    worst, seen, keepout = view.decision()
    curve = CostCurve(min(FREE_UP_TO, obstacle_above), obstacle_above)
    known = curve.occupancy(worst, seen)
    found = np.select(
        [known == UNKNOWN_OCCUPANCY, known == 0, known == OCCUPIED], [1, 0, 3], 2
    ).astype(np.uint8)
    if keepout is not None:
        found[keepout] = 4
    return found


def _sampled(view: MapView, severity: UInt8, lat_deg: AnyArray, lon_deg: AnyArray) -> UInt8:
    # The height matters by some micrometres: a point of the plane 1 km away is 8 cm above the
    # datum's height, and its vertical is tilted by 0.16 mrad.
    east, north, _ = view.datum.to_enu(lat_deg, lon_deg, view.datum.height_m)
    i, j = view.lattice.index(east, north)
    i, j = i - view.window.i0, j - view.window.j0
    inside = (i >= 0) & (j >= 0) & (i < view.window.width) & (j < view.window.height)
    found = np.ones(east.shape, dtype=np.uint8)
    found[inside] = severity[j[inside], i[inside]]
    return found


def _field(
    universal: MapFile,
    area: Bounds | None,
    obstacles: FeatureLayer,
    footprints: FeatureLayer,
    groups: list[Any],
) -> Any:
    """The field as the library's value."""
    import shapely
    from isoxml.models.base import v4 as iso

    datum = universal.datum
    mapped = shapely.simplify(
        shapely.union_all(footprints.geometry[footprints.columns["status"] == Status.OK.value]),
        _BOUNDARY_TOLERANCE_M,
    )
    boundary = polygons(mapped, iso.PolygonType.PartfieldBoundary, "mapped", datum)
    outlines = zip(obstacles.geometry, obstacles.columns["mean_density"], strict=True)
    shapes = [
        polygon
        for outline, density in outlines
        for polygon in polygons(outline, iso.PolygonType.Obstacle, f"density {density:.0f}", datum)
    ]
    keepouts, flags = [], []
    for mark in universal.marks(within=area):
        if mark.kind is MarkKind.PLACE:
            flags += points(
                mark.geometry.representative_point(), datum, [iso.PointType.Flag], mark.name
            )
        elif mark.kind is MarkKind.KEEPOUT:
            says = f"keep-out {mark.name}".rstrip()
            shape = mark.geometry.buffer(0.5 * universal.cell_m if mark.is_point else 0.0)
            keepouts.append(polygon_of(shape, iso.PolygonType.Obstacle, says, datum))
    return iso.Partfield(
        id="PFD1",
        designator=printable(universal.path.stem)[:NAME],
        area=round(mapped.area),
        polygons=[*boundary, *shapes, *keepouts],
        points=flags,
        guidance_groups=groups,
    )


def _write(folder: Path, field: Any, grid: ZoneGrid) -> None:
    from importlib.metadata import version

    from isoxml.models.base import v4 as iso
    from isoxml.util.isoxml_io import isoxml_to_dir

    rows, columns = grid.zones.shape
    content = grid.zones.tobytes()
    task = iso.Task(
        id="TSK1",
        designator=field.designator,
        partfield_id_ref=field.id,
        status=iso.TaskStatus.Planned,
        default_treatment_zone_code=UNSEEN,
        position_lost_treatment_zone_code=UNSEEN,
        out_of_field_treatment_zone_code=UNSEEN,
        treatment_zones=[
            iso.TreatmentZone(code=code, designator=says) for code, says in enumerate(ZONES)
        ],
        grids=[
            iso.Grid(
                minimum_north_position=decimal(grid.south_deg),
                minimum_east_position=decimal(grid.west_deg),
                # Without an exponent, which not every terminal reads.
                cell_north_size=Decimal(f"{grid.cell_north_deg:.18f}"),
                cell_east_size=Decimal(f"{grid.cell_east_deg:.18f}"),
                maximum_column=columns,
                maximum_row=rows,
                filename="GRD00001",
                filelength=len(content),
                type=iso.GridType.GridType1,
            )
        ],
    )
    document = iso.Iso11783TaskData(
        version_minor=iso.Iso11783TaskDataVersionMinor.VALUE_3,
        management_software_manufacturer="fieldgrid",
        management_software_version=version("fieldgrid")[:NAME],
        data_transfer_origin=iso.Iso11783TaskDataDataTransferOrigin.FMIS,
        partfields=[field],
        tasks=[task],
    )
    isoxml_to_dir(folder, document, {"GRD00001": content})


register_export_format(
    ExportFormat(
        "isoxml",
        ("taskdata", "taskdata.zip"),
        "ISO 11783-10 task data 4.3",
        export_taskdata,
        TaskdataOptions,
        Holds.SHAPES,
        folder=True,
        readers="tractor terminals, farm software",
        extras=("isoxml",),
        limits="5·10^7 cells of the grid",
    )
)

"""Routes as files: a table, tracks for GIS and terminals, a path for Nav2."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import shapely

from fieldgrid.core import ConfigError, mentions, replacing
from fieldgrid.field.route.missions import mission, stretches
from fieldgrid.field.route.plan import Route
from fieldgrid.geometry import Feature, wrap_deg, write_features, yaw_from_heading_rad
from fieldgrid.poses import gpx_track
from fieldgrid.recordings import MAP, McapWriter, datum_message, path_message

# A pose each decimetre: curvature read off positions needs their micrometres.
COLUMNS = ("east_m", "north_m", "heading_deg", "gear", "curvature_1pm", "clearance_m", "lane")
"""Of route.csv. `lane` is empty where no lane is worked."""

SUFFIXES = (".geojson", ".csv", ".gpx", ".mcap", ".plan", ".gpkg", ".kml", ".dxf")
"""What the name of a route may end in."""

_GPX_NAME = "fieldgrid route"
_MARKS = {
    ".csv": ",".join(COLUMNS),
    ".gpx": _GPX_NAME,
    ".plan": '"groundStation": "fieldgrid"',
}
"""What a file that fieldgrid has written begins with, more or less."""

_FEATURES = (".geojson", ".gpkg", ".kml", ".dxf")


def check_route_target(path: Path) -> None:
    """Raise ConfigError for a name that is none of a route."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path.name} ends in none of {', '.join(SUFFIXES)}; choose one of them.")
    if path.name.lower().endswith(".graph.geojson"):
        raise ConfigError(
            f"{path.name} is the name of a route graph, and that is a network of lanes, not a "
            "route: `fieldgrid rows -o` and --swaths write it."
        )


def write_route(route: Route, path: Path, *, overwrite: bool = False) -> None:
    """Write a route in the format of the file's ending.

    `.csv` has a row a pose; `.geojson`, `.gpkg`, `.kml` and `.dxf` a line for each stretch in one
    gear and one lane; `.gpx` a segment for each stretch in one gear; `.mcap` one nav_msgs/Path on
    `/route`, whose poses are those of the vehicle, in reverse too, and the datum. `.plan` is for
    QGroundControl. Raises ConfigError for another ending, MapExistsError for a file that may not be
    overwritten, MapWriteError where it cannot be written.
    """
    check_route_target(path)
    suffix = path.suffix.lower()
    if suffix in _FEATURES:
        write_features(path, route_features(route), route.datum, overwrite=overwrite)
        return
    if suffix == ".mcap":
        places = np.stack([route.east_m, route.north_m, np.zeros(len(route.east_m))], axis=1)
        yaw_rad = yaw_from_heading_rad(route.heading_deg)
        # A route has no time: 0 stands for whenever it is driven.
        message = path_message(0, MAP, [0] * len(places), places, yaw_rad)
        with McapWriter(path, overwrite=overwrite) as writer:
            writer.write("/datum", datum_message(route.datum, 0), 0, latched=True)
            writer.write("/route", message, 0, latched=True)
        return
    ours = partial(mentions, mark=_MARKS[suffix].encode())
    what = f"a route in a {suffix}"
    with (
        replacing(path, overwrite=overwrite, ours=ours, what=what) as draft,
        draft.open("w", encoding="utf-8", newline="") as file,
    ):
        if suffix == ".gpx":
            lat, lon, _ = route.datum.to_geodetic(
                route.east_m, route.north_m, np.zeros(len(route.east_m))
            )
            starts = np.concatenate([[True], np.diff(route.gear) != 0])
            file.writelines(
                f"{line}\n" for line in gpx_track(_GPX_NAME, lat, lon, starts, [""] * len(lat))
            )
        elif suffix == ".csv":
            writer_ = csv.writer(file, lineterminator="\n")
            writer_.writerow(COLUMNS)
            writer_.writerows(
                (
                    f"{east:.6f}", f"{north:.6f}", f"{heading:.6f}", f"{gear:d}",
                    f"{curvature + 0.0:.6f}", f"{clearance:.3f}", lane,
                )
                for east, north, heading, gear, curvature, clearance, lane in zip(
                    route.east_m.tolist(),
                    route.north_m.tolist(),
                    wrap_deg(np.round(route.heading_deg, 6)).tolist(),
                    route.gear.tolist(),
                    route.curvature_1pm.tolist(),
                    route.clearance_m.tolist(),
                    route.lane.tolist(),
                    strict=True,
                )
            )  # fmt: skip
        else:
            json.dump(mission(route), file, indent=1)


def route_features(route: Route) -> list[Feature]:
    """A line for each stretch in one gear and one lane, in the order of driving."""
    found = []
    for number, (rows, gear, lane) in enumerate(stretches(route), 1):
        line = shapely.LineString(np.column_stack([route.east_m[rows], route.north_m[rows]]))
        found.append(
            Feature(
                "route",
                line,
                {
                    "id": str(number), "gear": gear,
                    "length_m": float(line.length),
                    "clearance_m": float(route.clearance_m[rows].min()),
                    "lane": lane or None,
                },
            )
        )  # fmt: skip
    return found

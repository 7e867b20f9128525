"""A track for programs that do not read its table: GPX, GeoJSON and TUM.

GPX and TUM hold poses that can be used; GeoJSON has a point for each fix, rejected ones with their
reason. Each file's first line names fieldgrid, by which a later track knows what it may replace.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import MAX_GAP_NS, yaw_from_heading_rad
from fieldgrid.poses.report import Estimate

GPX_START = (
    '<?xml version="1.0" encoding="UTF-8"?><gpx version="1.1" creator="fieldgrid" '
    'xmlns="http://www.topografix.com/GPX/1/1">'
)
GEOJSON_START = '{"type": "FeatureCollection", "name": "fieldgrid track", "features": ['
TUM_START = "# fieldgrid track: seconds UTC, east, north, up (m), quaternion x y z w; "


def gpx_lines(estimate: Estimate) -> Iterator[str]:
    """GPX 1.1: a segment for each stretch without a gap; elevations are above the ellipsoid."""
    track, rows = estimate.trajectory, _accepted(estimate)
    lat, lon, height = track.datum.to_geodetic(
        track.east_m[rows], track.north_m[rows], track.up_m[rows]
    )
    times = np.datetime_as_string(track.time_ns[rows].astype("datetime64[ns]"), unit="ms")
    starts = np.concatenate([[True], np.diff(track.time_ns[rows]) > MAX_GAP_NS])[: len(rows)]
    said = [
        f"<ele>{height_m:.3f}</ele><time>{time}Z</time>"
        for height_m, time in zip(height, times, strict=True)
    ]
    yield from gpx_track("fieldgrid track", lat, lon, starts, said)


def gpx_track(
    name: str, lat_deg: Float64, lon_deg: Float64, starts: Bool, said: Sequence[str]
) -> Iterator[str]:
    """A GPX 1.1 track of points; a segment begins where `starts` says so, and `said` is what each
    point says beside its place."""
    yield GPX_START
    yield f"<trk><name>{name}</name>"
    points = zip(starts.tolist(), lat_deg.tolist(), lon_deg.tolist(), said, strict=True)
    for k, (new, lat, lon, words) in enumerate(points):
        if new:
            yield "</trkseg><trkseg>" if k else "<trkseg>"
        yield f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{words}</trkpt>'
    yield "</trkseg></trk></gpx>" if len(starts) else "</trk></gpx>"


def geojson_lines(estimate: Estimate) -> Iterator[str]:
    """RFC 7946: a point for each fix with a pose, longitude first, height above the ellipsoid."""
    yield GEOJSON_START
    track, at = estimate.trajectory, estimate.fix_row
    rows = at[np.isfinite(track.heading_deg[at])]
    lat, lon, height = track.datum.to_geodetic(
        track.east_m[rows], track.north_m[rows], track.up_m[rows]
    )
    places = zip(rows.tolist(), lat.tolist(), lon.tolist(), height.tolist(), strict=True)
    for k, (row, lat_deg, lon_deg, height_m) in enumerate(places):
        feature: dict[str, Any] = {
            "type": "Feature",
            "geometry": {
                "type": "Point",
                "coordinates": [round(lon_deg, 9), round(lat_deg, 9), round(height_m, 3)],
            },
            "properties": {
                "time_ns": int(track.time_ns[row]),
                "heading_deg": round(float(track.heading_deg[row]), 3),
                "heading_sigma_deg": _known(float(track.heading_sigma_deg[row])),
                "position_sigma_m": _known(float(track.position_sigma_m[row])),
                "speed_mps": _known(float(track.speed_mps[row])),
                "gear": int(track.gear[row]),
                "status": track.status[row].value,
                "reason": track.reason[row],
                "gear_doubt": _known(float(estimate.gear_doubt[row])),
            },
        }
        yield json.dumps(feature, ensure_ascii=False) + ("," if k + 1 < len(rows) else "")
    yield "]}"


def tum_lines(estimate: Estimate) -> Iterator[str]:
    """TUM's `timestamp tx ty tz qx qy qz qw` in the plane of the datum: x east, y north, and a
    vehicle frame with x forward, as evo and others read it."""
    track, rows = estimate.trajectory, _accepted(estimate)
    datum = track.datum
    yield f"{TUM_START}origin {datum.lat_deg!r} {datum.lon_deg!r} {datum.height_m!r}"
    half = yaw_from_heading_rad(track.heading_deg[rows]) / 2.0
    columns = zip(
        track.time_ns[rows].tolist(),
        track.east_m[rows].tolist(),
        track.north_m[rows].tolist(),
        track.up_m[rows].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    for time_ns, east_m, north_m, up_m, z, w in columns:
        seconds = f"{time_ns // 1_000_000_000}.{time_ns % 1_000_000_000:09d}"
        yield f"{seconds} {east_m:.4f} {north_m:.4f} {up_m:.4f} 0 0 {z:.9f} {w:.9f}"


def _accepted(estimate: Estimate) -> Int64:
    rows = estimate.fix_row
    return rows[estimate.trajectory.accepted[rows]]


def _known(value: float) -> float | None:
    return round(value, 4) if np.isfinite(value) else None

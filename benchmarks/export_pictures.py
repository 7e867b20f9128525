"""docs/exports.png: one map as four readers have it that know nothing of each other, or of us.

python -m benchmarks.export_pictures vineyard.gpkg docs/exports.png

Each panel shows what its reader got from its own file. The crosshair is a position on Earth, which
each has turned into metres by what its file says of the datum. GDAL and QGIS are those of the
system (Debian's python3-gdal and python3-qgis).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyproj
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image

from fieldgrid.export import export_map
from fieldgrid.export.figures import UNSEEN
from fieldgrid.maps import MapFile, open_map
from tests.export.nav2_loader import load

PERSON = (-3.327, 61.487)
"""Where somebody stands in the bundled example, by its truth: metres east and north."""

CLOSE_M = 1.5
CROSS, DRIVE = "#d6006c", "#1f4e9c"
COLOURS = 128

Extent = tuple[float, float, float, float]


class Panel(NamedTuple):
    """What a reader has: pictures of the whole and of a part, row 0 at the top, each with its
    extent (west, east, south, north); where it has the point, and what it says there."""

    title: str
    whole: tuple[Any, Extent]
    close: tuple[Any, Extent]
    place: tuple[float, float]
    says: str
    path: npt.NDArray[np.float64] | None = None


def main(map_: Path, out: Path) -> None:
    with tempfile.TemporaryDirectory() as name, open_map(map_) as universal:
        folder = Path(name)
        for file in ("v.tif", "features.gpkg", "v.yaml", "v.mcap"):
            export_map(universal, folder / file)
        point = _on_earth(universal)
        gdal, qgis = _by_the_system(universal, folder, point)
        panels = [gdal, qgis, _by_nav2s_rules(folder, point), _by_mcap(folder, point)]
    figure = _drawn(panels, point)
    figure.savefig(out)
    with Image.open(out) as picture:
        picture.convert("RGB").quantize(COLOURS).save(out, optimize=True)


def _plane(datum: dict[str, float]) -> pyproj.Transformer:
    """Longitude, latitude, height to east, north, up, by PROJ's topocentric plane."""
    return pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lat_0={datum['lat_deg']!r} "
        f"+lon_0={datum['lon_deg']!r} +h_0={datum['height_m']!r}"
    )


def _on_earth(universal: MapFile) -> tuple[float, float, float]:
    """Latitude, longitude and height of the person."""
    datum = universal.datum
    about = {"lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg, "height_m": datum.height_m}
    lon, lat, height = _plane(about).transform(*PERSON, 0.0, direction="INVERSE")
    return float(lat), float(lon), float(height)


def _by_the_system(
    universal: MapFile, folder: Path, point: tuple[float, float, float]
) -> tuple[Panel, Panel]:
    """GDAL's panel and QGIS's."""
    bounds, (east, north) = universal.bounds, PERSON
    close = (east - CLOSE_M, north - CLOSE_M, east + CLOSE_M, north + CLOSE_M)
    asked = {
        "raster": str(folder / "v.tif"),
        "vector": str(folder / "features.gpkg"),
        "point": point[:2],
        "boxes": [list(bounds), close],
        "background": UNSEEN,
        "folder": str(folder),
    }
    done = subprocess.run(
        ["/usr/bin/python3", Path(__file__).with_name("draw_in_qgis.py")],
        input=json.dumps(asked),
        capture_output=True,
        text=True,
        check=False,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "QT_QPA_PLATFORM": "offscreen",
            "XDG_RUNTIME_DIR": str(folder),
        },
    )
    if done.returncode:
        sys.exit(f"Debian's python3-gdal and python3-qgis are needed for it:\n{done.stderr}")
    found = json.loads(done.stdout)
    return _gdal_panel(found["gdal"], folder), _qgis_panel(found["qgis"])


def _gdal_panel(found: dict[str, Any], folder: Path) -> Panel:
    with np.load(folder / "gdal.npz") as arrays:
        values, alpha = arrays["values"], arrays["alpha"]
    west, cell, _, north, _, down = found["transform"]
    east, south = west + cell * values.shape[1], north + down * values.shape[0]
    shades = np.ma.MaskedArray(values, alpha == 0)
    picture = (shades, (west, east, south, north))
    x, y = found["place"]
    value = values[int((y - north) / down), int((x - west) / cell)]
    title = f"GDAL {found['version']}: GeoTIFF"
    return Panel(title, picture, picture, (x, y), f"density {value}")


def _qgis_panel(found: dict[str, Any]) -> Panel:
    whole, close = (
        (np.asarray(Image.open(one["path"]).convert("RGB")), tuple(one["extent"]))
        for one in found["pictures"]
    )
    title = f"QGIS {found['version']}: GeoTIFF and GeoPackage"
    return Panel(title, whole, close, tuple(found["place"]), f"density {found['value']:.0f}")


def _by_nav2s_rules(folder: Path, point: tuple[float, float, float]) -> Panel:
    about = json.loads((folder / "v.georef.json").read_text(encoding="utf-8"))
    x, y, _ = _plane(about["datum"]).transform(point[1], point[0], point[2])
    grid = load(folder / "v.yaml")
    rows, columns = grid.data.shape
    west, south, _ = grid.origin
    extent = (west, west + columns * grid.resolution, south, south + rows * grid.resolution)
    picture = (_shades(grid.data)[::-1], extent)
    (value,) = grid.at(np.array([x]), np.array([y]))
    return Panel("Nav2's rules: YAML and PGM", picture, picture, (x, y), f"occupancy {value}")


def _by_mcap(folder: Path, point: tuple[float, float, float]) -> Panel:
    with (folder / "v.mcap").open("rb") as file:
        topics = ["/datum", "/map", "/two_lanes/path"]
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found: dict[str, Any] = {
            channel.topic: message
            for _, channel, _, message in reader.iter_decoded_messages(topics=topics)
        }
    fix, grid, path = (found[topic] for topic in topics)
    datum = {"lat_deg": fix.latitude, "lon_deg": fix.longitude, "height_m": fix.altitude}
    x, y, _ = _plane(datum).transform(point[1], point[0], point[2])
    info, origin = grid.info, grid.info.origin.position
    data = np.array(grid.data, dtype=np.int8).reshape(info.height, info.width)
    size = info.resolution
    extent = (origin.x, origin.x + size * info.width, origin.y, origin.y + size * info.height)
    picture = (_shades(data)[::-1], extent)
    value = data[int((y - origin.y) / size), int((x - origin.x) / size)]
    poses = np.array([(p.pose.position.x, p.pose.position.y) for p in path.poses])
    title = "MCAP: OccupancyGrid and Path"
    return Panel(title, picture, picture, (x, y), f"occupancy {value}", poses)


def _shades(occupancy: npt.NDArray[np.int8]) -> npt.NDArray[Any]:
    """Occupancy as a density is drawn, nothing where it is unknown."""
    return np.ma.MaskedArray(occupancy.astype(np.float64) * 2.55, occupancy < 0)


def _drawn(panels: list[Panel], point: tuple[float, float, float]) -> Figure:
    figure = Figure(figsize=(16.0, 8.9), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"One map, four readers. The cross is at {point[0]:.9f}°, {point[1]:.9f}°, where somebody "
        "stands in a row of vines",
        fontsize=13,
    )
    axes = figure.subplots(2, len(panels), height_ratios=(1.13, 1.0))
    shades = ListedColormap(np.linspace(1.0, 0.0, 256)[:, None].repeat(3, axis=1))
    for column, panel in enumerate(panels):
        x, y = panel.place
        for axis, (picture, extent) in zip(
            axes[:, column], (panel.whole, panel.close), strict=True
        ):
            axis.set_facecolor(UNSEEN)
            axis.imshow(
                picture,
                extent=extent,
                cmap=shades,
                vmin=0,
                vmax=255,
                # QGIS's picture is drawn already; cells have edges.
                interpolation="antialiased" if picture.ndim == 3 else "nearest",
            )
            axis.axvline(x, color=CROSS, lw=0.9)
            axis.axhline(y, color=CROSS, lw=0.9)
            if panel.path is not None:
                axis.plot(*panel.path.T, color=DRIVE, lw=1.0)
        whole, close = axes[:, column]
        west, east, south, north = panels[0].whole[1]
        whole.set(xlim=(west, east), ylim=(south, north))
        whole.set_title(panel.title, fontsize=12)
        close.set(
            xlim=(PERSON[0] - CLOSE_M, PERSON[0] + CLOSE_M),
            ylim=(PERSON[1] - CLOSE_M, PERSON[1] + CLOSE_M),
        )
        close.set_title(f"east {x:.3f} m, north {y:.3f} m: {panel.says}", fontsize=10)
        close.set_xlabel("east (m)")
    for axis in axes[:, 0]:
        axis.set_ylabel("north (m)")
    return figure


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))

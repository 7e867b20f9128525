"""`make accuracy`: maps of the example drive against its exact truth, a line a variant."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks import EXAMPLE
from fieldgrid.build import build_map
from fieldgrid.evaluation import Group, evaluate, read_truth
from fieldgrid.mapfile import open_map
from fieldgrid.settings import BuildSettings, resolve


class Variant(NamedTuple):
    """A way to build the map of the example."""

    name: str
    gnss: str
    settings: BuildSettings


def variants() -> Iterator[Variant]:
    """What is compared: GNSS, matcher, search, grid, transfer."""
    rtk, sf1 = "gnss_rtk.nmea", "gnss_sf1.nmea"
    yield Variant("RTK, as built by default", rtk, resolve(None, {}))
    yield Variant(
        "RTK, all 128 disparities searched", rtk, resolve(None, {"stereo": {"min_range_m": 1.3}})
    )
    yield Variant("RTK, matcher sgbm", rtk, resolve(None, {"stereo": {"matcher": "sgbm"}}))
    yield Variant("RTK, matcher bm", rtk, resolve(None, {"stereo": {"matcher": "bm"}}))
    yield Variant("RTK, area transfer", rtk, resolve(None, {"map": {"transfer": "area"}}))
    yield Variant(
        "RTK, the paper's grid 6.65 x 14",
        rtk,
        resolve(None, {"grid": {"width_m": 6.65, "length_m": 14.0}}),
    )
    yield Variant("SF1 (decimetres, jumps, hole)", sf1, resolve(None, {}))


def main() -> None:
    """Build, evaluate and print every variant."""
    print(
        "forward on the rows; asked of RTK: precision >= 94 %, recall >= 95 % within 10 cm, "
        "free with an obstacle <= 0.5 %"
    )
    print(
        f"{'':<36}{'frames':>8}{'prec 10cm':>11}{'25cm':>8}{'rec 10cm':>10}{'25cm':>8}"
        f"{'free!':>8}{'|heading| med, 95 %':>21}{'|pos| med':>11}"
    )
    for variant in variants():
        print(_line(variant.name, _measure(variant)))


def _measure(variant: Variant) -> Group:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map.gpkg"
        build_map([EXAMPLE], out, variant.settings, gnss=variant.gnss)
        with open_map(out) as universal:
            return evaluate(universal, read_truth(EXAMPLE / "truth")).groups[0]


def _line(name: str, group: Group) -> str:
    obstacles, poses = group.obstacles, group.poses
    shares = [
        obstacles.precision["0.10"],
        obstacles.precision["0.25"],
        obstacles.recall["0.10"],
        obstacles.recall["0.25"],
        obstacles.free_with_obstacle,
    ]
    if None in shares or poses.heading_median_deg is None or poses.heading_p95_deg is None:
        return f"{name:<36} no frame was used"
    p10, p25, r10, r25, _ = (f"{100 * (share or 0.0):.1f} %" for share in shares)
    heading = f"{poses.heading_median_deg:.2f}°, {poses.heading_p95_deg:.2f}°"
    position = f"{poses.position_median_m or 0.0:.3f} m"
    return (
        f"{name:<36}{poses.frames:>5}/{poses.frames + poses.rejected:<2}{p10:>11}{p25:>8}{r10:>10}"
        f"{r25:>8}{f'{100 * (shares[4] or 0.0):.2f} %':>8}{heading:>21}{position:>11}"
    )


if __name__ == "__main__":
    main()

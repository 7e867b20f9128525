"""Objects that changed between drives, beside what is known: `python -m benchmarks.changes`.

The two rendered drives of one vineyard: between them a person went away, drums were put down and
the canopy grew. Then pairs of drives between which nothing changed, and drives that are shifted on
purpose. The data lie beside the repository in ../shared/data. `--maps FOLDER` keeps the maps for
the next run.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from benchmarks.heading_scores import DATA
from fieldgrid.core import BuildSettings
from fieldgrid.field import ChangedObject, align_map, find_changes
from fieldgrid.field.changes.result import ChangeKind
from fieldgrid.maps import Change, FrameRecord, create_map, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

EARLY, LATE = "vineyard_two_lanes", "vineyard_two_lanes_later"
RTK, SF1 = "gnss_rtk.nmea", "gnss_sf1.nmea"
NEAR_M = 0.5
"""How far the middle of an object may be from the outline of the true one."""


class Truth(NamedTuple):
    """What went or came: its name and its outline, metres east and north."""

    kind: ChangeKind
    name: str
    outline: shapely.Geometry


def true_changes() -> list[Truth]:
    """By the lists of obstacles of the two drives."""
    lists = []
    for drive in (EARLY, LATE):
        text = (DATA / drive / "truth" / "obstacles.json").read_text()
        lists.append(
            {
                one["id"]: shapely.convex_hull(shapely.MultiPoint(one["footprint_EN"]))
                for one in json.loads(text)["obstacles"]
            }
        )
    old, new = lists
    return [
        *(Truth(ChangeKind.VANISHED, name, old[name]) for name in sorted(old.keys() - new.keys())),
        *(Truth(ChangeKind.APPEARED, name, new[name]) for name in sorted(new.keys() - old.keys())),
    ]


def build(path: Path, drives: list[tuple[str, str, str | Path]]) -> Path:
    """A map of drives (session, recording, log), unless it is there."""
    if not path.exists():
        for name, recording, log in drives:
            build_map(
                [DATA / recording], path, BuildSettings(), DriveOptions(gnss=str(log)),
                name=name, append=path.exists(),
            )  # fmt: skip
    return path


def jittered(log: Path, out: Path, seed: int, sigma_m: float = 0.015, tau_s: float = 20.0) -> Path:
    """The log of another receiver of RTK quality: the GGA of a log with a slow error of its own."""
    draw = random.Random(seed)
    fading = math.exp(-0.2 / tau_s)
    fresh_m = sigma_m * math.sqrt(1.0 - fading**2)
    east_m, north_m = draw.gauss(0.0, sigma_m), draw.gauss(0.0, sigma_m)
    lines = []
    for line in log.read_text().split():
        if line[3:6] == "GGA":
            east_m = fading * east_m + draw.gauss(0.0, fresh_m)
            north_m = fading * north_m + draw.gauss(0.0, fresh_m)
            fields = line[1:].split("*")[0].split(",")
            fields[2] = _moved(fields[2], north_m / 111_200.0, fields[3] == "N")
            lat = math.radians(float(fields[2][:2]))
            fields[4] = _moved(fields[4], east_m / (111_320.0 * math.cos(lat)), fields[5] == "E")
            body = ",".join(fields)
            line = f"${body}*{reduce(lambda a, b: a ^ ord(b), body, 0):02X}"
        lines.append(line)
    out.write_text("\r\n".join(lines) + "\r\n")
    return out


def _moved(angle: str, by_deg: float, positive: bool) -> str:
    """dddmm.mmmm, moved by degrees north or east."""
    whole, digits = angle.index(".") - 2, len(angle) - angle.index(".") - 1
    minutes = float(angle[whole:]) + (60.0 if positive else -60.0) * by_deg
    return f"{angle[:whole]}{minutes:0{3 + digits}.{digits}f}"


def split(path: Path, out: Path, session: str, first: Callable[[int, int], bool]) -> Path:
    """A map of one drive as two: the frames for which `first` is true (of number and count), and
    the others."""
    out.unlink(missing_ok=True)
    with open_map(path) as universal, create_map(out, universal.datum) as halves:
        (info,) = (info for info in universal.sessions() if info.name == session)
        frames = [f for f in universal.frames(session, with_grid=True) if f.accepted]
        parts: list[list[FrameRecord]] = [[], []]
        for k, frame in enumerate(frames):
            parts[0 if first(k, len(frames)) else 1].append(frame)
        parts.sort(key=lambda part: part[-1].pose.time_ns)
        for name, part in zip(("one", "other"), parts, strict=True):
            with halves.add_session(name, config=info.config) as added:
                for frame in part:
                    added.add(frame.grid(), frame.pose, frame_id=frame.frame_id)
    return out


def shifted(path: Path, out: Path, session: str, east_m: float, north_m: float) -> Path:
    """A copy of a map with a session shifted, as by `sessions --shift`."""
    shutil.copy(path, out)
    with open_map(out, writable=True) as universal:
        universal.set_transform(session, east_m, north_m)
    return out


def aligned(path: Path, out: Path) -> Path:
    """A copy of a map with its sessions aligned."""
    shutil.copy(path, out)
    with open_map(out, writable=True) as universal:
        universal.set_transforms(align_map(universal).transforms)
    return out


def offset_m(path: Path, session: str, to: str) -> tuple[float, float]:
    """The mean shift that puts the frames of a session onto those of another."""
    with open_map(path) as universal:
        poses = [
            {f.frame_id: (f.pose.east_m, f.pose.north_m) for f in universal.frames(n) if f.accepted}
            for n in (session, to)
        ]
    common = sorted(poses[0].keys() & poses[1].keys())
    away = np.mean([np.subtract(poses[1][k], poses[0][k]) for k in common], axis=0)
    return float(away[0]), float(away[1])


def score(
    what: str, path: Path, from_: str, to: str, truth: list[Truth], **options: float
) -> Iterator[str]:
    """A line of what was found, and one for each object."""
    with open_map(path) as universal:
        start = time.process_time()
        changes = find_changes(universal, from_, to, **options)
        seconds = time.process_time() - start
    cells_m2 = sum(changes.view.area_m2(kind) for kind in (Change.APPEARED, Change.VANISHED))
    found = [true_one(o, truth) for o in changes]
    missed = [t.name for t in truth if t not in found]
    growth = (ChangeKind.GROWN, ChangeKind.CUT_BACK)
    false = [
        o
        for o, known in zip(changes, found, strict=True)
        if known is None and o.kind not in growth and o.confidence >= 0.9 and o.area_m2 > 0.1
    ]
    yield (
        f"{what:<46} cells {cells_m2:5.1f} m²  objects {len(changes):2d}  "
        f"false {len(false):2d}  missed {', '.join(missed) or '-':<20} {seconds:4.1f} s"
    )
    for o, known in zip(changes, found, strict=True):
        beside = "(no true one)"
        if known is not None:
            off_m = known.outline.centroid.distance(shapely.Point(o.east_m, o.north_m))
            beside = f"{known.name} ({known.outline.area:.2f} m², {off_m:.2f} m off)"
        yield (
            f"    {o.kind.value:<9} {o.area_m2:5.2f} m²  {o.east_m:7.2f} {o.north_m:6.2f}  "
            f"confidence {o.confidence:.3f}  sigma {o.sigma_m:.2f} m  {beside}"
        )


def true_one(found: ChangedObject, truth: list[Truth]) -> Truth | None:
    """The true change that an object is: of its kind, its middle within 0.5 m of the outline."""
    middle = shapely.Point(found.east_m, found.north_m)
    alike = (t for t in truth if t.kind is found.kind and t.outline.distance(middle) <= NEAR_M)
    return next(alike, None)


def measure(folder: Path) -> Iterator[str]:
    """All lines."""
    truth = true_changes()
    rtk = build(folder / "rtk.gpkg", [("june", EARLY, RTK), ("later", LATE, RTK)])
    sf1 = build(folder / "sf1.gpkg", [("june", EARLY, SF1), ("later", LATE, SF1)])
    logs = [
        jittered(DATA / EARLY / "gnss" / RTK, folder / f"rtk{seed}.nmea", seed) for seed in (1, 2)
    ]
    same = build(
        folder / "same.gpkg",
        [
            *((f"rtk{k}", EARLY, log) for k, log in enumerate(logs, 1)),
            ("rtk", EARLY, RTK),
            ("sf1", EARLY, SF1),
        ],
    )
    other = folder / "other.gpkg"

    yield "what changed: the person went, the drums came"
    yield from score("RTK", rtk, "june", "later", truth)
    for options in (
        {"cell_m": 0.1}, {"cell_m": 0.25}, {"min_area_m2": 0.02}, {"min_area_m2": 0.2},
        {"sigmas": 2.0}, {"sigmas": 1.0}, {"sigmas": 4.0}, {"growth_m": 0.3}, {"growth_m": 0.6},
    ):  # fmt: skip
        yield from score(f"RTK, {_words(options)}", rtk, "june", "later", truth, **options)
    yield from score("SF1", sf1, "june", "later", truth)
    coinciding = aligned(sf1, folder / "sf1_aligned.gpkg")
    yield from score("SF1, aligned", coinciding, "june", "later", truth)
    yield from score("SF1, position_sigma_m 0.1", sf1, "june", "later", truth, position_sigma_m=0.1)

    yield "nothing changed"
    shift = offset_m(same, "sf1", "rtk")
    yield from score("one drive, two logs like RTK", same, "rtk1", "rtk2", [])
    yield from score("one drive, RTK and a log like it", same, "rtk2", "rtk", [])
    back = shifted(same, other, "sf1", *shift)
    yield from score("one drive, RTK and SF1 less its offset", back, "rtk", "sf1", [])
    yield from score(
        "  and said to be as sure as RTK", back, "rtk", "sf1", [], position_sigma_m=0.02
    )
    for session, path in (("june", rtk), ("later", rtk)):
        for what, first in (
            ("every other frame", lambda k, _: k % 2 == 0),
            ("first half and second", lambda k, n: k < n // 2),
        ):
            parts = split(path, other, session, first)
            yield from score(f"{session} in two: {what}", parts, "one", "other", [])

    yield "RTK, the later drive shifted, which the map is not told"
    for by_m in (0.05, 0.1, 0.2):
        for east, north in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            moved = shifted(rtk, other, "later", by_m * east, by_m * north)
            yield from score(
                f"{by_m * east:+.2f} m east, {by_m * north:+.2f} m north", moved, "june", "later",
                truth,
            )  # fmt: skip


def _words(options: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in options.items())


def main() -> None:
    """Print everything, or that the data are not at hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=Path, help="keep the maps here")
    maps = parser.parse_args().maps
    if not all((DATA / drive).is_dir() for drive in (EARLY, LATE)):
        print(f"{DATA}: not at hand, left out")
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = maps or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for line in measure(folder):
            print(line, flush=True)


if __name__ == "__main__":
    main()

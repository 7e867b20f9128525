"""Rows against what is known of them: rendered drives, surveyed posts, layouts of real vineyards.

`python -m benchmarks.rows drives|survey|layouts|time` prints one section, without a word all of
them. `--maps FOLDER` keeps the maps of the drives for the next run. The data lie beside the
repository in ../shared/data; without them there is only the time to print.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from benchmarks.fields import (
    Array,
    Field,
    driven_vineyard,
    layout,
    sides_of_lanes,
    surveyed_fields,
)
from benchmarks.heading_scores import DATA
from benchmarks.planting import Planting, Sight, seen_view
from fieldgrid.core import BuildSettings
from fieldgrid.field import Planting as Found, find_rows
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.field.rows.segments import thinned
from fieldgrid.geometry import lengths, project, resampled
from fieldgrid.maps import OBSTACLE, Evidence, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

DRIVES = ("vineyard_two_lanes", "vineyard_two_lanes_later", "vineyard_slope")
SEEDS = range(3)
_NEAR_M = 0.75


class Matched(NamedTuple):
    """Found rows on true ones: pairs (found, true), false ones, true ones that were missed."""

    pairs: list[tuple[int, int]]
    false: int
    missed: int

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        return 2.0 * len(self.pairs) / max(2 * len(self.pairs) + self.false + self.missed, 1)


def match(found: list[Array], true: list[Array], counted: list[bool]) -> Matched:
    """A found row is right when its points lie within 0.75 m (mean) of a true one that it covers by
    half; a second one on the same row, or one on no row, is false. A true row that does not count
    is neither missed nor false."""
    taken: dict[int, int] = {}
    false = 0
    for k, line in enumerate(found):
        points = resampled(line, 0.25)
        apart = [np.abs(project(points, row)[1]).mean() + _beyond(points, row) for row in true]
        best = int(np.argmin(apart)) if apart else -1
        if best < 0 or apart[best] > _NEAR_M:
            false += 1
            continue
        if not counted[best]:
            continue
        at, _ = project(points, true[best])
        if best in taken or np.ptp(at) < 0.5 * lengths(true[best])[-1]:
            false += 1
            continue
        taken[best] = k
    missed = sum(c for k, c in enumerate(counted) if k not in taken)
    return Matched([(k, row) for row, k in taken.items()], false, missed)


def _beyond(points: Array, row: Array) -> float:
    at, _ = project(points, row)
    return float(np.mean(np.maximum(-at, at - lengths(row)[-1]).clip(0.0)))


def offsets(found: Array, true: Array) -> Array:
    """How far left of the true row the found one lies, each quarter of a metre where both are."""
    points = resampled(found, 0.25)
    at, off = project(points, true)
    return off[(at >= 0.0) & (at <= lengths(true)[-1])]


def angle_deg(found: Array, true: Array) -> float:
    """Between the chords of both over the stretch that both have."""
    points = resampled(found, 0.25)
    at, off = project(points, true)
    inside = (at >= 0.0) & (at <= lengths(true)[-1])
    return float(abs(np.degrees(np.polyfit(at[inside], off[inside], 1)[0])))


def _rms(values: list[Array]) -> float:
    every = np.concatenate(values) if values else np.zeros(0)
    return float(np.sqrt((every**2).mean())) if len(every) else float("nan")


# --- rendered drives ---------------------------------------------------------------------------


def drives(maps: Path) -> Iterator[str]:
    """The three rendered drives with their RTK logs: the map is built, its rows are judged."""
    for name in DRIVES:
        path = maps / f"{name}.gpkg"
        if not path.exists():
            build_map([DATA / name], path, BuildSettings(), DriveOptions("gnss_rtk.nmea"))
        yield f"{name}: {judge_drive(path, name)}"


def judge_drive(path: Path, name: str) -> str:
    """One line of figures for the rows of a map of a rendered drive."""
    truth = driven_vineyard(name)
    with open_map(path) as universal:
        planting = find_rows(universal)
        evidence = Evidence.of(universal.read(decide="density"))
    points = thinned(evidence, evidence.cell_m)
    seen = [_seen_part(points, row) for row in truth.rows]
    lines = [np.asarray(row.line.coords) for row in planting.rows]
    matched = match(lines, truth.rows, [share >= 0.4 for share, _ in seen])
    off, turns, ends, widths, clear, metres = [], [], [], [], [], []
    for k, t in matched.pairs:
        off.append(offsets(lines[k], truth.rows[t]))
        turns.append(angle_deg(lines[k], truth.rows[t]))
        at, _ = project(lines[k], truth.rows[t])
        low, high = seen[t][1]
        length = lengths(truth.rows[t])[-1]
        ends += [abs(at.min())] if low < 0.5 else []
        ends += [abs(at.max() - length)] if high > length - 0.5 else []
    on_seen = [
        gap
        for gap in truth.gaps
        if any(
            share >= 0.4 and abs(project(np.asarray(gap.coords), row)[1]).max() < 0.5
            for row, (share, _) in zip(truth.rows, seen, strict=True)
        )
    ]
    right, listed, known = _gaps(planting, on_seen)
    for lane in planting.lanes:
        if lane.driven:
            true_m = true_widths(truth.occupied, lane.line)
            widths.append(lane.free_width_m - true_m.min())
            clear.append(lane.clear_width_m - true_m.min())
            metres.append(lane.widths_m - true_m[: len(lane.widths_m)])
    of_metres = np.concatenate(metres)
    of_metres = of_metres[np.isfinite(of_metres)]
    things = [
        name
        for name, place in truth.things.items()
        if any(o.area.distance(place) < 0.3 for o in planting.obstacles)
    ]
    in_map = [name for name, place in truth.things.items() if _is_seen(points, place)]
    return (
        f"rows {len(matched.pairs)} right, {matched.false} false, {matched.missed} missed, F1 "
        f"{matched.f1:.3f}; RMSE {_rms(off):.3f} m, angle {max(turns):.2f}°, ends at most "
        f"{max(ends):.2f} m of {len(ends)}; gaps {right} of {known} true and {listed} found; free "
        f"width {', '.join(f'{w:+.2f}' for w in widths)} m, clear width "
        f"{', '.join(f'{w:+.2f}' for w in clear)} m, of {len(of_metres)} metres "
        f"{np.median(of_metres):+.2f}, 95 % {np.quantile(of_metres, 0.95):+.2f}, worst "
        f"{of_metres.max():+.2f} m; found {', '.join(things) or 'nothing'} "
        f"of {', '.join(in_map) or 'nothing'} in the map"
    )


def _seen_part(points: Array, row: Array) -> tuple[float, tuple[float, float]]:
    """The share of a row's half metres with obstacle cells within 0.6 m, first and last of them."""
    near = points[np.abs(points - row.mean(axis=0)).max(axis=1) < 60.0]
    at, off = project(near, row)
    inside = (np.abs(off) < 0.6) & (at > 0.0) & (at < lengths(row)[-1])
    places = np.unique((at[inside] / 0.5).astype(int))
    if not len(places):
        return 0.0, (np.inf, -np.inf)
    share = len(places) * 0.5 / lengths(row)[-1]
    return float(share), (float(at[inside].min()), float(at[inside].max()))


def _gaps(found: Found, true: list[shapely.LineString]) -> tuple[int, int, int]:
    """Gaps of 1.5 m and more: those on a true one by more than half, how many, how many true."""
    listed = [g for g in found.gaps if g.length_m >= 1.5]
    right = 0
    for gap in true:
        on = [gap.intersection(g.line.buffer(0.7, cap_style="flat")).length for g in listed]
        right += bool(on) and max(on) > 0.5 * gap.length
    return right, len(listed), len(true)


def true_widths(truth: Evidence, line: shapely.LineString) -> Array:
    """The least free width in each metre of a line on the true raster, as wide as 1.5 m to either
    side."""
    step_m = truth.cell_m / 1.5
    strip = truth.strip(np.asarray(line.coords), 1.5, 1.5, step_m, step_m)
    run, widest = np.zeros(len(strip.cells)), np.zeros(len(strip.cells))
    for column in range(strip.cells.shape[1]):
        run = (run + 1.0) * (strip.cells[:, column] != OBSTACLE)
        np.maximum(widest, run, out=widest)
    metre = strip.along_m.astype(int)
    widths = np.full(metre[-1] + 1, np.inf)
    np.minimum.at(widths, metre, widest * step_m)
    return widths


def _is_seen(points: Array, place: shapely.Polygon) -> bool:
    return int(shapely.contains_xy(place.buffer(0.2), points).sum()) >= 10


# --- evidence made of surveys and layouts --------------------------------------------------------


def judge_field(
    field: Field, sight: Sight, cell_m: float
) -> tuple[Matched, list[Array], Found, float]:
    """Rows of a field that is seen so: how they match, offsets, what was found, seconds."""
    view = seen_view(Planting(field.rows, 0.3, field.missing), sight, cell_m)
    start = time.process_time()
    found = rows_of_view(view)
    spent = time.process_time() - start
    sides = sight.sides or [(True, True)] * len(field.rows)
    lines = [np.asarray(row.line.coords) for row in found.rows]
    counted = [any(s) and lengths(r)[-1] >= 6.0 for s, r in zip(sides, field.rows, strict=True)]
    matched = match(lines, field.rows, counted)
    return matched, [offsets(lines[k], field.rows[t]) for k, t in matched.pairs], found, spent


def survey() -> Iterator[str]:
    """Surveyed vines and posts, rasterised as evidence with noise, holes and one-sided views."""
    right = false = missed = 0
    off: list[Array] = []
    for field in surveyed_fields():
        for seed in SEEDS:
            rng = np.random.default_rng(seed)
            sides = sides_of_lanes(field.rows, 0.2, rng)
            sight = Sight(
                sides,
                noise_per_m2=0.1,
                hole_share=0.08,
                fill=float(rng.uniform(0.3, 0.9)),
                seed=seed,
            )
            matched, own, _, _ = judge_field(field, sight, 0.1)
            right, false = right + len(matched.pairs), false + matched.false
            missed, off = missed + matched.missed, off + own
            worst = max((float(np.sqrt((o**2).mean())) for o in own), default=float("nan"))
            yield (
                f"{field.name} seed {seed}: {len(matched.pairs)} right, {matched.false} false, "
                f"{matched.missed} missed; RMSE {_rms(own):.3f} m, worst row {worst:.3f} m"
            )
    f1 = 2.0 * right / max(2 * right + false + missed, 1)
    yield f"survey: F1 {f1:.4f}, RMSE {_rms(off):.3f} m"


def layouts(numbers: range = range(1, 41)) -> Iterator[str]:
    """Real layouts as evidence with noise, holes and unseen lanes: rows, and the ends of lanes."""
    right = false = missed = 0
    near: list[Array] = []
    for number in numbers:
        field = layout(number)
        rng = np.random.default_rng(number)
        sides = sides_of_lanes(field.rows, 0.1, rng)
        sight = Sight(sides, noise_per_m2=0.05, hole_share=0.05, seed=number)
        matched, _, found, spent = judge_field(field, sight, 0.1)
        right, false = right + len(matched.pairs), false + matched.false
        missed += matched.missed
        mouths = np.concatenate(
            [np.asarray(lane.line.coords)[[0, -1]] for lane in found.lanes] or [np.zeros((0, 2))]
        )
        hidden = shapely.MultiLineString(
            [row for row, side in zip(field.rows, sides, strict=True) if not any(side)]
        )
        # The end of a lane beside a row that was not seen at all cannot be told.
        told = np.array(
            [hidden.is_empty or hidden.distance(shapely.Point(p)) > 2.2 for p in field.ends]
        )
        apart = np.hypot(*(field.ends[:, None] - mouths[None]).transpose(2, 0, 1)).min(axis=1)
        near.append(apart[told])
        yield (
            f"layout {number}: {len(matched.pairs)} right, {matched.false} false, "
            f"{matched.missed} missed; {(apart[told] < 1.0).mean():.1%} of {told.sum()} lane ends "
            f"within 1 m; {spent:.1f} s"
        )
    f1 = 2.0 * right / max(2 * right + false + missed, 1)
    every = np.concatenate(near)
    yield f"layouts: F1 {f1:.4f}, {(every < 1.0).mean():.1%} of {len(every)} lane ends within 1 m"


def hundreds() -> Iterator[str]:
    """Two hundred rows of 100 m in cells of 0.1 m: the time."""
    rows = [np.array([[2.5 * k, 0.0], [2.5 * k + 3.0, 100.0]]) for k in range(200)]
    view = seen_view(Planting(rows), Sight(), 0.1)
    rows_of_view(view)  # Numba compiles or loads its cache.
    start = time.process_time()
    found = rows_of_view(view)
    yield f"200 rows of 100 m: {len(found.rows)} found in {time.process_time() - start:.1f} s"


def main() -> None:
    """Print the sections that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("section", nargs="*", choices=["drives", "survey", "layouts", "time", []])
    parser.add_argument("--maps", type=Path)
    given = parser.parse_args()
    wanted = given.section or ["drives", "survey", "layouts", "time"]
    with tempfile.TemporaryDirectory() as folder:
        maps = given.maps or Path(folder)
        sections: dict[str, Callable[[], Iterator[str]]] = {
            "drives": lambda: drives(maps), "survey": survey, "layouts": layouts, "time": hundreds,
        }  # fmt: skip
        for name in wanted:
            if name != "time" and not DATA.exists():
                print(f"{name}: skipped, there is no {DATA}")
                continue
            for line in sections[name]():
                print(line, flush=True)


if __name__ == "__main__":
    main()

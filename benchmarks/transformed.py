"""Drives that nobody has recorded, made of those with a truth: `python -m benchmarks.transformed`.

Each drive is driven from its end to its start, goes on after a hole, or is given other stamps,
qualities or a gyro that dies: what sensors of the same kind would have recorded of another drive.
The truth goes with it, so that a line tells of each what share of its poses is used, how far
headings are off, and how many are within three of their sigmas. WORDS pick the transformations
whose name holds one of them; `--notes` prints what the report says, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from benchmarks import heading_road, heading_tractor
from benchmarks.heading_honesty import RENDERED
from benchmarks.heading_scores import DATA, circular_median_deg, make_fixes, percent, poses_at
from benchmarks.variations import THREE_SIGMA_2D, read_truth
from fieldgrid.core import FieldgridError, Float64, GearName, Int64, PoseSettings, Quality
from fieldgrid.geometry import Datum, FixColumns, Gyro, Motion, Rig, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.recordings import open_recording
from tests.simulated import DATUM, fixes_of, gyro_of, pivoting
from tests.told import warnings

SECOND = 1_000_000_000
MOVING_MPS, STANDING_MPS = 0.2, 0.05
GEARS: tuple[GearName, GearName] = (GearName.REVERSE, GearName.FORWARD)


class Known(NamedTuple):
    """A drive and its truth at m instants: heading, gear (0 where not known), and where the grid
    origin is (NaN where not known). `offset` says that the truth's heading is only known up to a
    constant."""

    name: str
    fixes: FixColumns
    time_ns: Int64
    heading_deg: Float64
    gear: Int64
    east_m: Float64
    north_m: Float64
    datum: Datum
    motion: Motion = Motion()
    rig: Rig | None = None
    offset: bool = False
    settings: PoseSettings = PoseSettings()

    def points(self) -> tuple[Float64, Float64, Float64]:
        """The fixes in metres."""
        return self.datum.to_enu(self.fixes.lat_deg, self.fixes.lon_deg, self.fixes.height_m)

    def at_points(self, east: Float64, north: Float64, up: Float64, **more: Any) -> Known:
        """The fixes elsewhere."""
        lat, lon, height = self.datum.to_geodetic(east, north, up)
        return self._replace(
            fixes=self.fixes.replace(lat_deg=lat, lon_deg=lon, height_m=height), **more
        )


Change = Callable[[Known, np.random.Generator], Known]


# --- the drives


def tractors() -> Iterator[Known]:
    """The garden tractor's, moving, positions and qualities only."""
    for log in heading_tractor.logs():
        if (log.speed_mps > MOVING_MPS).sum() < 200:
            continue
        thin = heading_tractor.harmed(log, heading_tractor.HARMS[0])
        fixes = make_fixes(thin.time_ns, thin.lat_deg, thin.lon_deg, thin.quality)
        rows = np.flatnonzero(np.isfinite(log.truth_deg) & (log.speed_mps > MOVING_MPS))
        nothing = np.full(len(rows), np.nan)
        yield Known(
            *(f"tractor {log.name}", fixes, log.time_ns[rows], log.truth_deg[rows]),
            *(log.true_gear[rows], nothing, nothing),
            _datum(fixes),
            offset=True,
        )


def _datum(fixes: FixColumns) -> Datum:
    here = np.flatnonzero(np.isfinite(fixes.lat_deg))[0]
    return Datum(float(fixes.lat_deg[here]), float(fixes.lon_deg[here]), 0.0)


def roads() -> Iterator[Known]:
    """KITTI's cars that move."""
    for path in sorted(heading_road.FOLDER.glob("*.csv")):
        log = heading_road.read_log(path, heading_road.TOLD[0])
        rows = np.flatnonzero(log.moving)
        if not len(rows):
            continue
        nothing = np.full(len(rows), np.nan)
        yield Known(
            *(f"road {log.name[5:]}", log.fixes, log.fixes.time_ns[rows], log.truth_deg[rows]),
            *(np.ones(len(rows), dtype=np.int64), nothing, nothing),
            _datum(log.fixes),
        )


def vineyards() -> Iterator[Known]:
    """The rendered drives, with their gyros."""
    for name, logs in RENDERED:
        if not (DATA / name).exists():
            continue
        truth = read_truth(name)
        for log in logs:
            with open_recording(DATA / name, log) as drive:
                fixes, motion, rig, datum = (
                    drive.fixes(),
                    drive.motion(),
                    drive.rig,
                    drive.datum_hint,
                )
            assert datum is not None
            # A mirrored accelerometer is none.
            yield Known(
                *(f"{name[9:]} {log}", fixes, truth.time_ns, truth.heading_deg, truth.gear),
                *(truth.east_m, truth.north_m, datum),
                Motion(gyro=motion.gyro),
                rig,
            )


def robots() -> Iterator[Known]:
    """Simulated ones that turn on the spot, with gyro."""
    for seed in range(8):
        drive = pivoting(seed)
        fixes, motion = fixes_of(drive, 0.2, 0.01), Motion(gyro=gyro_of(drive, 50.0, 0.1, 0.1))
        truth = drive.every(0.2)
        rows = np.flatnonzero(np.abs(truth.speed_mps) > STANDING_MPS)
        truth = truth.at(truth.time_s[rows])
        yield Known(
            *(f"robot {seed}", fixes, fixes.time_ns[rows], np.degrees(truth.heading_rad)),
            *(truth.gear(), truth.east_m, truth.north_m, DATUM),
            motion,
        )


# --- the way that it was driven


def _gyro(one: Known, size: float, times: Callable[[Int64], Int64] | None = None) -> Motion:
    """Its rates another size at other times."""
    gyro = one.motion.gyro
    if gyro is None:
        return Motion()
    stamps = gyro.time_ns if times is None else times(gyro.time_ns)
    order = np.argsort(stamps, kind="stable")
    return Motion(gyro=Gyro(stamps[order], size * gyro.rate_rad_s[order]))


def in_other_gears(one: Known, _: np.random.Generator) -> Known:
    """From its end to its start: it backs up where it drove forward. The gear at the start is
    declared."""
    ends_ns = int(one.fixes.time_ns[0] + one.fixes.time_ns[-1])
    fixes = one.fixes[::-1]
    course_deg = wrap_deg(fixes.course_deg + 180.0)
    gear = -one.gear[::-1]
    starts = GEARS[int(gear[np.flatnonzero(gear)][:1].sum() >= 0)]
    return one._replace(
        fixes=fixes.replace(time_ns=ends_ns - fixes.time_ns, course_deg=course_deg),
        motion=_gyro(one, -1.0, lambda time_ns: ends_ns - time_ns),
        time_ns=ends_ns - one.time_ns[::-1],
        gear=gear,
        **{name: getattr(one, name)[::-1] for name in ("heading_deg", "east_m", "north_m")},
        settings=PoseSettings(starts=starts),
    )


def joined(hole_s: float, away_m: float = 0.0) -> Change:
    """From the middle on the drive goes on after a hole, elsewhere."""

    def change(one: Known, _: np.random.Generator) -> Known:
        middle = int(one.fixes.time_ns[len(one.fixes) // 2])
        later = round(hole_s * SECOND)
        east, north, up = one.points()
        after = one.fixes.time_ns >= middle
        truth = one.time_ns >= middle
        fixes = one.fixes.replace(time_ns=one.fixes.time_ns + later * after)
        return one._replace(
            fixes=fixes,
            motion=_gyro(one, 1.0, lambda t: t + later * (t >= middle)),
            time_ns=one.time_ns + later * truth,
            east_m=one.east_m + away_m * truth,
        ).at_points(east + away_m * after, north, up)

    return change


# --- what a receiver says


def two_receivers(one: Known, _: np.random.Generator) -> Known:
    """Every row twice with one stamp, the second 0.6 m north."""
    rows = np.repeat(np.arange(len(one.fixes)), 2)
    both = one.fixes[rows]
    lat_deg = both.lat_deg + np.tile([0.0, 0.6], len(one.fixes)) / 111_200.0
    return one._replace(fixes=both.replace(lat_deg=lat_deg))


def clock_set(by_s: float) -> Change:
    """The clock of the receiver is set; the truth, of another clock, stays."""

    def change(one: Known, _: np.random.Generator) -> Known:
        middle = int(one.fixes.time_ns[len(one.fixes) // 2])
        by = round(by_s * SECOND)
        after = one.fixes.time_ns >= middle
        truth = one.time_ns >= middle
        return one._replace(
            fixes=one.fixes.replace(time_ns=one.fixes.time_ns + by * after),
            time_ns=one.time_ns + by * truth,
        )

    return change


def flapping(lasts_s: float, noise_m: float) -> Change:
    """RTK that falls to float and back; float errs by as much."""

    def change(one: Known, random: np.random.Generator) -> Known:
        fixes = one.fixes
        since = (fixes.time_ns - fixes.time_ns[0]) / 1e9
        spans = np.cumsum(random.exponential(lasts_s, int(since[-1] / lasts_s * 3) + 10))
        float_ = np.searchsorted(spans, since) % 2 == 1
        fixed = fixes.quality == int(Quality.RTK_FIXED)
        quality = np.where(float_ & fixed, int(Quality.RTK_FLOAT), fixes.quality)
        east, north, up = one.points()
        off = noise_m * _slow(since, 30.0, random) * (float_ & fixed)
        sigma = np.where(float_ & fixed, np.maximum(fixes.sigma_m, noise_m), fixes.sigma_m)
        return one._replace(fixes=fixes.replace(quality=quality, sigma_m=sigma)).at_points(
            east + off[0], north + off[1], up
        )

    return change


def _slow(since_s: Float64, lasts_s: float, random: np.random.Generator) -> Float64:
    """Slow errors [2, n] of unit size."""
    fading = np.exp(-np.diff(since_s, prepend=since_s[0]) / lasts_s)
    out, fresh = np.zeros((2, len(since_s))), random.normal(size=(2, len(since_s)))
    out[:, 0] = fresh[:, 0]
    for k in range(1, len(since_s)):
        out[:, k] = fading[k] * out[:, k - 1] + np.sqrt(1 - fading[k] ** 2) * fresh[:, k]
    return out


# --- what a gyro says


def says_nothing_from(share: float) -> Change:
    """A gyro that hands out zeros from there on."""

    def change(one: Known, _: np.random.Generator) -> Known:
        gyro = one.motion.gyro
        if gyro is None:
            return one
        rate = gyro.rate_rad_s.copy()
        rate[int(share * len(rate)) :] = 0.0
        return one._replace(motion=Motion(gyro=gyro._replace(rate_rad_s=rate)))

    return change


TRANSFORMATIONS: dict[str, Change] = {
    "as recorded": lambda one, _: one,
    "in the other gears, start declared": in_other_gears,
    "hole of 5 min, stood": joined(300.0),
    "hole of 40 s, 30 m on": joined(40.0, 30.0),
    "two receivers in one log": two_receivers,
    "clock + 1 s": clock_set(1.0),
    "clock - 1 s": clock_set(-1.0),
    "clock - 18 s": clock_set(-18.0),
    "flapping 4/5, 7 s, 0.3 m": flapping(7.0, 0.3),
    "gyro of zeros": says_nothing_from(0.0),
    "gyro dies in the middle": says_nothing_from(0.5),
}

HEAD = (
    f"{'':<36}{'':<34}{'epochs':>7}{'used':>8}{'median':>8}{'95 %':>8}{'> 90°':>8}{'gear':>8}"
    f"{'3 sigma':>9}{'place':>8}{'offset':>8}"
)


def line(name: str, one: Known) -> Iterator[str]:
    """The figures of a drive, then its notes."""
    start = f"{name:<36}{one.name[:33]:<34}{len(one.time_ns):>7}"
    try:
        found = estimate_poses(one.fixes, one.rig, one.datum, one.settings, one.motion)
    except FieldgridError as problem:
        yield f"{start}  refused: {problem}"
        return
    track = found.trajectory
    poses = poses_at(track, one.time_ns)
    used = poses.accepted & np.isfinite(one.heading_deg)
    start += f"{percent(float(poses.accepted.mean()) if len(poses.accepted) else np.nan, 1):>8}"
    if used.any():
        off = np.asarray(wrap_deg(poses.heading_deg - one.heading_deg))
        if one.offset and used.sum() > 20:
            off = np.asarray(wrap_deg(off - circular_median_deg(off[used])))
        off = np.abs(off)[used]
        geared = poses.accepted & (one.gear != 0) & (poses.gear != 0)
        gear = float(np.mean(poses.gear[geared] == one.gear[geared])) if geared.any() else np.nan
        placed = poses.accepted & np.isfinite(one.east_m)
        place = np.nan
        if placed.any():
            sigma = np.array([track.at(t).position_sigma_m for t in one.time_ns[placed].tolist()])
            away = np.hypot(poses.east_m - one.east_m, poses.north_m - one.north_m)[placed]
            place = float(np.mean(away <= THREE_SIGMA_2D * sigma))
        offset = found.report.offset
        start += (
            f"{np.median(off):>7.2f}°{np.percentile(off, 95):>7.2f}°{percent(np.mean(off > 90)):>8}"
            f"{percent(gear, 1):>8}{percent(np.mean(off <= 3.0 * poses.sigma_deg[used]), 1):>9}"
            f"{percent(place, 1):>8}{np.nan if offset is None else offset.median_sigmas:>8.2f}"
        )
    yield start
    for one in warnings(found.report):
        yield f"        - {one}"
    summary = found.report.conditioning
    yield f"        = {summary.as_dict()}"


def report(words: list[str], drives: list[str], notes: bool) -> Iterator[str]:
    """Lines of all transformations of all drives."""
    yield HEAD
    every = [one for make in (tractors, roads, vineyards, robots) for one in make()]
    for name, change in TRANSFORMATIONS.items():
        if words and not any(word in name for word in words):
            continue
        for one in every:
            if drives and not any(d in one.name for d in drives):
                continue
            lines = line(name, change(one, np.random.default_rng(11)))
            yield next(lines)
            if notes:
                yield from lines


def main() -> None:
    """Print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--drives", default="")
    parser.add_argument("--notes", action="store_true")
    given = parser.parse_args()
    for text in report(given.words, [d for d in given.drives.split(",") if d], given.notes):
        print(text, flush=True)


if __name__ == "__main__":
    main()

"""The rendered drives with something changed: `python -m benchmarks.variations [WORDS]`.

Each of the drives with exact truth is estimated as recorded, and with its fixes, gyro or mounting
changed as other receivers and vehicles would have them. A line tells how many poses are used, how
far they lie off the truth, and how many of them within three of their own sigmas. The camera's own
motion is left out, so that what is seen is what fixes and gyro can tell. WORDS pick variations
whose name holds one of them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.heading_honesty import RENDERED
from benchmarks.heading_scores import DATA, numbers, percent, poses_at, table
from fieldgrid.core import FieldgridError, Float64, Int64, Quality
from fieldgrid.geometry import Datum, FixColumns, Motion, Rig, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.recordings import open_recording

SEED = 7


class Recorded(NamedTuple):
    """What the estimate is given of a drive; datum and truth stay as they are."""

    fixes: FixColumns
    motion: Motion
    rig: Rig


Change = Callable[[Recorded, Datum, np.random.Generator], Recorded]


class Variation(NamedTuple):
    """One change; of a `lie` the drive states less than its error, so that its sigmas cannot hold:
    what is looked at is how wrong the poses get. Of `leaps` it is the solution that leaps unsaid,
    which sigmas are to hold."""

    name: str
    change: Change
    lie: bool = False
    leaps: bool = False


class Truth(NamedTuple):
    """n epochs of the grid origin, 10 Hz."""

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    gear: Int64


def read_truth(name: str) -> Truth:
    """The exact poses of a rendered drive."""
    columns = ("timestamp_utc_s", "cam_mid_E", "cam_mid_N", "heading_deg", "direction")
    text = table(DATA / name / "truth" / "poses_50hz.csv", columns)
    text = {column: values[::5] for column, values in text.items()}
    seconds, east, north, heading = (numbers(text[column]) for column in columns[:4])
    gears = [{"forward": 1, "reverse": -1}.get(word, 0) for word in text["direction"]]
    time_ns = np.round(seconds * 1e3).astype(np.int64) * 1_000_000
    return Truth(time_ns, east, north, heading, np.array(gears, dtype=np.int64))


def both(one: Change, other: Change) -> Change:
    """One change after the other."""
    return lambda drive, datum, random: other(one(drive, datum, random), datum, random)


# --- changes of the fixes


def of_fixes(make: Callable[[FixColumns, np.random.Generator], FixColumns]) -> Change:
    """A change of the fixes alone."""
    return lambda drive, _, random: drive._replace(fixes=make(drive.fixes, random))


def every(count: int) -> Change:
    """Fewer fixes."""
    return of_fixes(lambda fixes, _: fixes[::count])


def holes(hole_s: float, period_s: float) -> Change:
    """No fix for so long in each period."""

    def make(fixes: FixColumns, _: np.random.Generator) -> FixColumns:
        at_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
        return fixes[at_s % period_s < period_s - hole_s]

    return of_fixes(make)


def noise(white_m: float, slow_m: float, lasts_s: float = 60.0, *, stated: bool = True) -> Change:
    """More error of the positions, white and slow, which the stated sigma tells or not."""

    def make(drive: Recorded, datum: Datum, random: np.random.Generator) -> Recorded:
        fixes = drive.fixes
        step_s = np.diff(fixes.time_ns, prepend=fixes.time_ns[:1]) / 1e9
        off = random.normal(size=(2, len(fixes)))
        slow = off[:, 0]
        added = np.empty((2, len(fixes)))
        for k, fresh in enumerate(random.normal(size=(len(fixes), 2))):
            fading = np.exp(-step_s[k] / lasts_s)
            slow = fading * slow + fresh * np.sqrt(1.0 - fading**2)
            added[:, k] = slow_m * slow + white_m * off[:, k]
        east, north, up = datum.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
        lat, lon, height = datum.to_geodetic(east + added[0], north + added[1], up)
        sigma = np.hypot(fixes.sigma_m, np.hypot(white_m, slow_m)) if stated else fixes.sigma_m
        quality = np.where(fixes.quality == Quality.RTK_FIXED, Quality.DIFFERENTIAL, fixes.quality)
        return drive._replace(
            fixes=fixes.replace(
                lat_deg=lat,
                lon_deg=lon,
                height_m=height,
                sigma_m=sigma,
                quality=quality if stated else fixes.quality,
            )
        )

    return make


def leap(off_m: float, first: float, last: float, *, grows: bool = False) -> Change:
    """From one share of the drive's time to another the solution lies elsewhere, at once or bit by
    bit, and says nothing of it."""

    def make(drive: Recorded, datum: Datum, _: np.random.Generator) -> Recorded:
        fixes = drive.fixes
        share = (fixes.time_ns - fixes.time_ns[0]) / np.ptp(fixes.time_ns)
        inside = (share >= first) & (share < last)
        size_m = np.where(inside, off_m * ((share - first) / (last - first) if grows else 1.0), 0.0)
        east, north, up = datum.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
        lat, lon, _ = datum.to_geodetic(east + 0.8 * size_m, north + 0.6 * size_m, up)
        return drive._replace(fixes=fixes.replace(lat_deg=lat, lon_deg=lon))

    return make


def scaled_sigma(factor: float) -> Change:
    """The stated sigma is another."""
    return of_fixes(lambda fixes, _: fixes.replace(sigma_m=fixes.sigma_m * factor))


def unsaid(*columns: str) -> Change:
    """Columns that the log does not have."""

    def make(fixes: FixColumns, _: np.random.Generator) -> FixColumns:
        unknown = np.full(len(fixes), int(Quality.UNKNOWN))
        empty = np.full(len(fixes), np.nan)
        return fixes.replace(
            **{column: unknown if column == "quality" else empty for column in columns}
        )

    return of_fixes(make)


def stamps(late_s: float, jitter_s: float) -> Change:
    """Fixes whose stamps are late, and by not always the same."""

    def make(fixes: FixColumns, random: np.random.Generator) -> FixColumns:
        late = late_s + jitter_s * np.abs(random.normal(size=len(fixes)))
        time_ns = np.maximum.accumulate(fixes.time_ns + (late * 1e9).astype(np.int64))
        return fixes.replace(time_ns=time_ns)

    return of_fixes(make)


# --- changes of the vehicle


def no_gyro(drive: Recorded, _: Datum, __: np.random.Generator) -> Recorded:
    """Neither gyro nor accelerometer."""
    return drive._replace(motion=Motion())


def gyro(scale: float = 1.0, bias_dps: float = 0.0, noise_dps: float = 0.0) -> Change:
    """Another rate gyro; the attitude's own is left out with it."""

    def make(drive: Recorded, _: Datum, random: np.random.Generator) -> Recorded:
        one = drive.motion.gyro
        if one is None:
            return drive
        rate = one.rate_rad_s * scale + np.radians(bias_dps)
        rate = rate + np.radians(noise_dps) * random.normal(size=rate.shape)
        return drive._replace(motion=Motion(gyro=one._replace(rate_rad_s=rate)))

    return make


def stuck_gyro(first: float, last: float) -> Change:
    """One whose driver hands out the same sample from one share of the drive's time to another."""

    def make(drive: Recorded, _: Datum, __: np.random.Generator) -> Recorded:
        one = drive.motion.gyro
        if one is None:
            return drive
        share = (one.time_ns - one.time_ns[0]) / np.ptp(one.time_ns)
        inside = np.flatnonzero((share >= first) & (share < last))
        rate = one.rate_rad_s.copy()
        rate[inside] = rate[inside[0]]
        return drive._replace(motion=Motion(gyro=one._replace(rate_rad_s=rate)))

    return make


def spoilt_gyro(drive: Recorded, _: Datum, __: np.random.Generator) -> Recorded:
    """One of which a word in a thousand is spoilt."""
    one = drive.motion.gyro
    if one is None:
        return drive
    rate = one.rate_rad_s.copy()
    rate[7::1000] = 50.0
    return drive._replace(motion=Motion(gyro=one._replace(rate_rad_s=rate)))


def antenna(right_m: float, forward_m: float) -> Change:
    """An antenna that sits elsewhere than declared."""

    def make(drive: Recorded, _: Datum, __: np.random.Generator) -> Recorded:
        place = drive.rig.antenna
        moved = replace(
            place, right_m=place.right_m + right_m, forward_m=place.forward_m + forward_m
        )
        return drive._replace(rig=replace(drive.rig, antenna=moved))

    return make


VARIATIONS = (
    Variation("as recorded", lambda drive, _, __: drive),
    Variation("1 Hz", every(5)),
    Variation("0.5 Hz", every(10)),
    Variation("holes of 3 s in 10", holes(3.0, 10.0)),
    Variation("holes of 8 s in 20", holes(8.0, 20.0)),
    Variation("a hole of 20 s in 60", holes(20.0, 60.0)),
    Variation("+ 0.1 m white", noise(0.1, 0.0)),
    Variation("+ 0.3 m white", noise(0.3, 0.0)),
    Variation("+ 0.3 m slow, 20 s", noise(0.01, 0.3, 20.0)),
    Variation("+ 0.3 m slow, 120 s", noise(0.01, 0.3, 120.0)),
    Variation("+ 1 m slow, 120 s", noise(0.05, 1.0, 120.0)),
    Variation("sigma x 3", scaled_sigma(3.0)),
    Variation("sigma / 3", scaled_sigma(1.0 / 3.0), lie=True),
    Variation("no sigma", unsaid("sigma_m", "hdop")),
    Variation("no sigma, no quality", unsaid("sigma_m", "hdop", "quality")),
    Variation("no speed, no course", unsaid("speed_mps", "course_deg")),
    *(
        Variation(f"stamps + {late_s:g} s", stamps(late_s, 0.0), lie=True)
        for late_s in (0.05, 0.1, 0.2, 0.4)
    ),
    Variation("stamps late by 30 ms, varying", stamps(0.0, 0.03), lie=True),
    Variation("0.3 m slow, unsaid", noise(0.0, 0.3, 60.0, stated=False), lie=True),
    Variation("leaps by 0.5 m for good", leap(0.5, 0.5, 2.0), leaps=True),
    Variation("leaps by 3 m for good", leap(3.0, 0.5, 2.0), leaps=True),
    Variation("leaps by 3 m, and back", leap(3.0, 0.4, 0.7), leaps=True),
    Variation("drifts by 3 m, leaps back", leap(3.0, 0.2, 0.6, grows=True), leaps=True),
    Variation("no gyro, leaps by 3 m for good", both(no_gyro, leap(3.0, 0.5, 2.0)), leaps=True),
    Variation(
        "no gyro, drifts by 3 m, leaps back",
        both(no_gyro, leap(3.0, 0.2, 0.6, grows=True)),
        leaps=True,
    ),
    Variation(
        "no gyro, drifts by 10 m, leaps back",
        both(no_gyro, leap(10.0, 0.2, 0.6, grows=True)),
        leaps=True,
    ),
    Variation("no gyro", no_gyro),
    Variation("no gyro, 1 Hz", both(no_gyro, every(5))),
    Variation(
        "no gyro, no quality", lambda *a: unsaid("sigma_m", "hdop", "quality")(no_gyro(*a), *a[1:])
    ),
    Variation("no gyro, holes 8 s in 20", both(no_gyro, holes(8.0, 20.0))),
    Variation("gyro alone", gyro()),
    Variation("gyro 3 % too fast", gyro(scale=1.03)),
    Variation("gyro + 1 deg/s", gyro(bias_dps=1.0)),
    Variation("gyro noise 2 deg/s", gyro(noise_dps=2.0)),
    Variation("gyro upside down", gyro(scale=-1.0)),
    Variation("gyro stuck for a quarter", stuck_gyro(0.35, 0.6)),
    Variation("gyro with spoilt samples", spoilt_gyro),
    Variation("antenna 0.1 m aside", antenna(0.1, 0.0), lie=True),
    Variation("antenna 0.5 m aside", antenna(0.5, 0.0), lie=True),
    Variation("antenna 1 m ahead", antenna(0.0, 1.0), lie=True),
)


class Score(NamedTuple):
    """Shares of all epochs and of used ones, and how far these are off."""

    used: float
    off_m: Float64
    sigma_m: Float64
    off_deg: Float64
    sigma_deg: Float64
    gear: float


def score(drive: Recorded, datum: Datum, truth: Truth) -> Score:
    """Poses at the truth's instants."""
    found = estimate_poses(drive.fixes, drive.rig, datum, motion=drive.motion).trajectory
    poses = poses_at(found, truth.time_ns)
    used = poses.accepted
    sigma_m = np.array([found.at(at).position_sigma_m for at in truth.time_ns.tolist()])
    known = used & (truth.gear != 0) & (poses.gear != 0)
    return Score(
        float(used.mean()),
        np.hypot(poses.east_m - truth.east_m, poses.north_m - truth.north_m)[used],
        sigma_m[used],
        np.abs(wrap_deg(poses.heading_deg - truth.heading_deg))[used],
        poses.sigma_deg[used],
        float(np.mean(poses.gear[known] == truth.gear[known])) if known.any() else np.nan,
    )


THREE_SIGMA_2D = 3.44
"""Of two axes the circle that holds what three sigmas hold of one, 99.73 %."""

HEAD = (
    f"{'':<52}{'used':>8}{'median':>8}{'95 %':>8}{'sigma':>8}{'inside':>8}"
    f"{'heading':>9}{'95 %':>8}{'sigma':>8}{'inside':>8}{'gear':>8}"
)


def shares_inside(one: Score) -> tuple[float, float]:
    """Of the used poses, how many positions and headings are within three of their sigmas."""
    return (
        float(np.mean(one.off_m <= THREE_SIGMA_2D * one.sigma_m)),
        float(np.mean(one.off_deg <= 3.0 * one.sigma_deg)),
    )


def _line(name: str, one: Score) -> str:
    if not len(one.off_m):
        return f"{name:<52}{percent(one.used, 1):>8}"
    inside, turned = shares_inside(one)
    return (
        f"{name:<52}{percent(one.used, 1):>8}{np.median(one.off_m):>7.3f}m"
        f"{np.percentile(one.off_m, 95):>7.3f}m{np.median(one.sigma_m):>7.3f}m"
        f"{percent(inside, 1):>8}{np.median(one.off_deg):>8.2f}°"
        f"{np.percentile(one.off_deg, 95):>7.2f}°{np.median(one.sigma_deg):>7.2f}°"
        f"{percent(turned, 1):>8}{percent(one.gear, 1):>8}"
    )


def _summary(scores: list[Score]) -> str:
    """The median and the worst of some drives."""
    used = [one.used for one in scores]
    inside = [shares_inside(one) for one in scores if len(one.off_m)]
    positions, headings = (np.array(column) for column in zip(*inside, strict=True))
    gears = [one.gear for one in scores if not np.isnan(one.gear)]
    return (
        ", median and worst: "
        f"used {percent(np.median(used), 1)}, {percent(min(used), 1)}; "
        f"positions inside {percent(np.median(positions), 1)}, {percent(positions.min(), 1)}; "
        f"headings inside {percent(np.median(headings), 1)}, {percent(headings.min(), 1)}; "
        f"gear {percent(np.median(gears), 1)}, {percent(min(gears), 1)}"
    )


def report(words: list[str]) -> Iterator[str]:
    """A line for each drive, log and variation, and one for all that state their errors."""
    yield HEAD
    honest: list[Score] = []
    leapt: list[Score] = []
    refused = 0
    for variation in VARIATIONS:
        if words and not any(word in variation.name for word in words):
            continue
        for name, logs in RENDERED:
            if not (DATA / name).exists():
                yield f"{name}: absent"
                continue
            truth = read_truth(name)
            for log in logs:
                with open_recording(DATA / name, log) as drive:
                    recorded = Recorded(drive.fixes(), drive.motion(), drive.rig)
                    datum = drive.datum_hint
                line = f"{variation.name}: {name.removeprefix('vineyard_')} {log[5:-5]}"
                random = np.random.default_rng(SEED)
                try:
                    found = score(variation.change(recorded, datum, random), datum, truth)
                except FieldgridError as problem:
                    yield f"{line:<52}{problem!s:.100}"
                    refused += variation.leaps
                    continue
                yield _line(line, found)
                if variation.leaps:
                    leapt.append(found)
                elif not variation.lie:
                    honest.append(found)
    if honest:
        yield f"{len(honest)} drives that state their errors{_summary(honest)}"
    if leapt:
        yield f"{len(leapt)} drives that leap unsaid (and {refused} refused){_summary(leapt)}"


if __name__ == "__main__":
    for row in report(sys.argv[1:]):
        print(row, flush=True)

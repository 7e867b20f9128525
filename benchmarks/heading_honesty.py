"""What poses say of themselves: offsets from their fixes, position sigmas, and the doubt of gears.

Offsets are those of real and rendered drives. Sigmas are those of simulated ones, whose receiver
wanders with a stated sigma that grows, shrinks or jumps by three. Doubts are those of the garden
tractor's logs, whole and with holes, beside the heading of its two antennas.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from benchmarks import heading_road, heading_tractor
from benchmarks.heading_scores import DATA, percent
from benchmarks.heading_tractor import MOVING_MPS
from fieldgrid.core import Float64, GnssError, PoseSettings
from fieldgrid.geometry import FixColumns, Motion, wrap_deg
from fieldgrid.pipeline import estimate_drive
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import smooth_drive
from fieldgrid.poses.fused import conditioned
from fieldgrid.poses.report import FixOffset
from fieldgrid.recordings import open_recording
from tests.simulated import DATUM, SLALOM, Command, Drive, fixes_of, simulate

RENDERED = (
    ("vineyard_two_lanes", ("gnss_sf1.nmea", "gnss_rtk.nmea")),
    ("vineyard_two_lanes_later", ("gnss_sf1.nmea", "gnss_rtk.nmea")),
    ("vineyard_slope", ("gnss_sf1.nmea", "gnss_rtk.nmea")),
)


def report_offsets() -> Iterator[str]:
    """How far poses lie from accepted fixes; asked: a median of at most half the stated sigma.

    A pose that followed the white noise of its fixes would lie on them and be wrong, so what is
    asked is asked of the mean over 20 s.
    """
    yield f"{'':<44}{'mean':>8}{'median':>8}{'largest':>9}{'of stated':>11}{'over 20 s':>11}"
    yield f"{'asked':<44}{'':>25}{'':>11}{'<= 0.50':>11}"
    for path in sorted(heading_road.FOLDER.glob("*.csv")):
        fixes = heading_road.read_log(path, heading_road.TOLD[0]).fixes
        yield _offset_line(path.stem, fixes)
    for name, logs in RENDERED:
        for log in logs:
            if not (DATA / name).exists():
                yield f"{name}: absent"
                continue
            with open_recording(DATA / name, log) as drive:
                yield _line(f"{name}, {log}", estimate_drive(drive).report.offset)


def _offset_line(name: str, fixes: FixColumns) -> str:
    try:
        return _line(name, estimate_poses(fixes).report.offset)
    except GnssError as problem:
        return f"{name:<44}{problem!s:.60}"


def _line(name: str, offset: FixOffset | None) -> str:
    if offset is None:
        return f"{name:<44}{'-':>8}"
    mean_m = np.hypot(offset.mean_east_m, offset.mean_north_m)
    return (
        f"{name:<44}{mean_m:>7.3f}m{offset.median_m:>7.3f}m{offset.most_m:>8.3f}m"
        f"{offset.median_sigmas:>11.2f}{offset.lasting_sigmas:>11.2f}"
    )


# --- simulated receivers

ROWS = [
    Command(30.0, 1.5),
    *[
        command
        for side in (1.0, -1.0, 1.0, -1.0)
        for command in (Command(9.0, 1.2, 0.3 * side), Command(40.0, 1.5))
    ],
]


class Receiver(NamedTuple):
    """A receiver whose stated sigma goes from one value to another over the drive."""

    name: str
    first_m: float
    last_m: float
    sudden: bool = False


RECEIVERS = (
    Receiver("0.15 to 0.45 m", 0.15, 0.45),
    Receiver("0.45 to 0.15 m", 0.45, 0.15),
    Receiver("0.15 to 0.45 m at once", 0.15, 0.45, sudden=True),
    Receiver("0.02 to 0.06 m", 0.02, 0.06),
    Receiver("0.3 m throughout", 0.3, 0.3),
)
RATES_HZ, SEEDS, LASTS_S, WHITE_SHARE = (1.0, 5.0, 20.0), 6, (60.0, 300.0), 0.05


def report_sigmas() -> Iterator[str]:
    """Position errors in sigmas along each axis; asked: 99 % within three."""
    yield f"{'stated sigma':<26}{'rate':>6}{'lasts':>7}{'3 sigma':>9}{'offset':>9}{'worst':>9}"
    yield f"{'asked':<26}{'':>6}{'':>7}{'>= 99 %':>9}{'<= 0.5':>9}"
    drives = [simulate(ROWS, 20.0, speed_mps=1.5), simulate(SLALOM * 3, 110.0, speed_mps=1.5)]
    for receiver in RECEIVERS:
        for rate_hz in RATES_HZ:
            for lasts_s in LASTS_S:
                found = [
                    _errors(drive, receiver, rate_hz, lasts_s, seed)
                    for drive in drives
                    for seed in range(SEEDS)
                ]
                inside = [np.mean(np.abs(errors) <= 3.0) for errors, _ in found]
                offset = np.median([share for _, share in found])
                yield (
                    f"{receiver.name:<26}{rate_hz:>4.0f}Hz{lasts_s:>6.0f}s"
                    f"{percent(np.mean(inside), 1):>9}{offset:>9.2f}{percent(min(inside), 1):>9}"
                )


def _errors(
    drive: Drive, receiver: Receiver, rate_hz: float, lasts_s: float, seed: int
) -> tuple[Float64, float]:
    """Position errors along each axis in sigmas, and the median offset over what is stated."""
    fixes = fixes_of(drive, 1.0 / rate_hz)
    random = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, len(fixes))
    share = (share > 0.5).astype(np.float64) if receiver.sudden else share
    stated = receiver.first_m * (receiver.last_m / receiver.first_m) ** share
    fading = np.exp(-1.0 / rate_hz / lasts_s)
    wander = np.zeros((2, len(fixes)))
    wander[:, 0] = random.normal(size=2)
    for k in range(1, len(fixes)):
        fresh = random.normal(size=2) * np.sqrt(1.0 - fading**2)
        wander[:, k] = fading * wander[:, k - 1] + fresh
    noise = wander * stated + random.normal(size=wander.shape) * WHITE_SHARE * stated
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, _ = DATUM.to_geodetic(east + noise[0], north + noise[1], up)
    log = fixes.replace(lat_deg=lat, lon_deg=lon, sigma_m=stated, quality=np.full(len(fixes), 2))
    found = estimate_poses(log, None, DATUM)
    rows = found.fix_row[found.trajectory.accepted[found.fix_row]]
    truth = drive.at((found.trajectory.time_ns[rows] - fixes.time_ns[0]) / 1e9)
    off = np.stack(
        [
            found.trajectory.east_m[rows] - truth.east_m,
            found.trajectory.north_m[rows] - truth.north_m,
        ]
    )
    offset = found.report.offset
    share_of_stated = np.nan if offset is None else offset.lasting_sigmas
    return off / found.trajectory.position_sigma_m[rows], share_of_stated


# --- the doubt of gears

DECADES = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.02, 0.1, 0.5001)


def report_doubts() -> Iterator[str]:
    """Said doubt against observed, per decade: a heading is the other way round when it is more
    than 90° off that of the two antennas, while moving."""
    yield f"{'said doubt':<22}{'epochs':>9}{'said, mean':>12}{'wrong':>9}"
    said, wrong = [], []
    for harm in heading_tractor.HARMS:
        if not (harm.hole_s or harm.name.startswith("as recorded")):
            continue
        for log in heading_tractor.logs():
            one = heading_tractor.harmed(log, harm)
            fixes = heading_tractor.make_fixes(one.time_ns, one.lat_deg, one.lon_deg, one.quality)
            try:
                known = conditioned(fixes, PoseSettings())
            except GnssError:
                continue
            drive = smooth_drive(known.accepted, known.fixes.time_ns, Motion(), Axle(None))
            at = drive.fix >= 0
            row = np.searchsorted(one.time_ns, drive.time_ns[at])
            told = np.isfinite(one.truth_deg[row]) & (one.speed_mps[row] > MOVING_MPS)
            off = np.abs(wrap_deg(drive.heading_deg[at] - one.truth_deg[row]))[told]
            said.append(drive.doubt[at][told])
            wrong.append(off > 90.0)
    doubt, around = np.concatenate(said), np.concatenate(wrong)
    for low, high in pairwise(DECADES):
        inside = (doubt >= low) & (doubt < high)
        if inside.any():
            yield (
                f"{f'{low:g} to {min(high, 0.5):g}':<22}{inside.sum():>9}"
                f"{percent(doubt[inside].mean(), 4):>12}{percent(around[inside].mean(), 2):>9}"
            )

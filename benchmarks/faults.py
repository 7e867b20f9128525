"""What is told of a fault, by the sensors at hand: `python -m benchmarks.faults [--each] [WORDS]`.

Each fault is made in five drives of vehicles with an RTK receiver: by fixes alone, with a gyro,
with gyro and wheels, and with gyro and camera. What the report says of it is

named     by the finding of that fault, and nothing else is accused;
several   it is named beside another thing (`second`), or a doubt names it as one of several;
covered   nothing is accused, and at least 90 % of the accepted positions, and of the headings, are
          within three sigma;
refused   no pose can be used, and nothing names the fault;
wrong     another thing is accused, and not the fault;
unseen    nothing is accused, and the poses are off by more; `hidden` are those of which the report
          says that the drive would not show this fault.

A fault of a sensor that is not at hand is left out. Without any fault a drive is right where it is
covered. `--each` tells what is said of each drive that is not right; WORDS pick faults.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.heading_scores import percent
from benchmarks.random_drives import DATUM, NAMED, Case, moved, received, rig
from benchmarks.variations import THREE_SIGMA_2D, Recorded, antenna, leap, stamps
from fieldgrid.core import Bool, GnssError, Quality
from fieldgrid.geometry import wrap_deg
from fieldgrid.pipeline.checks.camera_scale import camera_scale, scale_findings
from fieldgrid.pipeline.checks.mirrored import mirror_findings
from fieldgrid.poses import Estimate, estimate_poses
from tests.scenes import paper_rig
from tests.simulated import Command, Drive, simulate, time_ns
from tests.told import warnings

GYRO, WHEELS, CAMERA = "gyro", "gyro, wheels", "gyro, camera"
SETS = ("fixes", GYRO, WHEELS, CAMERA)
Change = Callable[[Recorded, Drive], Recorded]
NO_ACCUSATION = ("no-pose", "lean-unknown")
"""Warnings that tell what follows, and of what is not known."""

FOLLOWS = "gyro-unused: The gyro fits the drive only once that is corrected"


class Vehicle(NamedTuple):
    """What drives rows, turns no tighter than a radius and slips sideways, ° per m/s²."""

    name: str
    speed_mps: float
    radius_m: float
    row_s: float
    rate_hz: float
    slip: float = 0.0


VEHICLES = (
    Vehicle("tractor", 1.5, 3.5, 20.0, 5.0),
    Vehicle("tractor", 2.0, 4.0, 15.0, 10.0),
    Vehicle("car", 6.0, 14.0, 10.0, 5.0, 0.1),
    Vehicle("car", 5.0, 10.0, 12.0, 10.0, 0.3),
    Vehicle("robot", 0.8, 1.2, 20.0, 10.0),
)


def driven(vehicle: Vehicle, random: np.random.Generator) -> Drive:
    """Rows, headland turns to both sides, and one turn in reverse."""
    speed, bend = vehicle.speed_mps, 1.0 / vehicle.radius_m
    slow, half_turn_s = speed / 2.0, np.pi * vehicle.radius_m / speed
    back = [Command(half_turn_s, slow, bend), Command(half_turn_s, -slow, -bend)]
    back += [Command(half_turn_s, slow, bend)]
    turns = ([Command(half_turn_s, speed, bend)], back, [Command(half_turn_s, speed, -bend)])
    commands = [Command(vehicle.row_s, speed)]
    for turn in turns:
        weave = float(random.uniform(-0.03, 0.03)) * bend * 3.0
        commands += [*turn, Command(vehicle.row_s / 2.0, speed, weave)]
        commands += [Command(float(random.uniform(0.5, 0.8)) * vehicle.row_s, speed, -weave)]
    drive = simulate(commands, float(random.uniform(0.0, 360.0)), speed_mps=speed)
    aside = drive.curvature_per_m * drive.speed_mps * np.abs(drive.speed_mps)
    return drive._replace(heading_rad=drive.heading_rad + np.radians(vehicle.slip) * aside)


# --- faults


def _shares(seconds: float, drive: Drive) -> float:
    """So many seconds as a share of the drive."""
    return seconds / float(drive.time_s[-1])


def late_gyro(late_s: float) -> Change:
    """A gyro with late stamps."""

    def make(recorded: Recorded, _: Drive) -> Recorded:
        gyro = recorded.motion.gyro
        late = gyro._replace(time_ns=gyro.time_ns + round(late_s * 1e9))
        return recorded._replace(motion=recorded.motion._replace(gyro=late))

    return make


def turned_gyro(scale: float, dead: tuple[float, float] = (1.0, 1.0)) -> Change:
    """A gyro of another scale, or sense, that says the same from one share of the drive to
    another."""

    def make(recorded: Recorded, _: Drive) -> Recorded:
        gyro = recorded.motion.gyro
        first, stop = (round(share * len(gyro.time_ns)) for share in dead)
        rate = scale * gyro.rate_rad_s
        rate[first:stop] = rate[first : first + 1]
        return recorded._replace(
            motion=recorded.motion._replace(gyro=gyro._replace(rate_rad_s=rate))
        )

    return make


def late_images(late_s: float) -> Change:
    """Images with late stamps."""

    def make(recorded: Recorded, _: Drive) -> Recorded:
        steps, by = recorded.motion.steps, round(late_s * 1e9)
        late = steps._replace(start_ns=steps.start_ns + by, stop_ns=steps.stop_ns + by)
        return recorded._replace(motion=recorded.motion._replace(steps=late))

    return make


def longer_steps(scale: float) -> Change:
    """A camera that measures longer distances."""

    def make(recorded: Recorded, _: Drive) -> Recorded:
        steps = recorded.motion.steps
        longer = steps._replace(forward_m=scale * steps.forward_m, right_m=scale * steps.right_m)
        return recorded._replace(motion=recorded.motion._replace(steps=longer))

    return make


def turned_wheels(recorded: Recorded, _: Drive) -> Recorded:
    """Wheels whose sign is turned round."""
    wheels = recorded.motion.wheels
    turned = wheels._replace(speed_mps=-wheels.speed_mps)
    return recorded._replace(motion=recorded.motion._replace(wheels=turned))


def course_as_heading(recorded: Recorded, drive: Drive) -> Recorded:
    """Recorded headings that are the way in which the vehicle moves; none at rest."""
    course = np.arctan2(np.gradient(drive.east_m), np.gradient(drive.north_m))
    with_course = drive._replace(heading_rad=np.unwrap(course))
    at = with_course.at((recorded.fixes.time_ns - time_ns(np.zeros(1))[0]) / 1e9)
    noise = np.random.default_rng(3).normal(0.0, 0.5, len(at.time_s))
    heading = np.where(
        np.abs(at.speed_mps) > 0.2, wrap_deg(np.degrees(at.heading_rad) + noise), np.nan
    )
    fixes = recorded.fixes.replace(
        heading_deg=heading, heading_sigma_deg=np.where(np.isfinite(heading), 0.5, np.nan)
    )
    return recorded._replace(fixes=fixes)


def always(change: Callable[[Recorded, Any, np.random.Generator], Recorded]) -> Change:
    """A variation that is the same of all drives."""
    return lambda recorded, _: change(recorded, DATUM, np.random.default_rng(5))


def bursts(recorded: Recorded, drive: Drive) -> Recorded:
    """Twice the solution lies 0.4 m off for 10 s."""
    lasts = _shares(10.0, drive)
    for first, off_m in ((0.25, 0.4), (0.6, -0.4)):
        recorded = always(leap(off_m, first, first + lasts))(recorded, drive)
    return recorded


def false_fixes(recorded: Recorded, drive: Drive) -> Recorded:
    """Four fixes lie 1 m off."""
    one = 0.99 / len(recorded.fixes)
    for first in (0.15, 0.4, 0.55, 0.8):
        recorded = always(leap(1.0, first, first + one))(recorded, drive)
    return recorded


def mirrored(recorded: Recorded, _: Drive) -> Recorded:
    """Longitudes that lost their sign."""
    fixes = recorded.fixes
    return recorded._replace(fixes=fixes.replace(lon_deg=2.0 * DATUM.lon_deg - fixes.lon_deg))


class Fault(NamedTuple):
    """A fault, the sets of sensors that can have it, how its own finding reads, and how those read
    that name it as one of several: patterns of "code: sentence remedy"."""

    name: str
    sets: Sequence[str]
    change: Change
    named: str
    among: str = "$^"

    def names(self, text: str) -> bool:
        """Whether it is this fault that is told, or one of those that are."""
        return bool(re.match(self.named, text) or re.match(self.among, text))


STAMPS = r"antenna-or-stamps|contradiction:.*Check.*the stamps|gyro-unused:.*its stamps"
PLACE = r"antenna-or-stamps|contradiction:.*Check.*(its place ahead|the place of the antenna)"
NOTHING = "$^"
FAULTS = (
    Fault("none", SETS, lambda recorded, _: recorded, NOTHING),
    Fault(
        "antenna 0.4 m aside",
        SETS,
        always(antenna(0.4, 0.0)),
        r"antenna-place:.*farther left",
        r"contradiction:.*Check.*the (antenna's place aside|place of the antenna)",
    ),
    Fault(
        "antenna 0.5 m ahead",
        SETS,
        always(antenna(0.0, -0.5)),
        r"antenna-place:.*farther ahead",
        f"{PLACE}|gyro-unused:.*how far the antenna",
    ),
    Fault(
        "fixes 0.2 s late",
        SETS,
        always(stamps(0.2, 0.0)),
        r"fixes-stamped:.* late|clock-offset:.*--gnss-offset",
        STAMPS,
    ),
    Fault("gyro 1 s late", (GYRO, WHEELS), late_gyro(1.0), r"fixes-stamped:.* early", STAMPS),
    Fault(
        "images 0.5 s late",
        (CAMERA,),
        late_images(0.5),
        r"clock-offset:.*--time-offset",
        r"frames-misplaced",
    ),
    Fault(
        "gyro of 1.05 the rate",
        (GYRO, WHEELS),
        turned_gyro(1.05),
        r"gyro-scale:.*too large",
        r"gyro-unused:.*its unit",
    ),
    Fault("camera of 1.1 the way", (CAMERA,), longer_steps(1.1), r"scale:"),
    Fault(
        "gyro turned",
        (GYRO, WHEELS, CAMERA),
        turned_gyro(-1.0),
        r"gyro-unused:(?!.*mirrored)",
        r"gyro-unused:",
    ),
    Fault(
        "gyro dead for a fifth",
        (GYRO, WHEELS, CAMERA),
        turned_gyro(1.0, (0.2, 0.4)),
        r"gyro-samples:",
        r"gyro-unused:",
    ),
    Fault("wheels turned", (WHEELS,), turned_wheels, r"wheels-turned:"),
    Fault(
        "heading that is the course",
        SETS,
        course_as_heading,
        r"heading-recorded:.*course",
        r"(heading-recorded|refused):.*recorded heading",
    ),
    Fault("bursts of 0.4 m for 10 s", SETS, bursts, r"leaps:", r"drift:"),
    Fault("drift of 0.5 m", SETS, always(leap(1.0, 0.0, 2.0, grows=True)), r"drift:", r"leaps:"),
    Fault("false fixes of 1 m", SETS, false_fixes, r"leaps:"),
    Fault("fixes mirrored", (GYRO, WHEELS, CAMERA), mirrored, r"mirrored:", r".*mirror"),
)
HIDDEN = {
    "antenna 0.4 m aside": NAMED["antenna aside"],
    "antenna 0.5 m ahead": NAMED["antenna ahead"],
    "fixes 0.2 s late": NAMED["late stamps"],
    "drift of 0.5 m": NAMED["drift"],
}

# --- what is told of them


class Found(NamedTuple):
    """What is said of a fault by a set of sensors in a drive: its class, the accusations, and
    whether the report says that the drive would not show it."""

    fault: Fault
    sensors: str
    outcome: str
    told: tuple[str, ...]
    hidden: bool = False

    @property
    def has_second(self) -> bool:
        """Whether another thing is accused beside the fault."""
        wrong = [not self.fault.names(text) for text in self.told]
        return self.outcome == "several" and any(wrong)


def found(fault: Fault, sensors: str, seed: int) -> Found:
    """The report on one drive."""
    vehicle, random = VEHICLES[seed], np.random.default_rng([47, seed])
    drive = driven(vehicle, random)
    case = Case(
        *(seed, vehicle.name, sensors, "right", Quality.RTK_FIXED),
        *(vehicle.rate_hz, 0.3, 60.0, "none", 0.0),
    )
    recorded = Recorded(
        received(case, drive, random),
        moved(case, drive, random),
        replace(rig(), sensor=paper_rig().sensor),
    )
    recorded = fault.change(recorded, drive)
    try:
        estimate = estimate_poses(recorded.fixes, recorded.rig, DATUM, motion=recorded.motion)
    except GnssError as problem:
        told: tuple[str, ...] = (f"refused: {problem}",)
        outcome = _outcome(fault, told, np.zeros(0, np.bool_))
        return Found(fault, sensors, outcome, told)
    told = tuple(_told(estimate, recorded))
    outcome = _outcome(fault, told, _inside(estimate, drive))
    hidden = HIDDEN.get(fault.name) in estimate.report.unseen
    return Found(fault, sensors, outcome, told, hidden)


def _told(estimate: Estimate, recorded: Recorded) -> Iterator[str]:
    """What a build says is wrong; of a mirrored drive nothing else, since all of it may follow."""
    track, steps = estimate.trajectory, recorded.motion.steps
    drive: Any = SimpleNamespace(motion=lambda: recorded.motion)
    mirror = list(mirror_findings(drive, track, steps))
    scale = scale_findings(camera_scale(steps, track, heights_told=True), recorded.rig)
    for one in mirror or (*warnings(estimate.report), *scale):
        text = f"{one.code}: {one}"
        if one.code not in NO_ACCUSATION and not text.startswith(FOLLOWS):
            yield text


def _inside(estimate: Estimate, drive: Drive) -> Bool:
    """Which accepted positions and headings are within three sigma [poses, 2]."""
    track = estimate.trajectory
    used = estimate.fix_row[track.accepted[estimate.fix_row]]
    truth = drive.at((track.time_ns[used] - time_ns(np.zeros(1))[0]) / 1e9)
    off_m = np.hypot(track.east_m[used] - truth.east_m, track.north_m[used] - truth.north_m)
    off_deg = np.abs(wrap_deg(track.heading_deg[used] - np.degrees(truth.heading_rad)))
    return np.stack(
        [
            off_m <= THREE_SIGMA_2D * track.position_sigma_m[used],
            off_deg <= 3.0 * track.heading_sigma_deg[used],
        ],
        axis=1,
    )


def _outcome(fault: Fault, told: Sequence[str], inside: Bool) -> str:
    """The class of what is said."""
    if told and all(re.match(fault.named, text) for text in told):
        return "named"
    if any(map(fault.names, told)):
        return "several"
    if not len(inside):
        return "refused"
    if told:
        return "wrong"
    return "covered" if (inside.mean(axis=0) >= 0.9).all() else "unseen"


OUTCOMES = ("named", "several", "covered", "refused", "wrong", "unseen")


def _line(name: str, some: Sequence[Found]) -> str:
    of = Counter(one.outcome for one in some)
    counts = "".join(f"{of[outcome]:>9}" for outcome in OUTCOMES)
    hidden = sum(one.hidden for one in some if one.outcome == "unseen")
    return f"{name:<44}{len(some):>7}{counts}{sum(one.has_second for one in some):>9}{hidden:>9}"


def report(words: Sequence[str], *, each: bool = False) -> Iterator[str]:
    """A line a fault and set of sensors, and the shares over all faults."""
    heads = "".join(f"{name:>9}" for name in (*OUTCOMES, "second", "hidden"))
    yield f"{'':<44}{'drives':>7}{heads}"
    many: list[Found] = []
    for fault in FAULTS:
        if words and not any(word in fault.name for word in words):
            continue
        for sensors in fault.sets:
            some = [found(fault, sensors, seed) for seed in range(len(VEHICLES))]
            yield _line(f"{fault.name}; {sensors}", some)
            many += some if fault.name != "none" else []
            for vehicle, one in zip(VEHICLES, some, strict=True):
                if each and one.outcome not in ("named", "covered"):
                    yield f"    {vehicle.name}: {one.outcome}: {' | '.join(one.told)}"
    for sensors in SETS:
        if some := [one for one in many if one.sensors == sensors]:
            yield _line(f"all faults; {sensors}", some)
    if many:
        yield _line("all faults", many)
        yield _shares_of("all", many)
        shown = [one for one in many if not (one.outcome == "unseen" and one.hidden)]
        yield _shares_of("those that are not hidden", shown)


def _shares_of(name: str, some: Sequence[Found]) -> str:
    of = Counter(one.outcome for one in some)
    right = sum(of[outcome] for outcome in ("named", "several", "covered")) / len(some)
    return (
        f"{name}: right or covered {percent(right, 1)}, wrong accusation "
        f"{percent(of['wrong'] / len(some), 1)} of {len(some)}"
    )


if __name__ == "__main__":
    arguments = sys.argv[1:]
    picked = [word for word in arguments if word != "--each"]
    for line in report(picked, each="--each" in arguments):
        print(line, flush=True)

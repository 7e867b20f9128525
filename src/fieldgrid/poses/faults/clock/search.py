"""The camera's motion beside a drive: at which offset of the clocks it fits, and how well."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Steps, wrap_deg
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.camera_turns import FEWEST_STEPS
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.batch import refine
from fieldgrid.poses.smoother.rounds import OUTLIER_FREEDOM

WIDEST_S, COARSE_S = 2.5, 0.05
"""Offsets are tried up to the widest, this far apart; a wider scan may ask for more."""

FINE_S, FINE_REACH_S = 0.01, 0.3
"""About the best of them offsets are tried at this distance, up to this far away."""

DISTANCE_SIGMA_M, TURN_SIGMA_DEG = 0.05, 0.5
"""How far the drive and a camera's step differ with the best of clocks, before that is known."""

LEAST_TURN_DEG = 0.05
"""With a gyro the turns agree much better than without one, but not better than this."""

PARTS = 8
"""Neighbouring steps share the errors of the drive, so the scatter of the offset is taken from
what it would be without each of this number of stretches."""

FARTHEST_S, SCAN_S = 60.0, 0.25
"""Where nothing near fits, offsets are tried up to the farthest: GPS time is 18 s off UTC."""

MOST_SIGMA_S = 0.1
"""A drive that does not tell the offset better than this does not tell it."""

CLEAR_LEAD = 16.0
"""Least increase of the sum of squares at every other offset: four sigmas. On an even drive, noise
alone makes a lowest place."""

OFF_SIGMAS, FULL_SIGMAS, CONTRADICTED_SHARE, CONTRADICTED_LEAST = 3.0, 5.0, 0.1, 3
"""A step of the camera counts against the drive from the first of these distances on, in sigmas,
with its square, and in full from the second on. Images are not of their stamps when this share of
the steps counts, and this number of them. In honest drives, KITTI and the rendered ones, none
does."""

SURE_TURN_DEG = 4.0
"""Where the drive does not know its turn over a step better than this, it contradicts no camera."""

PLACING_SHARE, LEAST_STEP_M, MOST_SCALE = 0.1, 0.1, 2.0
"""By what share of its length a step may be off beside the scale of most when the calibration is:
other checks tell that. Shorter steps tell no scale, which is at most the last of these."""

LEAST_SIGMA_S = 0.003
"""What no drive tells: exposure, and the time between two lines of a sensor."""

LEAST_OFFSET_S = 0.02
"""At walking pace, a smaller offset is 4 cm."""


class ClockOffset(NamedTuple):
    """`offset_s` ± `sigma_s` is to be added to image time stamps, beyond what the rig declares
    already, to give the receiver's time; from `steps` motions of the camera. `misfit` is the
    mean squared distance of a step from the drive, in sigmas that are usual. With `gyro_too` the
    gyro goes with the images, as the turns of both tell: then it is the fixes that are off."""

    offset_s: float
    sigma_s: float
    steps: int
    misfit: float
    gyro_too: bool = False

    @property
    def is_certain(self) -> bool:
        """Whether there is an offset, and large enough to matter."""
        return abs(self.offset_s) >= max(3.0 * self.sigma_s, LEAST_OFFSET_S)


class MotionContradiction(NamedTuple):
    """Of `steps` motions of the camera where the drive is sure of itself, `off` are not those of
    the drive, at any offset of the clock that was found, and count as `weight` that are far off.
    With `gyro_too` the gyro turns as the images do, so it is the fixes that are of other
    moments."""

    off: int
    weight: float
    steps: int
    gyro_too: bool = False

    @property
    def is_certain(self) -> bool:
        """Whether images and fixes are of other moments, and not by one offset."""
        return self.weight >= max(CONTRADICTED_LEAST, CONTRADICTED_SHARE * self.steps)


class ClockSearch:
    """A drive without its camera, beside which the camera's motion can be laid."""

    def __init__(self, drive: DriveEstimate, steps: Steps, axle: Axle) -> None:
        """The path of `drive` as it is without its camera. `steps` holds at least one."""
        found, (lever_m, ahead_m) = drive.smoothed, axle.frame()
        if len(drive.measured.step):
            no_steps = np.zeros(len(drive.measured.step), np.bool_)
            found = refine(found, drive.measured.with_steps(no_steps), lever_m, ahead_m)
        self._steps, self._ahead_m = steps, ahead_m
        self._time_ns = drive.time_ns
        self._east_m, self._north_m, self._phi_rad = found.state[:, : model.PHI + 1].T
        self._place_sigma_m = found.relative_sigma_m
        self._heading_sigma_deg = np.degrees(found.heading_sigma_rad)

    def misfit(self, offset_s: float) -> float:
        """The mean squared distance of the steps from the drive with this offset; infinite
        when most of them would lie outside of it."""
        steps = self._inside(offset_s, 0.0)
        if len(steps.start_ns) < max(FEWEST_STEPS, len(self._steps.start_ns) // 2):
            return float("inf")
        return float(self._squared(steps, offset_s).mean())

    def contradiction(self, offset_s: float) -> MotionContradiction:
        """How many steps are not of the drive with this offset, whatever its own errors and the
        camera's scale."""
        steps = self._in_metres(self._inside(offset_s, 0.0), offset_s)
        ahead, right, turn = self._differences(steps, offset_s)
        place_m, heading_deg = self._drive_sigmas(steps, offset_s)
        length_m = np.hypot(steps.forward_m, steps.right_m)
        distance_2 = place_m**2 + (PLACING_SHARE * length_m) ** 2 + steps.sigma_m**2
        turn_2 = heading_deg**2 + steps.sigma_deg**2
        squared = (ahead**2 + right**2) / distance_2 + turn**2 / turn_2
        sure = heading_deg < SURE_TURN_DEG
        off = sure & (squared > OFF_SIGMAS**2)
        weight = np.minimum(squared[off] / FULL_SIGMAS**2, 1.0).sum()
        return MotionContradiction(int(off.sum()), float(weight), int(sure.sum()))

    def by_step(self, offsets_s: Float64) -> tuple[Steps, Float64]:
        """The steps that lie within the drive at all of these offsets [o], and the squared distance
        of each from it [o, steps], in sigmas of both."""
        steps = self._inside(0.0, float(np.abs(offsets_s).max()))
        sigmas = self._drive_sigmas(steps, 0.0)
        squared = [self._squared(steps, float(offset_s), *sigmas) for offset_s in offsets_s]
        return steps, np.array(squared).reshape(len(offsets_s), len(steps.start_ns))

    def best(self, near_s: float = 0.0, reach_s: float = WIDEST_S) -> ClockOffset | None:
        """The offset within `reach_s` of `near_s` at which the camera's motion fits the drive;
        None when the drive is too even to tell."""
        steps = self._inside(near_s, reach_s)
        count = len(steps.start_ns)
        if count < FEWEST_STEPS:
            return None
        offsets_s = near_s + np.arange(-reach_s, reach_s + COARSE_S / 2.0, COARSE_S)
        coarse = np.array([self._squared(steps, offset).sum() for offset in offsets_s])
        at = int(np.argmin(coarse))
        if at in (0, len(coarse) - 1):
            return None
        # How far these steps and the drive differ along an axis and in the turn, by medians.
        ahead, right, turn = self._differences(steps, float(offsets_s[at]))
        distance_m = 1.4826 * float(np.median(np.abs(np.concatenate([ahead, right]))))
        turn_deg = 1.4826 * float(np.median(np.abs(turn)))
        # Larger ones than usual are no reason to believe the drive more in other respects.
        sigmas = (
            max(distance_m, DISTANCE_SIGMA_M),
            min(max(turn_deg, LEAST_TURN_DEG), TURN_SIGMA_DEG),
        )
        fine_s = offsets_s[at] + np.arange(-FINE_REACH_S, FINE_REACH_S + FINE_S / 2.0, FINE_S)
        fine = np.array([self._squared(steps, offset, *sigmas) for offset in fine_s])
        lowest = _lowest(fine_s, fine.sum(axis=1))
        if lowest is None:
            return None
        offset_s, bend, least = lowest
        # A misfit of one a step is as it should be; a larger one tells of larger errors.
        told_s = math.sqrt(2.0 / bend * max(1.0, least / count))
        sigma_s = math.hypot(told_s, _by_parts(fine_s, fine), LEAST_SIGMA_S)
        elsewhere = np.abs(offsets_s - offset_s) > max(2.0 * COARSE_S, 5.0 * sigma_s)
        lead = coarse[elsewhere].min(initial=np.inf) - coarse[at]
        if sigma_s > MOST_SIGMA_S or lead < CLEAR_LEAD:
            return None
        return ClockOffset(offset_s, sigma_s, count, float(coarse[at]) / count)

    def rough(self) -> float | None:
        """Where the steps fit best within a minute, near or far; None where there are too few."""
        scan_s = np.arange(-FARTHEST_S, FARTHEST_S + SCAN_S / 2.0, SCAN_S)
        misfits = [self.misfit(offset) for offset in scan_s]
        at = int(np.argmin(misfits))
        return float(scan_s[at]) if np.isfinite(misfits[at]) else None

    def tells(self, offset_s: float) -> bool:
        """Whether the steps fit clearly worse a second and more beside this offset: along an even
        way they fit at any."""
        beside_s = np.arange(1.0, WIDEST_S + SCAN_S, SCAN_S)
        beside = [self.misfit(offset_s + by_s) for by_s in (*-beside_s, *beside_s)]
        lead = min(beside) - self.misfit(offset_s)
        return lead * len(self._inside(offset_s, 0.0).start_ns) > CLEAR_LEAD

    def _in_metres(self, steps: Steps, offset_s: float) -> Steps:
        """Steps of which most are as long as those of the drive."""
        long = np.abs(steps.forward_m) > LEAST_STEP_M
        if not long.any():
            return steps
        ahead = self._differences(steps, offset_s)[0]
        scale = 1.0 + float(np.median(ahead[long] / steps.forward_m[long]))
        # A calibration is off by less; images from last to first go the other way.
        scale = min(max(scale, 1.0 / MOST_SCALE), MOST_SCALE)
        return steps._replace(forward_m=scale * steps.forward_m, right_m=scale * steps.right_m)

    def _inside(self, near_s: float, margin_s: float) -> Steps:
        times_ns, steps = self._time_ns, self._steps
        shift_ns, margin_ns = round(near_s * 1e9), int(margin_s * 1e9)
        first, last = times_ns[0] + margin_ns, times_ns[-1] - margin_ns
        keep = (steps.start_ns + shift_ns >= first) & (steps.stop_ns + shift_ns <= last)
        return Steps(*(column[keep] for column in steps))

    def _drive_sigmas(self, steps: Steps, offset_s: float) -> tuple[Float64, Float64]:
        """How far each step and the drive may differ by the drive's own errors at its two ends, and
        by the best of clocks: metres along an axis, degrees."""
        ends_ns = np.stack([steps.start_ns, steps.stop_ns]) + round(offset_s * 1e9)
        place_m = np.interp(ends_ns, self._time_ns, self._place_sigma_m)
        heading_deg = np.interp(ends_ns, self._time_ns, self._heading_sigma_deg)
        return (
            np.sqrt((place_m**2).sum(axis=0) + DISTANCE_SIGMA_M**2),
            np.sqrt((heading_deg**2).sum(axis=0) + TURN_SIGMA_DEG**2),
        )

    def _squared(
        self,
        steps: Steps,
        offset_s: float,
        distance_sigma_m: Float64 | float = DISTANCE_SIGMA_M,
        turn_sigma_deg: Float64 | float = TURN_SIGMA_DEG,
    ) -> Float64:
        """The squared distance of each step from the drive, in sigmas; outliers count the less
        the farther they lie (a bound would kink the sum, and shift its lowest place)."""
        ahead, right, turn = self._differences(steps, offset_s)
        squared = (np.hypot(ahead, right) / np.hypot(steps.sigma_m, distance_sigma_m)) ** 2
        squared += (turn / np.hypot(steps.sigma_deg, turn_sigma_deg)) ** 2
        robust: Float64 = OUTLIER_FREEDOM * np.log1p(squared / OUTLIER_FREEDOM)
        return robust

    def _differences(self, steps: Steps, offset_s: float) -> tuple[Float64, Float64, Float64]:
        """What the drive has more than each step: metres forward and right, degrees of turn."""
        shift = round(offset_s * 1e9)
        e0, n0, phi0 = self._pose_at(steps.start_ns + shift)
        e1, n1, phi1 = self._pose_at(steps.stop_ns + shift)
        sin, cos = np.sin(np.radians(phi0)), np.cos(np.radians(phi0))
        forward = (e1 - e0) * sin + (n1 - n0) * cos
        right = (e1 - e0) * cos - (n1 - n0) * sin
        turn = np.asarray(wrap_deg(phi1 - phi0 - steps.turn_deg))
        return forward - steps.forward_m, right - steps.right_m, turn

    def _pose_at(self, time_ns: Int64) -> tuple[Float64, Float64, Float64]:
        """East, north and heading (unwrapped, degrees) of the grid origin."""
        phi = np.interp(time_ns, self._time_ns, self._phi_rad)
        east = np.interp(time_ns, self._time_ns, self._east_m) + self._ahead_m * np.sin(phi)
        north = np.interp(time_ns, self._time_ns, self._north_m) + self._ahead_m * np.cos(phi)
        return east, north, np.degrees(phi)


def _lowest(offsets_s: Float64, sums: Float64) -> tuple[float, float, float] | None:
    """Where a sum is lowest, by a parabola over its surroundings: the offset, the second
    derivative, the least value; None where it has no lowest place inside."""
    at = int(np.argmin(sums))
    around = slice(max(at - 5, 0), at + 6)
    if at in (0, len(sums) - 1):
        return None
    middle_s = float(offsets_s[at])
    bend, slope, _ = np.polyfit(offsets_s[around] - middle_s, sums[around], 2)
    if bend <= 0.0:
        return None
    return middle_s - float(slope / (2.0 * bend)), float(2.0 * bend), float(sums[at])


def _by_parts(offsets_s: Float64, squared: Float64) -> float:
    """The 1-sigma error of the lowest place of a sum over steps, by leaving out stretches of
    them (the jackknife). `squared` is [offsets, steps]."""
    total, found = squared.sum(axis=1), []
    for part in np.array_split(np.arange(squared.shape[1]), PARTS):
        lowest = _lowest(offsets_s, total - squared[:, part].sum(axis=1))
        if lowest is None:
            return float("inf")
        found.append(lowest[0])
    return float(np.sqrt((PARTS - 1) / PARTS * np.sum((np.array(found) - np.mean(found)) ** 2)))

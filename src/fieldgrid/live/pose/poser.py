"""Poses and the window around the vehicle, again with each frame: a thread of its own.

Estimates are made beside it; a frame that is newer than they are is placed by the camera's step,
or by gyro and wheels.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fieldgrid.core import BuildSettings, FieldgridError, shortened
from fieldgrid.geometry import Datum, Fix, FixColumns, GridSpec, Pose, Rig, Status, Trajectory
from fieldgrid.live.options import LiveOptions
from fieldgrid.live.perceiver import PerceivedFrame
from fieldgrid.live.pose.dead_reckoning import DeadReckoning
from fieldgrid.live.pose.estimator import EstimateResult, Estimator, estimate_now
from fieldgrid.live.pose.fixed_lag import (
    EstimateInputs,
    FixedLagSmoother,
    pose_at,
    unknown_pose,
)
from fieldgrid.live.pose.propagation import PropagatedPose, pose_now
from fieldgrid.live.pose.repeats import Repeats
from fieldgrid.live.pose.running_tilt import RunningTilt, lean_advice, square_to_ground
from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.live.pose.stamps import Stamps, StampVerdict
from fieldgrid.live.results import LiveEvent, LivePose, LiveResult, LiveWindow, What, WindowDoubt
from fieldgrid.live.window import MOVES_M, PlacedGrid, RollingWindow
from fieldgrid.maps import Costmap, Transfer
from fieldgrid.pipeline import cell_budget, no_ground
from fieldgrid.poses import Attitude, Estimate, Gate
from fieldgrid.recordings import PoseBody

EVERY_S = 0.2
"""Period of estimates without a new frame."""

SILENT_S = 3.0
"""Without a frame or a pose for longer, the window is not to be trusted."""

GIVEN_UP_S = 12.0
"""Time for which a frame without fixes after it waits for them."""

MOST_INBOX = 100_000
SAID_AGAIN_S = 5.0


_PoserInput = Fix | PerceivedFrame | EstimateResult | tuple[str, Rows]


class Poser:
    """Takes what sensors and frames say, and tells poses, the window and what is doubtful."""

    def __init__(
        self,
        rig: Rig,
        settings: BuildSettings,
        datum: Datum | None,
        options: LiveOptions,
        tell: Callable[[LiveResult], None],
        body: PoseBody | None = None,
        is_levelling: Callable[[], bool] = lambda: True,
    ) -> None:
        """`is_levelling` tells whether grids are level where the drive tells how its vehicle
        leans."""
        self._rig, self._options, self._tell = rig, options, tell
        self._trailing = FixedLagSmoother(rig, settings, datum, options.window_s, body)
        self._window = RollingWindow(
            *(settings.universal_cell_m, settings.map.transfer or Transfer.CENTRE),
            *(options.map_side_m, GridSpec.of(settings.grid).reach_m),
        )
        self.going = DeadReckoning(self._trailing.rows, rig.rear_axle_forward_m)
        """How the vehicle goes just now."""
        self.tilt = RunningTilt(self._trailing.rows)
        """How it leans."""
        self._is_levelling = is_levelling
        self.stamps = Stamps()
        """Whether what is pushed is of the time of all else."""
        self._budget, self._settings = cell_budget(rig, settings), settings.pose
        self._inbox: deque[_PoserInput | StampVerdict] = deque(maxlen=MOST_INBOX)
        self._changed = threading.Condition()
        self._closed = self._has_frame = False
        self._estimate: Estimate | None = None
        self._attitude: Attitude | None = None
        self._fixes, self._known_ns = FixColumns.of([]), 0
        self._why = "no pose was estimated yet"
        self._estimated_ns = self._asked_ns = self._answered_ns = 0
        self._before: PropagatedPose | None = None
        self._latest: PropagatedPose | None = None
        self._shown_s = -math.inf
        self._is_asked = self._is_shown = True
        self._is_newest_in = False
        self._waiting: list[PerceivedFrame] = []
        self._repeats = Repeats(lambda text: self._say(What.INPUT, text))
        self._told: set[int] = set()
        self._refused_ns: dict[Gate, int] = {}
        self._newest: PerceivedFrame | None = None
        self._code: WindowDoubt | None = None
        self._is_advised = False
        self._pose: Pose | None = None
        self._gear = 0
        self._used = np.zeros(0, dtype=np.bool_)
        self._heard_s = time.monotonic()
        self._estimator = Estimator(self.put)
        self._thread = threading.Thread(target=self._run, name="fieldgrid-poses", daemon=True)
        self._thread.start()

    def put(self, said: _PoserInput) -> None:
        """Take what was pushed, or what was estimated of it; it never blocks."""
        judged = StampVerdict()
        if isinstance(said, Fix):
            judged = self.stamps.fix(said.time_ns)
            if judged.why:
                self._tell(LiveEvent(What.FIX_REFUSED, judged.why, said.time_ns))
                return
        elif not isinstance(said, PerceivedFrame | EstimateResult):
            part, rows = said
            taken, judged = self.stamps.rows(part, rows)
            if judged.is_first:
                self._tell(LiveEvent(What.INPUT, judged.why, int(rows.time_ns[-1])))
            if taken is None:
                return
            self._trailing.rows.add(part, taken)
        if judged.lost:
            self._trailing.rows.forget(judged.lost, judged.back_ns)
        with self._changed:
            if judged.lost:
                self._inbox.append(judged)
            self._inbox.append(said)
            if not isinstance(said, EstimateResult):
                self._heard_s = time.monotonic()
            if isinstance(said, PerceivedFrame | EstimateResult):
                self._has_frame = True
                self._changed.notify()

    def close(self) -> None:
        """Tell what there is, and end."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._has_frame or self._closed, EVERY_S)
                said, self._has_frame, closed = list(self._inbox), False, self._closed
                self._inbox.clear()
            try:
                for one in said:
                    self._take(one)
                self._go_on(said, closed=closed)
            except Exception as error:  # noqa: BLE001 - what fails here does not end the mapping
                self._say(What.POSE, f"Poses could not be told: {shortened(repr(error))}")
            if closed:
                return

    def _go_on(self, said: Sequence[object], *, closed: bool) -> None:
        """Show the window if that is new, and let an estimate be made of what was said."""
        still_s = 0.0 if said else time.monotonic() - self._heard_s
        # What comes while an estimate is made, or just after a window, counts in the next one.
        self._is_asked &= all(isinstance(one, EstimateResult) for one in said)
        self._is_shown &= not said
        if closed:
            self._estimator.close()
            self._ask(estimate_now)
        is_due = time.monotonic() - self._shown_s >= EVERY_S
        is_due &= not self._is_shown or still_s > SILENT_S
        is_due |= any(isinstance(one, PerceivedFrame) for one in said)
        is_due |= not self._is_newest_in and any(isinstance(one, EstimateResult) for one in said)
        if closed or is_due:
            self._tell_all(still_s)
            self._shown_s, self._is_shown = time.monotonic(), True
        elif any(isinstance(one, EstimateResult) for one in said):
            self._prepare()
        # Not before: an estimate that begins would take turns with what is shown.
        if not closed and self._estimator.is_free and (not self._is_asked or still_s > SILENT_S):
            self._ask(self._estimator.ask)
            self._is_asked = True

    def _ask(self, ask: Callable[[EstimateInputs], EstimateResult | None]) -> None:
        """Ask for an estimate; one that is made at once is taken at once."""
        newest_ns = self._asked_ns = self._trailing.newest_ns
        try:
            oldest_ns = min((w.time_ns for w in self._waiting), default=newest_ns)
            asked = self._trailing.asked(oldest_ns, level_grids=self._is_levelling())
        except FieldgridError as error:
            self._take_estimate(EstimateResult(None, None, str(error)))
            return
        made = ask(asked)
        if made is not None:
            self._take_estimate(made)

    def _take(self, said: _PoserInput | StampVerdict) -> None:
        if isinstance(said, Fix):
            self._trailing.add_fix(said)
        elif isinstance(said, StampVerdict):
            self._trailing.forget(said.lost, said.back_ns)
        elif isinstance(said, PerceivedFrame):
            seen = self._newest = self._repeats.taken(said)
            self._trailing.add_frame(seen.time_ns, seen.step)
            self._waiting.append(seen)
        elif isinstance(said, EstimateResult):
            self._take_estimate(said)

    def _take_estimate(self, made: EstimateResult) -> None:
        """Let an estimate, or that there is none, take the place of the one before."""
        self._estimate, self._why = made.estimate, made.why
        self._answered_ns, self._is_shown = self._asked_ns, False
        if made.problem:
            self._say(What.POSE, f"Poses could not be estimated: {made.problem}")
        if made.asked is not None:
            self._fixes, frame_ns = made.asked.fixes, made.asked.frame_ns
            self._known_ns = made.asked.known_ns
            self._estimated_ns = int(frame_ns[-1]) if len(frame_ns) else 0
        if made.estimate is None:
            self._used = np.zeros(len(self._fixes), dtype=np.bool_)
            return
        track = made.estimate.trajectory
        self._trailing.datum = track.datum
        self.going.know(made.estimate)
        asked = made.asked
        is_level = asked is not None and asked.is_level
        # Poses of a lean that is denied are those of level grids, too; no grid is level by it.
        self._attitude = made.estimate.report.attitude if is_level else None
        self.tilt.know(None if asked is None else asked.levelling(made.estimate))
        self._used = np.isin(self._fixes.time_ns, track.time_ns[track.accepted])
        self._say_refused(made.estimate)

    def _prepare(self) -> None:
        """Place all frames anew by an estimate, so that the next one finds that done."""
        settled, moving = self._placed(self._why)
        if self._estimate is not None:
            pose, *_ = self._pose_now(self._estimate.trajectory)
            self._window.follow(pose, MOVES_M / 2.0)
        self._window.settle(settled)
        self._window.place(moving)

    def _tell_all(self, still_s: float) -> None:
        """Place what was seen, and tell; nothing was pushed for `still_s`."""
        doubt, code = self._why, WindowDoubt.NO_FIXES
        settled, moving = self._placed(doubt)
        if self._estimate is not None:
            self._pose, self._gear, doubt = self._pose_now(self._estimate.trajectory)
            code = WindowDoubt.POSE if doubt else WindowDoubt.NONE
            self._window.follow(self._pose)
            if doubt and self._attitude is None and not self._is_advised:
                known = self._estimate.report.attitude, self._pose.time_ns
                advice = lean_advice(*known, self._rig.antenna.up_m, self._budget.cell_m)
                if advice:
                    self._is_advised = True
                    self._say(What.POSE, advice)
        if self._newest is not None and not doubt:
            new_ns = min(self._newest.time_ns, self._repeats.new_ns)
            silent_s = (self._trailing.newest_ns - new_ns) / 1e9
            if silent_s > SILENT_S:
                what = "frame" if new_ns == self._newest.time_ns else "new image"
                doubt, code = f"no {what} for {silent_s:.1f} s", WindowDoubt.NO_FRAMES
        if still_s > SILENT_S and not doubt:
            doubt, code = f"nothing was pushed for {still_s:.0f} s", WindowDoubt.SILENT
        self._window.settle(settled)
        if self._trailing.datum is not None:
            self._show(self._trailing.datum, moving, doubt, code)
        if code != self._code:
            how = f"is not to be trusted: {doubt}" if doubt else "can be trusted."
            self._say(What.POSE, f"The window around the vehicle {how}")
        self._code = code

    def _pose_now(self, track: Trajectory) -> tuple[Pose, int, str]:
        return pose_now(track, self._latest, self._trailing.newest_ns, self._trailing.told_ns)

    def _placed(self, doubt: str) -> tuple[list[PlacedGrid], list[PlacedGrid]]:
        """Tell the poses of the frames that wait; the grids of those whose pose is good enough:
        for good, and such as may still move."""
        still, settled, moving = list[PerceivedFrame](), list[PlacedGrid](), list[PlacedGrid]()
        # It is the estimate that must have fixes after a frame, and the frame's own step.
        # Nor is a frame given up before an estimate was made of what came while it waited.
        answered_ns, before, repeats = self._answered_ns, self._before, self._repeats
        repeats.begin()
        for seen in self._waiting:
            is_settled = (self._known_ns - seen.time_ns) / 1e9 >= self._options.lag_s
            is_settled = is_settled and seen.time_ns <= self._estimated_ns
            is_settled = is_settled or (answered_ns - seen.time_ns) / 1e9 >= GIVEN_UP_S
            at = before = self._pose_of(seen, before, doubt)
            pose, gear = at.pose, at.gear
            if pose.status is not Status.REJECTED and not seen.ground_found:
                pose = replace(pose, status=Status.REJECTED, reason=no_ground(self._rig))
            pose = repeats.judged(seen, pose, is_settled=is_settled)
            is_good = pose.status is not Status.REJECTED
            if is_settled or (is_good and seen.time_ns not in self._told):
                self._tell(LivePose(seen.frame_id, pose, gear, is_settled))
                self._told.add(seen.time_ns)
            if is_good:
                off_m = self._budget.reach_m * math.radians(pose.heading_sigma_deg)
                sigma_m = math.hypot(pose.position_sigma_m, off_m)
                if self._attitude is not None and not seen.is_level:
                    tilt = self._attitude.tilt_at(seen.time_ns)
                    pose = square_to_ground(pose, tilt, self._rig.mount.height_m)
                frame = PlacedGrid(seen.grid, pose, seen.time_ns, sigma_m)
                (settled if is_settled else moving).append(frame)
            if is_settled:
                self._told.discard(seen.time_ns)
                self._before = before
            else:
                still.append(seen)
        self._waiting, self._latest = still, before
        return settled, moving

    def _pose_of(
        self, seen: PerceivedFrame, before: PropagatedPose | None, doubt: str
    ) -> PropagatedPose:
        """The pose of a frame by the latest estimate; where it is newer than that, by the camera's
        step from the frame before, or by gyro and wheels from the end of the estimate."""
        if self._estimate is None:
            return PropagatedPose(unknown_pose(seen.time_ns, doubt), 0)
        track = self._estimate.trajectory
        found = PropagatedPose(*pose_at(track, seen.time_ns))
        if seen.time_ns <= self._estimated_ns:
            return found
        carried = []
        known_ns = track.time_ns[track.accepted]
        known = PropagatedPose(*pose_at(track, int(known_ns[-1]))) if len(known_ns) else None
        if seen.step is not None and before is not None and _is_good(before):
            carried = [one for one in (before.on(seen.time_ns, seen.step),) if one.fits(known)]
        if not carried and known is not None and not _is_good(found):
            rolled = self.going.step(known.pose.time_ns, seen.time_ns)
            if rolled is not None:
                carried.append(known.on(seen.time_ns, rolled))
        good = (one for one in carried if one.is_good(self._settings, self._budget))
        return next(good, found)

    def _show(self, datum: Datum, moving: list[PlacedGrid], doubt: str, code: WindowDoubt) -> None:
        newest, now_ns = self._newest, self._trailing.newest_ns
        view, age_s, sigma_m = self._window.view(moving, datum, now_ns)
        inflation = self._options.inflation
        costmap = Costmap.from_view(
            view,
            curve=self._options.curve,
            robot_radius_m=inflation.robot_radius_m,
            inflation_m=inflation.inflation_m,
            decay_per_m=inflation.decay_per_m,
        )
        # Its time counts once the newest frame is in it.
        is_in = newest is not None and any(one.time_ns == newest.time_ns for one in moving)
        self._is_newest_in = is_in
        latency_s = time.monotonic() - newest.pushed_s if is_in and newest else None
        self._tell(
            LiveWindow(
                *(now_ns, costmap, view, age_s, sigma_m, self._pose, doubt),
                self._window.frames + len(moving),
                newest.frame_id if is_in and newest else "",
                latency_s,
                code,
                self._gear,
                self._fixes,
                self._used,
            )
        )

    def _say_refused(self, estimate: Estimate) -> None:
        """Tell what the receiver said that is not used, of each kind once in a while."""
        for refused in estimate.report.conditioning.rejected:
            told_ns = self._refused_ns.get(refused.gate)
            if told_ns is None or refused.last_ns > told_ns + SAID_AGAIN_S * 1e9:
                self._refused_ns[refused.gate] = refused.last_ns
                self._say(What.FIX_REFUSED, f"A fix is not used: {refused.example}")

    def _say(self, what: What, text: str) -> None:
        self._tell(LiveEvent(what, text, self._trailing.newest_ns))


def _is_good(found: PropagatedPose) -> bool:
    return found.pose.status is not Status.REJECTED

"""Frames to local grids while the vehicle drives: two at a time, in order, and a queue that has an
end."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait as wait_for
from typing import NamedTuple

from fieldgrid.core import FieldgridError, MapWriteError, MatcherKind
from fieldgrid.geometry import LocalGrid, StereoCamera, Tilt
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.pose.sensor_rows import check_time
from fieldgrid.live.pose.stamps import OFF_S, Stamps
from fieldgrid.live.results import LiveEvent, LiveGrid, LiveResult, What
from fieldgrid.perception import CameraStep, FrameGround, LocalGridder, OriginTrack, Refusal
from fieldgrid.pipeline import FrameStager, Perception, StageTimes, StepOutcome, encoded
from fieldgrid.recordings import Frame, StereoFrame

WORKERS = 2
"""Frames that are perceived at a time: one thread does not keep up with 10 Hz beside the poses."""


MOST_HELD = 20
"""Frames that are stamped ahead of all else; of more the oldest are left out."""


class PerceivedFrame(NamedTuple):
    """A frame that was perceived, its grid guarded against drops. `step` is the camera's to it from
    the one before; `is_level` is whether the grid's columns are vertical."""

    frame_id: str
    time_ns: int
    grid: LocalGrid
    ground_found: bool
    step: CameraStep | None
    pushed_s: float
    images_sha256: tuple[str, ...] = ()
    is_level: bool = False


class _FrameUnderWay(NamedTuple):
    """A frame that is looked at, or waits for that, and what ends when it is kept and told."""

    frame: Frame
    seen: Future[Perception]
    end: Future[None]


class Perceiver:
    """Takes frames in order of time, and keeps and tells what they saw.

    Grids are level where the `tilt` of the vehicle is known. The points of a cloud are carried to
    its stamp by the `way` around it, where that is known.
    When as many wait as may, the oldest of them is dropped: what is in front of the vehicle now
    matters more than what was.
    """

    def __init__(
        self,
        kept: SessionFolder,
        gridder: LocalGridder,
        *,
        odometry: bool,
        stamps: Stamps,
        most_waiting: int,
        tell: Callable[[LiveResult], None],
        pass_on: Callable[[PerceivedFrame], None],
        way: Callable[[int], OriginTrack | None],
        tilt: Callable[[int], Tilt | None],
    ) -> None:
        self._kept, self._gridder = kept, gridder
        self._most, self._tell, self._pass_on = most_waiting, tell, pass_on
        self._stamps = stamps
        self._stager = FrameStager(
            gridder,
            odometry=odometry,
            tilt=lambda time_ns: tilt(time_ns) if kept.points.is_levelling else None,
            way=way,
        )
        self._pushing = threading.Lock()
        self._held: list[tuple[Frame, str, int]] = []
        """Frames ahead of all else, why, and how often such were refuted before."""
        self._looking = ThreadPoolExecutor(WORKERS, "fieldgrid-perception")
        self._following = ThreadPoolExecutor(1, "fieldgrid-frames")
        self._under_way: deque[_FrameUnderWay] = deque()
        self._last = self._following.submit(lambda: None)
        """Ends with the frame that was pushed last."""
        self._closed = False
        self._newest_ns = kept.newest_frame_ns
        # The last frame before the restart, pushed again, is looked at for the step from it.
        self._again_ns = kept.newest_frame_ns if odometry else None
        self.frames = len(kept.drive.frames)
        self.dropped = kept.drive.dropped
        self.late = 0
        self._disk_full = False

    def push(self, frame: Frame, *, wait: bool) -> bool:
        """Let a frame be perceived; False where it is not, since it is not newer than the one
        before or since no frame is taken any more. With `wait` it waits for its turn where none
        may be dropped. One that is stamped ahead of all else is held until it is clear what time it
        is. ConfigError for a time that no map can have."""
        check_time("a frame", frame.time_ns)
        with self._pushing:
            why = self._stamps.frame(self._time_ns(frame)).why
            if why:
                self._held.append((frame, why, self._stamps.refuted))
                if len(self._held) > MOST_HELD:
                    self._leave(*self._held.pop(0)[:2])
                return True
            self._end_doubt()
            return self._put(frame, wait=wait)

    def _end_doubt(self) -> None:
        """Let frames be perceived that were held, but for those of which it came out that they are
        of another time."""
        held, self._held = self._held, []
        for frame, why, refuted in held:
            if refuted != self._stamps.refuted:
                self._leave(frame, why)
            else:
                self._put(frame, wait=True)

    def _leave(self, frame: Frame, why: str) -> None:
        self.late += 1
        text = f"Frame {frame.frame_id} {why}; it was left out."
        self._tell(LiveEvent(What.FRAME_LATE, text, self._time_ns(frame)))

    def _time_ns(self, frame: Frame) -> int:
        """When a frame was taken, by the receiver's clock."""
        return frame.time_ns + self._gridder.rig.image_time_offset_ns

    def _put(self, frame: Frame, *, wait: bool) -> bool:
        time_ns, newest_ns = self._time_ns(frame), self._newest_ns
        is_again = time_ns == self._again_ns
        if newest_ns is not None and time_ns <= newest_ns and not is_again:
            behind_s = (newest_ns - time_ns) / 1e9
            why = "is not newer than the one before"
            if behind_s > OFF_S:
                why = (
                    f"is stamped {behind_s:.0f} s before the newest one (where its clock was put "
                    "back, end this session and begin another)"
                )
            self._leave(frame, why)
            return False
        if self._closed:
            return False
        under_way, most = self._under_way, self._most + WORKERS
        while under_way and (under_way[0].end.done() or (wait and len(under_way) >= most)):
            under_way.popleft().end.result()
        if len(under_way) >= most:
            self._drop_oldest(time_ns)
        pushed_s = time.monotonic()
        seen = self._looking.submit(self._look, frame, pushed_s, is_again, self._last)
        self._last = self._following.submit(self._follow, frame, pushed_s, is_again, seen)
        under_way.append(_FrameUnderWay(frame, seen, self._last))
        self._newest_ns, self._again_ns = time_ns, None
        return True

    def _drop_oldest(self, now_ns: int) -> None:
        """Drop the oldest frame that nobody looks at yet, if there is one."""
        dropped = next((one for one in self._under_way if one.seen.cancel()), None)
        if dropped is None:
            return
        self._under_way.remove(dropped)
        self.dropped += 1
        frame = dropped.frame
        self._kept.add_dropped(frame.frame_id, frame.time_ns)
        stereo, sensor = self._gridder.stereo, self._gridder.rig.sensor
        is_slow = isinstance(sensor, StereoCamera) and stereo.matcher is not MatcherKind.BM
        advice = ""
        if is_slow and stereo.row_step == 1 and self.dropped == 1:
            advice = " --row-step 2 matches in half the time."
        text = (
            f"Frame {frame.frame_id} was dropped, since newer ones wait: {self.dropped} so "
            f"far.{advice}"
        )
        self._tell(LiveEvent(What.FRAME_DROPPED, text, now_ns))

    def drain(self, timeout_s: float | None = None) -> bool:
        """Wait until every frame is perceived; False when that takes longer."""
        with self._pushing:
            self._end_doubt()
        return not wait_for([self._last], timeout_s).not_done

    def close(self) -> None:
        """Perceive what waits, and end."""
        with self._pushing:
            self._end_doubt()
            self._closed = True
        self._following.shutdown()
        self._looking.shutdown()

    def _look(
        self, frame: Frame, pushed_s: float, is_again: bool, before: Future[None]
    ) -> Perception:
        """Look at a frame beside the one before. Its grid is told when that one is kept, and before
        the rest of it is looked at: whoever drives by it need not wait for that."""

        def gridded(grid: LocalGrid, ground: FrameGround) -> None:
            before.result()
            if not is_again:
                latency_s = time.monotonic() - pushed_s
                about = frame.frame_id, self._time_ns(frame)
                self._tell(LiveGrid(*about, grid, ground.refined, latency_s))

        return self._stager.look(frame, gridded)

    def _follow(
        self, frame: Frame, pushed_s: float, is_again: bool, looked: Future[Perception]
    ) -> None:
        """Do what is to be done of each frame in its turn."""
        try:
            self._finish(looked.result(), pushed_s, is_again)
        except CancelledError:
            pass  # it was dropped
        except Exception as error:  # noqa: BLE001 - one frame does not end the mapping
            problem = str(error) if isinstance(error, FieldgridError) else repr(error)
            self._kept.add_bad(frame, problem)
            text = f"Frame {frame.frame_id} cannot be used: {problem}"
            self._tell(LiveEvent(What.FRAME_BAD, text, self._time_ns(frame)))

    def _finish(self, seen: Perception, pushed_s: float, is_again: bool) -> None:
        """Pass a frame on, and then keep it: no window waits until it is encoded and written."""
        found, times = self._stager.follow(seen)
        if is_again:
            return
        self._pass_on(
            PerceivedFrame(
                seen.frame.frame_id,
                self._time_ns(seen.frame),
                seen.grid.guarded(seen.ground.drops_cm),
                seen.ground.refined,
                found if isinstance(found, CameraStep) else None,
                pushed_s,
                seen.sources_sha256,
                seen.is_level,
            )
        )
        if self._disk_full and found is not None:
            found = Refusal.LOST  # no step leads over a frame that the disk refused
        self._keep(seen, found, times)

    def _keep(self, seen: Perception, found: StepOutcome, times: StageTimes) -> None:
        """Keep a frame, to which the camera's step from the last one that is kept was `found`."""
        kept, frame, number = self._kept, seen.frame, None
        time_ns = self._time_ns(frame)
        try:
            staged = encoded(seen, self._gridder.rig)
            number = kept.add_frame(staged, found, times, seen.seen, is_level=seen.is_level)
        except MapWriteError as error:
            if not self._disk_full:
                text = f"{error} Frames are not kept until there is room; the mapping goes on."
                self._tell(LiveEvent(What.DISK, text, time_ns))
            kept.add_dropped(frame.frame_id, frame.time_ns)
            self.dropped += 1
        else:
            if self._disk_full:
                text = "The disk takes frames again."
                self._tell(LiveEvent(What.DISK, text, time_ns))
            self.frames += 1
        self._disk_full = number is None
        while kept.points.warnings:
            self._tell(LiveEvent(What.DISK, kept.points.warnings.popleft(), time_ns))
        if number is not None and kept.claim_pair(number, time_ns):
            self._looking.submit(self._keep_pair, number, frame)

    def _keep_pair(self, number: int, frame: Frame) -> None:
        """Keep the images of a frame; no other frame waits for that."""
        if not isinstance(frame, StereoFrame):
            return
        try:
            self._kept.add_pair(number, *frame.images())
        except FieldgridError as error:
            text = f"The images of frame {frame.frame_id} cannot be kept: {error}"
            self._tell(LiveEvent(What.INPUT, text, self._time_ns(frame)))

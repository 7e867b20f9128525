"""A session on the vehicle: pushed to while it drives, durable at once, a map at its end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from fieldgrid.core import BuildSettings, Closing, ConfigError, Overrides, RecordingError, quoted
from fieldgrid.geometry import Datum, Fix, GridSpec, Rig
from fieldgrid.live.finish import check_begin, finish
from fieldgrid.live.given import GIVEN_ROWS, check_body, check_order, pose_rows
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.options import LiveOptions
from fieldgrid.live.perceiver import Perceiver
from fieldgrid.live.pose.fixed_lag import GIVEN_KEPT_S
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.sensor_rows import Rows, rows_of
from fieldgrid.live.pushed import PushedImage, PushedSource, warm_up
from fieldgrid.live.results import CLIENT_S, Counts, LiveEvent, LiveResult, Outbox, What
from fieldgrid.live.warming import warm_up_poses
from fieldgrid.maps import Patience
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline import DriveStart, Progress, SessionReport, follows_camera
from fieldgrid.poses import NmeaStream
from fieldgrid.recordings import CloudFrame, DepthFrame, Frame, PoseBody, StereoFrame

SYNC_S = 0.5
"""What is pushed is on the disk after this and the time that the disk takes."""


class Live(Closing):
    """A live session for a map: push what sensors say, take grids, poses and the window around.

    Pushed data are in `MAP.live` beside the map within a second; the map is made at the end of the
    block, as by a build, from the whole drive. A killed program continues the session when it opens
    it again. After an error other than Ctrl-C and SIGTERM, `finish_session` makes the map later.

    With `poses` the vehicle's poses are those of another program (`push_pose`), as those of
    `build --poses` are; they say what body they are of. The camera's steps are not worked out then.

    Results are given to `on_result` in a thread of its own, or taken with `results`; the oldest are
    dropped when nobody takes them. What a callback raises, or how long it takes, changes nothing
    else. Pushing is safe from any thread. Making it takes seconds on the first run on a machine.
    Raises MapExistsError, ConfigError and others for what the map would refuse.
    """

    def __init__(
        self,
        map_path: str | Path,
        rig: Rig,
        settings: BuildSettings | None = None,
        *,
        name: str,
        datum: Datum | None = None,
        datum_hint: Datum | None = None,
        append: bool = False,
        source: str = "live",
        source_sha256: str = "",
        notes: tuple[str, ...] = (),
        poses: PoseBody | None = None,
        options: LiveOptions | None = None,
        on_result: Callable[[LiveResult], None] | None = None,
    ) -> None:
        settings, options = settings or BuildSettings(), options or LiveOptions()
        about = DriveStart(
            *(name, rig, settings, datum, datum_hint, append, source, source_sha256, notes),
            None if poses is None else check_body(poses),
        )
        gridder = LocalGridder(rig, GridSpec.of(settings.grid), settings.stereo, settings.density)
        check_begin(Path(map_path), about)
        odometry = follows_camera(rig, settings) and poses is None
        warm_up(gridder, odometry=odometry)
        warm_up_poses(rig, settings)
        self.name, self.rig, self._settings = name, rig, settings
        self._kept = SessionFolder(Path(map_path), about, options.points_gb)
        drive = self._kept.drive
        self._lock = threading.Lock()
        self._nmea = NmeaStream(late_epochs=1)
        self._fixes, self._bad = len(drive.fixes), len(drive.bad)
        self._rows = {part: sum(len(r.time_ns) for r in all_) for part, all_ in drive.parts.items()}
        self._heard_ns = 0
        self._is_full, self._lost = False, 0
        self.is_resumed = self._kept.is_resumed
        self.newest_frame_ns = self._kept.newest_frame_ns
        """The time of the last frame that is kept, by the receiver's clock; None without."""
        self._last_number = len(drive.frames) + len(drive.bad) + drive.dropped
        self._outbox = Outbox()
        self._deliverer = None if on_result is None else self._outbox.deliver(on_result)
        given_ns = (int(rows.time_ns.max()) for rows in drive.parts.get(GIVEN_ROWS, ()))
        self._newest_pose_ns = max(given_ns, default=0)
        self._most_late_ns = round(options.lag_s * 1e9)
        self._poser = Poser(
            *(rig, settings, datum or datum_hint, options, self._tell, poses),
            is_levelling=lambda: self._kept.points.is_levelling,
        )
        if self.is_resumed:
            self._go_on()
        self._perceiver = Perceiver(
            self._kept,
            gridder,
            odometry=odometry,
            most_waiting=options.queue_frames,
            tell=self._tell,
            pass_on=self._poser.put,
            way=self._poser.going.around,
            tilt=self._poser.tilt.at,
            stamps=self._poser.stamps,
        )
        self._kept.forget()
        self._stopping = threading.Event()
        self._syncer = threading.Thread(target=self._sync, name="fieldgrid-sync", daemon=True)
        self._syncer.start()
        self._is_open = True

    def _go_on(self) -> None:
        """Let poses begin with the end of what was pushed before a restart."""
        drive = self._kept.drive
        text = f"The session {quoted(self.name)} goes on: {len(drive.frames)} frames are kept."
        newest_ns = int(drive.fixes.time_ns.max(initial=0))
        self._tell(LiveEvent(What.SESSION, text, newest_ns))
        since_ns = newest_ns - round(GIVEN_KEPT_S * 1e9)
        for fix in drive.fixes[drive.fixes.time_ns >= since_ns]:
            self._poser.put(fix)
        for part, chunks in drive.parts.items():
            for rows in chunks:
                new = rows.where(rows.time_ns >= since_ns)
                if len(new.time_ns):
                    self._poser.put((part, new))
        self._poser.stamps.forget()  # nobody knows how long nobody listened

    @property
    def folder(self) -> Path:
        """Where the session is kept."""
        return self._kept.folder

    @property
    def counts(self) -> Counts:
        """What has been pushed until now, and what became of it."""
        frames, results = self._perceiver, self._outbox
        return Counts(
            *(frames.frames, frames.dropped, frames.late, self._bad),
            *(self._fixes, dict(self._rows), results.missed, results.failed),
        )

    def push_pair(
        self,
        left: npt.NDArray[np.uint8],
        right: npt.NDArray[np.uint8],
        time_ns: int,
        *,
        frame_id: str | None = None,
        wait: bool = False,
    ) -> bool:
        """A rectified pair of grey images, 8 bit, of the rig's camera, taken at `time_ns` by the
        camera's clock (UTC). It must not be written to afterwards.

        False where it is not taken: frames come in order of time, so one that is not newer than the
        one before is left out. When more wait than may, the oldest is dropped; with `wait` this
        waits instead.
        """
        name, camera = self._frame_id(frame_id), self.rig.camera
        sides = PushedImage(f"{name}/left", left), PushedImage(f"{name}/right", right)
        size_px = (camera.width_px, camera.height_px)
        return self.push_frame(StereoFrame(name, int(time_ns), *sides, size_px), wait=wait)

    def push_depth(
        self,
        depth_m: npt.NDArray[np.float32],
        time_ns: int,
        *,
        frame_id: str | None = None,
        wait: bool = False,
    ) -> bool:
        """An image of depths along the optical axis, metres, NaN where there is none; the rest as
        in `push_pair`."""
        name, camera = self._frame_id(frame_id), self.rig.depth_camera
        size_px = (camera.width_px, camera.height_px)
        frame = DepthFrame(name, int(time_ns), PushedSource(f"{name}/depth", depth_m), size_px)
        return self.push_frame(frame, wait=wait)

    def push_cloud(
        self,
        points_m: npt.NDArray[np.float32],
        time_ns: int,
        *,
        after_s: npt.NDArray[np.float32] | None = None,
        frame_id: str | None = None,
        wait: bool = False,
    ) -> bool:
        """Points [n, 3] of the sensor's frame (x right, y down, z forward), metres, and by how much
        later than `time_ns` each was taken, seconds [n]; the rest as in `push_pair`."""
        name = self._frame_id(frame_id)
        frame = CloudFrame(name, int(time_ns), PushedSource(f"{name}/cloud", points_m, after_s))
        return self.push_frame(frame, wait=wait)

    def push_frame(self, frame: Frame, *, wait: bool = False) -> bool:
        """A frame as recordings have it, which is read by the session's own thread; the rest as in
        `push_pair`."""
        self._check_open()
        is_taken = self._perceiver.push(frame, wait=wait)
        self._heard_ns = max(self._heard_ns, frame.time_ns + self.rig.image_time_offset_ns)
        return is_taken

    def push_fix(self, fix: Fix) -> None:
        """A fix, in any order; one that comes later than the lag counts at the end only."""
        self._check_open()
        with self._lock:
            self._note_disk(self._kept.add_fix(fix), fix.time_ns)
            self._fixes += 1
            self._heard_ns = max(self._heard_ns, fix.time_ns)
        self._poser.put(fix)

    def push_nmea(self, data: bytes) -> int:
        """Bytes of a receiver as they come, cut anywhere; returns how many fixes they made whole.
        One is given when the next epoch begins."""
        with self._lock:
            fixes = self._nmea.feed(data)
        for fix in fixes:
            self.push_fix(fix)
        return len(fixes)

    def push_gyro(self, time_ns: npt.ArrayLike, rate_rad_s: npt.ArrayLike) -> None:
        """Rates of turn, clockwise seen from above, one or [n], in any order."""
        self.push_rows("gyro", rows_of("gyro", time_ns, rate_rad_s))

    def push_wheels(self, time_ns: npt.ArrayLike, speed_mps: npt.ArrayLike) -> None:
        """Speeds over ground, negative in reverse, one or [n], in any order."""
        self.push_rows("wheels", rows_of("wheels", time_ns, speed_mps))

    def push_imu(
        self, time_ns: npt.ArrayLike, rate_rad_s: npt.ArrayLike, force_mps2: npt.ArrayLike
    ) -> None:
        """All axes of an IMU in the vehicle's axes, [3] or [n, 3], as `motion.Inertial` has them.
        Push the rate about the vertical as gyro, too."""
        self.push_rows("inertial", rows_of("inertial", time_ns, rate_rad_s, force_mps2))

    def push_tilt(
        self,
        time_ns: npt.ArrayLike,
        roll_deg: npt.ArrayLike,
        pitch_deg: npt.ArrayLike,
        sigma_deg: npt.ArrayLike,
    ) -> None:
        """Roll and pitch that something states, with their error, as `motion.RecordedTilt`."""
        self.push_rows("tilt", rows_of("tilt", time_ns, roll_deg, pitch_deg, sigma_deg))

    def push_orientation(
        self,
        time_ns: npt.ArrayLike,
        roll_deg: npt.ArrayLike,
        pitch_deg: npt.ArrayLike,
        sigma_deg: npt.ArrayLike,
        frame_sigma_deg: npt.ArrayLike,
    ) -> None:
        """Roll and pitch by what is not calibrated to the vehicle, as `motion.Orientation`: they
        may be off by the same all the time."""
        rows = rows_of("orientation", time_ns, roll_deg, pitch_deg, sigma_deg, frame_sigma_deg)
        self.push_rows("orientation", rows)

    def push_pose(
        self,
        time_ns: npt.ArrayLike,
        position_m: npt.ArrayLike,
        quaternion_xyzw: npt.ArrayLike,
        variance: npt.ArrayLike | None = None,
    ) -> None:
        """Poses that another program made, of the body that the session was begun with (`poses`),
        in a frame of their own: positions [3] or [n, 3] in metres, and unit quaternions x, y, z, w
        [4] or [n, 4] from the body's axes to the frame's. `time_ns` is by the receiver's clock,
        `variance` [3] or [n, 3] what is stated of x, y (m²) and the turn about z (rad²), or NaN.
        They may come in any order within the lag (`LiveOptions.lag_s`). ConfigError, and none of
        them taken, for one that comes later, is not finite, or has a quaternion of another length.
        """
        self.push_rows(GIVEN_ROWS, pose_rows(time_ns, position_m, quaternion_xyzw, variance))

    def results(self, timeout_s: float | None = None) -> Iterator[LiveResult]:
        """The results as they come, until the session ends or none comes for `timeout_s`. Not
        beside a callback."""
        if self._deliverer is not None:
            raise ConfigError("The results go to the callback; leave out on_result to take them.")
        while (result := self._outbox.take(timeout_s)) is not None:
            yield result

    def tell(self, what: What, text: str) -> None:
        """Let whoever takes the results know of something beside the session: a lost source."""
        self._outbox.put(LiveEvent(what, text, self._heard_ns))

    def drain(self, timeout_s: float | None = None) -> bool:
        """Wait until every frame that was pushed is perceived; False when that takes longer."""
        return self._perceiver.drain(timeout_s)

    def finish(
        self,
        overrides: Overrides | None = None,
        *,
        progress: Callable[[Progress], None] | None = None,
        patience: Patience | None = None,
    ) -> SessionReport:
        """End the session and put it into the map; options and errors as of `finish_session`."""
        self._check_open()
        with closing(self._kept):
            self._end()
            return finish(self._kept, overrides or {}, progress, patience)

    def stop(self) -> None:
        """End the session without a map; what is kept waits for its next start or its finish."""
        if self._is_open:
            with closing(self._kept):
                self._end()

    def close(self) -> None:
        """`finish`; a session without a frame is removed instead, or kept where it has fixes."""
        if not self._is_open:
            return
        self.drain()
        if self.counts.frames:
            self.finish()
        else:
            self._end()
            (self._kept.close if self.is_resumed or self.counts.fixes else self._kept.remove)()

    def __exit__(self, *error: object) -> None:
        if len(error) > 1 and isinstance(error[1], Exception):
            self.stop()
        else:
            self.close()

    def __enter__(self) -> Self:
        return self

    def _end(self) -> None:
        """End the threads, in the order in which data go through them, each of them whatever
        becomes of those before."""
        self._is_open = False
        with ExitStack() as ending:  # the last comes first
            if self._deliverer is not None:
                ending.callback(self._deliverer.join, CLIENT_S)
            for step in (self._outbox.close, self._kept.journal.sync, self._syncer.join):
                ending.callback(step)
            for step in (self._stopping.set, self._poser.close, self._perceiver.close):
                ending.callback(step)
            for fix in self._nmea.finish():
                self._kept.add_fix(fix)
                self._poser.put(fix)

    def push_rows(self, part: str, rows: Rows) -> None:
        """Rows of a part of the motion (`pose.sensor_rows.PARTS`), in any order, or of poses."""
        self._check_open()
        if not len(rows.time_ns):
            return
        with self._lock:
            if part == GIVEN_ROWS:
                if self._kept.about.poses is None:
                    raise ConfigError(
                        "The session was begun without poses of another program; say what body "
                        "they are of when it begins: Live(..., poses=PoseBody())."
                    )
                self._newest_pose_ns = check_order(rows, self._newest_pose_ns, self._most_late_ns)
            self._rows[part] = self._rows.get(part, 0) + len(rows.time_ns)
            self._note_disk(self._kept.add_rows(part, rows), int(rows.time_ns[-1]))
        self._poser.put((part, rows))

    def _sync(self) -> None:
        while not self._stopping.wait(SYNC_S):
            self._kept.journal.sync()

    def _note_disk(self, taken: bool, time_ns: int) -> None:
        """Tell when the disk takes what is pushed no more, or again; under the lock."""
        if taken != self._is_full:
            return
        self._is_full = not taken
        lost, self._lost = self._kept.journal.lost - self._lost, self._kept.journal.lost
        records = f" {lost} records did not fit into memory meanwhile and are lost." if lost else ""
        text = f"The disk takes what is pushed again.{records}"
        if not taken:
            text = (
                f"The disk of {self.folder} takes nothing: what is pushed waits in memory and is "
                "lost with a kill; free some space there."
            )
        self._tell(LiveEvent(What.DISK, text, time_ns))

    def _tell(self, result: LiveResult) -> None:
        if isinstance(result, LiveEvent) and result.what is What.FRAME_BAD:
            self._bad += 1
        self._outbox.put(result)

    def _frame_id(self, given: str | None) -> str:
        with self._lock:
            self._last_number += given is None
            return f"{self._last_number:06d}" if given is None else given

    def _check_open(self) -> None:
        if not self._is_open:
            raise RecordingError(f"The session {quoted(self.name)} has ended; begin another.")

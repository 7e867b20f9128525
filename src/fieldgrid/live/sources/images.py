"""A folder in which images appear, as a source of frames."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

from fieldgrid.live.intake import Intake
from fieldgrid.recordings import GrowingFolder, Shot

LOOK_S = 0.05

MOST_SHARE = 0.1
"""Share of the time that looking at a folder of many files takes at most."""

UNCHANGED_S = 0.3
"""A file that does not tell its own end is whole when it has not changed for this time."""

GIVEN_UP_S = 2.0
"""Time for which a file that is not whole is waited for after its last change."""


@dataclass(slots=True)
class _PendingShot:
    shot: Shot
    state: tuple[tuple[int, int], ...]
    changed_s: float


@dataclass(slots=True, eq=False)
class ImageFolder:
    """Frames out of a folder into which a program of the camera writes them, in order of time.

    What lies there when it is begun is left out: nothing was heard of the receiver then. A file
    that is half written is waited for; what follows it waits, too.
    """

    folder: GrowingFolder
    _has_begun: bool = False
    _pending: deque[_PendingShot] = field(default_factory=deque)

    @property
    def name(self) -> str:
        """The folder."""
        return f"The folder {self.folder.path}"

    def begin(self) -> int:
        """Leave out what is there by now; how many frames that are."""
        self._has_begun = True
        return len(self.folder.new_shots()[0])

    def run(self, intake: Intake) -> None:
        """Give frames as they come; see `Source`."""
        if not self._has_begun:
            count = self.begin()
            before = f"; the {count} that lie there already are left out" if count else ""
            intake.tell(f"is watched for frames{before}.")
        while not intake.stop.is_set():
            start_s = time.monotonic()
            shots, problems = self.folder.new_shots()
            took_s = time.monotonic() - start_s
            intake.arrived()
            for problem in problems:
                intake.tell(f"has a frame that is left out: {problem}")
            for shot in shots:
                self._pending.append(_PendingShot(shot, self.folder.state(shot), time.monotonic()))
            while self._pending and self._is_ready(self._pending[0]):
                self._push(intake, self._pending.popleft().shot)
            intake.stop.wait(max(LOOK_S, took_s / MOST_SHARE))

    def _is_ready(self, pending: _PendingShot) -> bool:
        whole, now_s = self.folder.is_whole(pending.shot), time.monotonic()
        if whole:
            return True
        state = self.folder.state(pending.shot)
        if state != pending.state:
            pending.state, pending.changed_s = state, now_s
        # What is given up is read like any other frame, which says what is wrong with it.
        return now_s - pending.changed_s > (UNCHANGED_S if whole is None else GIVEN_UP_S)

    def _push(self, intake: Intake, shot: Shot) -> None:
        notes = len(self.folder.notes)
        frame = self.folder.frame(shot)
        for note in self.folder.notes[notes:]:
            intake.tell(f"says: {note}")
        intake.push_frame(frame)

    def finish(self, intake: Intake) -> None:
        """Look a last time, and give what is whole."""
        shots, _ = self.folder.new_shots()
        for shot in [*(one.shot for one in self._pending), *shots]:
            if self.folder.is_whole(shot) is not False:
                self._push(intake, shot)

"""Whether the disk takes what is pushed, and what is to be reported when that changes."""

from __future__ import annotations

from pathlib import Path


class DiskState:
    """Follows whether the disk of a session's folder takes what is pushed. Not safe from several
    threads at once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_full, self._lost = False, 0

    def changed(self, *, taken: bool, lost: int) -> str:
        """What to report after a record was `taken` or not; `lost` is the number of records that
        the session has lost. Empty where nothing has changed."""
        if taken != self._is_full:
            return ""
        self._is_full = not taken
        lost_now, self._lost = lost - self._lost, lost
        if not taken:
            return (
                f"The disk of {self._folder} takes nothing: what is pushed waits in memory and is "
                "lost with a kill; free some space there."
            )
        records = f" {lost_now} records did not fit into memory meanwhile and are lost."
        return f"The disk takes what is pushed again.{records if lost_now else ''}"

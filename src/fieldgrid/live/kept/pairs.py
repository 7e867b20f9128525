"""The pairs that a session keeps of its drive, by which the cameras are checked at its end."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fieldgrid.core import Int64
from fieldgrid.recordings import Frame, ImageFile, StereoFrame

_LEFT = re.compile(r"([0-9]{8})-left\.png")


def pair_numbers(folder: Path) -> list[int]:
    """The numbers of the frames whose pairs are in a folder."""
    found = map(_LEFT.fullmatch, (path.name for path in folder.iterdir()))
    return sorted(int(name[1]) for name in found if name)


@dataclass(frozen=True, slots=True)
class KeptPairs:
    """A `FrameSource` of a drive whose images are gone, but for some pairs: a frame is the nearest
    of these, which is enough to check the cameras."""

    folder: Path
    times_ns: Int64

    @property
    def roles(self) -> tuple[str, ...]:
        """The roles of the images of a pair."""
        return "left", "right"

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """For each frame the nearest pair."""
        kept = pair_numbers(self.folder)
        for number in range(start, stop) if kept else ():
            nearest = min(kept, key=lambda other: abs(other - number))
            left, right = (
                ImageFile(self.folder / f"{nearest:08d}-{side}.png") for side in ("left", "right")
            )
            yield StereoFrame(str(number), int(self.times_ns[number]), left, right, left.size_px())

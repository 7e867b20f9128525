"""What is said of poses that another program estimated."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path


@dataclass(frozen=True, slots=True)
class PoseBody:
    """Whose poses are given, and what the body is that has them; as in `PoseSource`."""

    name: str = "poses"
    axes: str = "flu"
    point_flu_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class PoseSource:
    """Where given poses are, and what is said of them; None for what is not said.

    `file` is a TUM or KITTI file or a bag, and `topic` a topic of it, or without a file of the
    drive's own bag. `axes` are where x, y and z of the body point (flu, rdf), `point_flu_m` where
    its origin is, forward, left and up of the sensor (of a pair the middle of its baseline; of a
    drive without a rig the antenna). `times` is a file with the times of a KITTI file, and
    `offset_ns` is added to all times.
    """

    file: Path | None = None
    topic: str | None = None
    axes: str | None = None
    point_flu_m: tuple[float, float, float] | None = None
    times: Path | None = None
    offset_ns: int | None = None

    def over(self, other: PoseSource | None) -> PoseSource:
        """This, and what `other` says beside it."""
        said = {f.name: v for f in fields(self) if (v := getattr(self, f.name)) is not None}
        return self if other is None else replace(other, **said)

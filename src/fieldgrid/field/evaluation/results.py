"""What an evaluation against truth gives: scores of groups of frames, and errors of each."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from fieldgrid.field.evaluation.attitude import AttitudeScores
from fieldgrid.field.evaluation.terrain import TerrainScores


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Errors of the accepted frames' poses: absolute values, metres and degrees.

    `position_within_3_sigma` is the share whose distance from the truth is at most three times the
    stated error along one axis, `heading_within_3_sigma` that of headings.
    """

    frames: int
    rejected: int
    position_median_m: float | None
    position_max_m: float | None
    position_within_3_sigma: float | None
    heading_median_deg: float | None
    heading_p95_deg: float | None
    heading_max_deg: float | None
    heading_within_3_sigma: float | None


@dataclass(frozen=True, slots=True)
class ObstacleScores:
    """Obstacle cells of the map against the truth, by tolerance in metres.

    `precision`: share of the map's obstacle cells with a true one within the tolerance.
    `recall`: share of the observable true cells, in view of the frames, with an obstacle cell
    of the map within it. `free_with_obstacle`: share of the free cells in which there is an
    observable obstacle. None where there is nothing to divide by.
    """

    obstacle_cells: int
    observable_cells: int
    free_cells: int
    precision: dict[str, float | None]
    recall: dict[str, float | None]
    free_with_obstacle: float | None


@dataclass(frozen=True, slots=True)
class GroupScores:
    """The scores of one selection of frames."""

    name: str
    obstacles: ObstacleScores
    poses: PoseErrors


@dataclass(frozen=True, slots=True)
class FrameError:
    """One frame's pose against the truth; errors are signed, map minus truth."""

    frame_id: str
    segment: str
    direction: str
    status: str
    east_error_m: float
    north_error_m: float
    position_sigma_m: float
    heading_error_deg: float
    heading_sigma_deg: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scores of a map, as `fieldgrid evaluate --json` prints them.

    Of `unlevelled_frames` nobody knew how the vehicle leaned: their poses are of the point below
    the camera as if it stood level, and the truth's of the camera itself. `terrain` is None where
    the truth or the map has no ground, `attitude` where neither tells roll and pitch.
    """

    cell_m: float
    observable_pixels: int
    unmatched_frames: int
    unlevelled_frames: int
    groups: tuple[GroupScores, ...]
    frames: tuple[FrameError, ...]
    terrain: TerrainScores | None = None
    attitude: AttitudeScores | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists, ready for JSON (NaN and infinity become None)."""
        return _jsonable(asdict(self))  # type: ignore[no-any-return]


def _jsonable(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _jsonable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_jsonable(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""Whether the frames of a drive agree on what stands.

What one frame calls an obstacle, another that was taken a metre or two beside it and saw the place
should not call free ground. False matches differ from frame to frame, so noise, hard compression
and dirt show in the share of obstacle cells that are denied so, without any truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fieldgrid.core import Finding, warning
from fieldgrid.geometry import Lidar, Rig
from fieldgrid.maps import StagedFrames
from fieldgrid.pipeline.checks.contradictions import FramePose, denied_counts, following, opposed

DENIED_WARN = 0.012
"""The denied share from which on it is told. Three rendered vineyards with two receivers each have
0.0 to 0.3 %, KITTI's street, with its passers-by, 0.0 to 0.6. One of the vineyards with noise of
12, 18 and 25 grey levels has 0.6, 2.6 and 3.4 %, with JPEG of quality 20, 12 and 8 0.9, 1.9 and
3.5 %, where the precision of its map at 10 cm falls from 95 to 89, 80, 67 and to 88, 78, 59 %."""

APART_M, FEWEST_CELLS, FEWEST_PAIRS = (0.7, 4.0), 30, 8
"""How far apart two frames are taken that are compared, how many obstacle cells of the one the
other must have seen, and how many such pairs tell anything."""

OPPOSED_APART_M, OPPOSED_PAIRS, FEWEST_OPPOSED = 12.0, 120, 200
"""How far apart frames of opposite lanes are taken, how many pairs of them are compared, and how
many obstacle cells others must have seen."""

OPPOSED_WARN, SURE_M = 0.08, 0.1
"""The share from which on it is told, and how sure the poses must be at the median for it to be no
matter of the receiver. Three rendered vineyards have 0 to 3 % with RTK."""

PAIRS = 60
"""Number of pairs of frames that are compared, all over the drive."""


def denied_share(frames: StagedFrames, placed: Sequence[FramePose]) -> float | None:
    """The share of the obstacle cells of a frame that another frame, taken near it, saw and calls
    free. `placed` are the accepted ones in order of time.

    It is the lower quartile of pairs of frames: three of four deny more. Who passes by, or one pose
    that leaps, is in few pairs, and false matches are in all. None where too few frames see the
    same obstacles.
    """
    denied, seen = denied_counts(frames, following(placed, APART_M, PAIRS))[:, 0].T
    enough = seen >= FEWEST_CELLS
    shares = denied[enough] / seen[enough]
    return float(np.quantile(shares, 0.25)) if len(shares) >= FEWEST_PAIRS else None


def opposed_share(frames: StagedFrames, placed: Sequence[FramePose]) -> float | None:
    """The share of the obstacle cells of frames that is denied by frames which look the other way,
    as those of the lanes on both sides of a row; `placed` as for `denied_share`.

    What lies in the same way beside the vehicle in all frames, lies to the one side of a row in one
    lane and to the other in the next. Where that takes the lanes together, each sees free ground
    in the other's row; where it takes them apart, nothing is seen twice and nothing told. None
    where too little is.
    """
    pairs = opposed(placed, OPPOSED_APART_M, OPPOSED_PAIRS)
    denied, seen = denied_counts(frames, pairs).sum(axis=(0, 1)).tolist()
    return float(denied / seen) if seen >= FEWEST_OPPOSED else None


def agreement_findings(share: float | None, rig: Rig) -> Iterator[Finding]:
    """That frames do not agree; a lidar sees the same thing with few points,
    or with none."""
    if share is None or share <= DENIED_WARN or isinstance(rig.sensor, Lidar):
        return
    yield warning(
        "frames-disagree",
        "In three of four pairs of frames, taken some metres apart, the other frame calls more "
        f"than {100.0 * share:.1f} % of a frame's obstacle cells free (good images: at most "
        "0.6 %), so the map has false obstacles.",
        "Check the images for noise, strong compression, dirt and rain; record them with more "
        "light and less gain, without lossy compression.",
    )


def opposed_findings(share: float | None, position_sigma_m: float | None) -> Iterator[Finding]:
    """That lanes contradict each other more than their receiver lets them."""
    is_sure = position_sigma_m is not None and position_sigma_m <= SURE_M
    if share is None or share <= OPPOSED_WARN or not is_sure:
        return
    yield warning(
        "lanes-disagree",
        f"In lanes driven in opposite directions, frames of one lane call {100.0 * share:.0f} % of "
        "the other's obstacle cells free (with RTK and a correct mounting at most 3 %), so the two "
        "lanes place the row between them differently.",
        "Check the lateral position of the antenna in the mounting, then camera_yaw_deg.",
    )

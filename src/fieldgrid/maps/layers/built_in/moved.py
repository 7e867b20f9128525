"""What moved while a drive went on: seen as an obstacle, later as free ground from as near.

A person who walks away leaves a trail of obstacles in the mean of a drive. A frame's *look* at a
cell is an obstacle where a local cell above 100 lies there. It is clear where the line of sight
passes no obstacle shortly before, and neither an obstacle nor much unseen ground lies within a
margin: what was seen from afar was seen elsewhere by the error of its range, and is no thing that
moved. Clear looks from farther than the obstacle was seen from do not count, nor do those from so
near that what hangs there is out of the picture. A frame leaves pinholes, so a look is at what lies
around the middle of a cell, whether or not that very cell was seen.

A cell has *moved* in a drive where the latest looks at it are clear. It is evidence of its own:
density and all other layers are as ever, but for `remaining`, from which it is left out.
"""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Bool, Float32, Int64, UInt8, UInt64, kernel, palette
from fieldgrid.geometry import FREE_UP_TO, HIDDEN_FROM, OBSTACLE_ABOVE, Lattice
from fieldgrid.maps.layers.built_in.density import DENSITIES
from fieldgrid.maps.layers.built_in.lasting import lasting_density
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameInPlace
from fieldgrid.maps.transfer import footprint, seen_span

LEAST_CLEAR, LEAST_LOOKS = 2, 4
"""Clear looks since the latest obstacle, and looks of both kinds, that tell of a thing that moved.
One that walks stands in a cell for a look; what flickers is not clear three times running."""

LEAST_HITS = 3
"""Local cells above 100, around the middle of a cell, that are an obstacle: a lone one is noise."""

APART_NS = 500_000_000
"""Looks that are not so far apart in time count as one: they share the errors of their images."""

AS_NEAR = 1.1
"""A clear look counts up to this many times the least distance from which the obstacle was seen."""

NEAREST_M = 2.0
"""Clear looks from nearer do not count: a branch that hangs there may be above the picture."""

MARGIN_M, MARGIN_SHARE = 0.3, 0.05
"""What a clear look is clear of, and the share of its distance by which that grows."""

SEEN_SHARE = 0.5
"""How much of that was seen: a frame leaves pinholes, in a tenth to a third of the ground."""


class _Looks:
    """Of each cell how many looks saw an obstacle, from how near, and how many since were clear.

    Frames come in the order of their time; those of one time in any. Pages of the arrays that no
    obstacle touches are never taken from the system.
    """

    def __init__(self, cells: int, lattice: Lattice) -> None:
        self._per_m = lattice.cells_per_m
        self._looks: UInt8 = np.zeros((cells, 2), dtype=np.uint8)
        self._near_m: Float32 = np.zeros(cells, dtype=np.float32)
        self._when_ns: Int64 = np.zeros((cells, 3), dtype=np.int64)
        self._seen: Bool = np.zeros(cells, dtype=np.bool_)

    def add(self, frame: FrameInPlace) -> None:
        grid, pose = frame.cells.grid, frame.pose
        self._seen[frame.touched] = True
        place = footprint(grid.spec, pose, frame.lattice).intersect(frame.window)
        if place is None:
            return
        phi = math.radians(pose.heading_deg)
        n_y, n_x = grid.spec.shape
        # Each kind of array that a kernel makes costs it three more functions to compile.
        room = *np.zeros((2, n_y, n_x), np.uint8), *np.zeros((2, n_y, n_x + 1), np.int32)
        add_looks(
            *(grid.density, grid.observed, *room, grid.spec.cell_m, self._per_m),
            *(pose.east_m, pose.north_m, math.cos(phi), math.sin(phi), pose.time_ns),
            *(*place, frame.window.i0, frame.window.j0, frame.window.width),
            *(self._looks, self._near_m, self._when_ns),
        )

    def channels(self) -> UInt64:
        stood, clear = self._looks[:, 0], self._looks[:, 1]
        moved = self._seen & (clear >= LEAST_CLEAR)
        if not moved.any():
            return nothing((1, moved.size))
        moved &= clear.astype(np.int64) + stood >= LEAST_LOOKS
        return moved.astype(np.uint64)[None]


@kernel
def add_looks(  # type: ignore[no-untyped-def]
    density, observed, stands, hits, before, others,
    local_m, per_m, east_m, north_m, cos, sin, time_ns,
    i0, j0, width, height, window_i0, window_j0, window_width, looks, near_m, when_ns,
):  # fmt: skip
    """Add what a frame [n_y, n_x] says of the cells of a place in the window.

    `stands` and `hits` [n_y, n_x], `before` and `others` [n_y, n_x + 1] are room, all 0: for what
    stands by a local cell and those around, as far as a cell of the window reaches; and for how
    many cells of a row before each were seen, and how many of them are not free.

    `looks` [cells, 2] counts obstacles since the cell was last clear, and clear looks since these;
    `near_m` is the least distance of the obstacles; `when_ns` [cells, 3] is when anything was last
    seen standing, and when a look of either kind last counted.
    """
    n_y, n_x = density.shape
    half, around = 0.5 * n_x, int(0.71 / (per_m * local_m) + 0.5)
    for r in range(n_y):
        start, end = seen_span(observed[r])
        for c in range(start, end):
            value = density[r, c]
            before[r, c + 1] = before[r, c] + observed[r, c]
            others[r, c + 1] = others[r, c] + (observed[r, c] and value > FREE_UP_TO)
            if not observed[r, c] or value <= FREE_UP_TO:
                continue
            for j in range(max(r - around, 0), min(r + around + 1, n_y)):
                for i in range(max(c - around, 0), min(c + around + 1, n_x)):
                    stands[j, i] = 1
                    if value > OBSTACLE_ABOVE:
                        hits[j, i] = min(hits[j, i] + 1, 255)
        for c in range(end, n_x):
            before[r, c + 1], others[r, c + 1] = before[r, c], others[r, c]
    # Where the middles of the cells of a row lie in the grid, in local cells.
    across, along = np.empty(width), np.empty(width)
    lines, columns = np.empty(width, np.int32), np.empty(width, np.int32)
    for cell_j in range(j0, j0 + height):
        away_n = (cell_j + 0.5) / per_m - north_m
        # The columns between the sides of the grid, and between its ends, a cell more on each side.
        first, last = i0, i0 + width
        for slope, low, high in (
            (cos, away_n * sin - half * local_m, away_n * sin + half * local_m),
            (sin, -away_n * cos, n_y * local_m - away_n * cos),
        ):
            if abs(slope) > 1e-3:
                low, high = (east_m + low / slope) * per_m, (east_m + high / slope) * per_m
                first = max(first, int(np.floor(min(low, high))) - 1)
                last = min(last, int(np.floor(max(low, high))) + 2)
        for i in range(last - first):  # in vector registers, as in `locate`
            away_e = (first + i + 0.5) / per_m - east_m
            across[i] = (away_e * cos - away_n * sin) / local_m
            along[i] = (away_e * sin + away_n * cos) / local_m
            columns[i] = np.int32(np.floor(across[i] + half))
            lines[i] = np.int32(np.floor(along[i]))
        for cell_i in range(first, last):
            r, c = lines[cell_i - first], columns[cell_i - first]
            if r < 0 or c < 0 or r >= n_y or c >= n_x:
                continue
            x, y = across[cell_i - first], along[cell_i - first]
            k = (cell_j - window_j0) * window_width + cell_i - window_i0
            if stands[r, c]:
                if looks[k, 1] > (1 if when_ns[k, 2] == time_ns else 0):
                    looks[k, 0] = 0  # it was clear before, and something has come
                looks[k, 1], when_ns[k, 0] = 0, time_ns
                if hits[r, c] >= LEAST_HITS:
                    away_m = np.float32(local_m * np.sqrt(x * x + y * y))
                    if looks[k, 0] == 0 or away_m < near_m[k]:
                        near_m[k] = away_m
                    if looks[k, 0] == 0 or time_ns - when_ns[k, 1] >= APART_NS:
                        looks[k, 0], when_ns[k, 1] = min(looks[k, 0] + 1, 255), time_ns
                continue
            if looks[k, 0] == 0 or when_ns[k, 0] == time_ns:
                continue
            if looks[k, 1] > 0 and time_ns - when_ns[k, 2] < APART_NS:
                continue
            away_m = local_m * np.sqrt(x * x + y * y)
            if away_m < NEAREST_M or away_m > AS_NEAR * near_m[k]:
                continue
            # All places within the margin, row by row from the middle, where most are refused.
            reach = (MARGIN_M + MARGIN_SHARE * away_m) / local_m
            clear, whole, seen, places = True, int(reach), 0, 0
            for n in range(2 * whole + 1):
                dj = (n + 1) // 2 if n % 2 else -(n // 2)
                aside = int(np.sqrt(reach * reach - dj * dj))
                if aside * aside + dj * dj > reach * reach:  # the root was rounded up
                    aside -= 1
                places += 2 * aside + 1
                j, left, right = r + dj, max(c - aside, 0), min(c + aside + 1, n_x)
                if j < 0 or j >= n_y:
                    continue
                if others[j, right] > others[j, left]:
                    clear = False
                    break
                seen += before[j, right] - before[j, left]
            if not clear or seen < SEEN_SHARE * places:
                continue
            # The line of sight, in steps of half a cell.
            steps = int(2.0 * (1.0 - HIDDEN_FROM) * away_m / local_m) + 1
            for n in range(1, steps + 1):
                share = 1.0 - (1.0 - HIDDEN_FROM) * n / steps
                j, i = int(y * share), int(np.floor(x * share + half))
                if observed[j, i] and density[j, i] > OBSTACLE_ABOVE:
                    clear = False
                    break
            if clear:
                looks[k, 1], when_ns[k, 2] = min(looks[k, 1] + 1, 255), time_ns


def _remaining(cells: Cells) -> UInt64:
    """`lasting`, and 0 where something moved unless most drives saw an obstacle all the same.

    Whether a drive in which it moved has an obstacle in the mean is not kept: drives that stood are
    then as many as they can be, so that in doubt an obstacle remains.
    """
    moved, seen = cells["moved_drives"], cells["seen_sessions"]
    stood = np.minimum(cells["obstacle_sessions"], seen - moved)
    gone = (moved > 0) & (np.uint64(2) * stood <= seen)
    return np.where(gone, 0, lasting_density(cells)).astype(np.uint64)


GROUP = ChannelGroup(
    "moved",
    (Channel("moved_drives", coarser=Combine.MAX),),
    fold=_Looks,
)

LEFT = ChannelGroup(
    "remaining",
    (),
    follows_from=("density", "sessions", GROUP.name),
    overview=(OverviewChannel("remaining_peak", Combine.MAX, _remaining),),
)

MOVED = Layer(
    "moved",
    "uint8",
    "",
    "1: something stood there that had moved away later in the same drive; of a larger cell, in "
    "any of its base cells",
    ("density", GROUP.name),
    lambda cells: cells["moved_drives"] > 0,
    None,
    Colours((palette.DENSITY[0].colour, palette.DENSITY[-1].colour), 0.0, 1.0),
)

REMAINING = Layer(
    "remaining",
    "uint8",
    "",
    "as lasting, and 0 where what stood moved away within a drive",
    ("density", "sessions", GROUP.name, LEFT.name),
    lambda cells: cells["remaining_peak"],
    None,
    DENSITIES,
)

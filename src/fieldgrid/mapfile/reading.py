"""Reading a view: from the stored tiles where they have it, else from the frames.

Cells of a whole multiple of the map's own follow from those, by one rule. Others are folded anew,
but for what only the map's own cells can tell: the highest in them, and how much was seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import AnyArray, Bool
from fieldgrid.cost import DENSITIES
from fieldgrid.errors import ConfigError
from fieldgrid.lattice import TILE_CELLS, Bounds, Lattice, Window, tile_window
from fieldgrid.layers import GROUPS, LAYERS, Cells, ChannelGroup, Layer, groups_of
from fieldgrid.mapfile.base_cells import Multiple, enlarged, follows_from_touched
from fieldgrid.mapfile.change import ChangeView, latest_states, outcome, unseen
from fieldgrid.mapfile.decision import (
    FREE,
    KEEPOUT,
    OBSTACLE,
    MarkedCells,
    Partly,
    cells_under,
    deciding,
    marked_cells,
)
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.history import during, until
from fieldgrid.mapfile.marks import read_marks
from fieldgrid.mapfile.png import decode_png
from fieldgrid.mapfile.records import FrameRecord
from fieldgrid.mapfile.sources import (
    CellSource,
    FoldedFrames,
    FoldedOverBase,
    Larger,
    SessionSource,
    StoredLevel,
    StoredSessions,
)
from fieldgrid.mapfile.tiles import TileTables
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.view import MapView, check_size, empty_view, fold_as_the_paper
from fieldgrid.mapfile.workers import in_order
from fieldgrid.transfer import Averaging, Transfer, check_cell_sizes, mean_density

_CHUNK_CELLS = 1280
"""Stored cells along the side of a square that is worked on at a time, for odd cell sizes."""


class Request(NamedTuple):
    """What is asked of a map; `sessions` in the order of their drives, None for all active."""

    lattice: Lattice
    window: Window
    transfer: Transfer
    averaging: Averaging = Averaging.MEAN
    sessions: tuple[str, ...] | None = None
    frame_filter: Callable[[FrameRecord], bool] | None = None
    layers: tuple[str, ...] = ()

    @property
    def beyond_density(self) -> tuple[str, ...]:
        """The layers beside the density."""
        return tuple(name for name in self.layers if name != "density")


def read_view(evidence: Evidence, header: Header, request: Request) -> MapView:
    """The view, with the marks that are in force."""
    marks = read_marks(evidence.connection)
    view = replace(_read(evidence, header, request), marks=marks)
    if view.is_base or "seen_share" not in request.layers:
        return view  # which decides nothing, or by its own cells
    windows = []
    for mark in deciding(marks):
        touched = header.lattice.bounds(cells_under(mark, header.lattice))
        if part := request.lattice.window(touched).intersect(request.window):
            windows.append(part)
    if not windows:
        return view
    by = enlarged((), header.lattice, request.lattice)
    flags, partly = np.zeros(request.window.shape, np.uint8), []
    for chunk in chunks(reduce(Window.union, windows), by.factor):
        base = marked_cells(marks, header.lattice, by.under(chunk))
        found = flags[request.window.slices_of(chunk)]
        for flag in (KEEPOUT, OBSTACLE):
            found |= by.highest(base & np.uint8(flag), chunk)
        free = (base & FREE) > 0
        some, rest = (by.highest(one.view(np.uint8), chunk) > 0 for one in (free, ~free))
        found[some & ~rest] |= np.uint8(FREE)
        if (some & rest).any():
            partly.append(_partly_free(evidence, header, request, chunk, some & rest))
    return replace(view, marked=MarkedCells(flags, tuple(partly)))


def _partly_free(
    evidence: Evidence, header: Header, request: Request, chunk: Window, cells: Bool
) -> Partly:
    """What the map's own cells say of those larger ones of which a part is marked as free."""
    j, i = np.nonzero(cells)
    i0, j0 = int(i.min()), int(j.min())
    part = Window(chunk.i0 + i0, chunk.j0 + j0, int(i.max()) - i0 + 1, int(j.max()) - j0 + 1)
    by = enlarged((), header.lattice, request.lattice)
    names = tuple(name for name in DENSITIES if name in request.layers)
    own = request._replace(lattice=header.lattice, window=by.under(part), layers=names)
    base = _read(evidence, header, own)
    free = (marked_cells(read_marks(evidence.connection), own.lattice, own.window) & FREE) > 0
    inside = j - j0, i - i0
    place = j + chunk.j0 - request.window.j0, i + chunk.i0 - request.window.i0
    worst = {}
    for name in dict.fromkeys(("density", *names)):
        values = np.where(base.observed & ~free, base.layer(name), np.uint8(0))
        worst[name] = by.highest(values, part)[inside]
    return Partly(*place, worst, by.share(base.observed | free, part)[inside])


def _read(evidence: Evidence, header: Header, request: Request) -> MapView:
    """What the drives saw, by the shortest way that gives the same bits."""
    view = empty_view(
        request.lattice,
        request.window,
        header.datum,
        request.beyond_density,
        is_base=request.lattice == header.lattice,
    )
    if request.averaging is Averaging.PAPER:
        if request.beyond_density:
            raise ConfigError(
                "The paper's averaging gives a density only; leave the other layers out."
            )
        frames = evidence.accepted(view.bounds, request.sessions, request.frame_filter)
        _check_cells(request.lattice, frames)
        fold_as_the_paper(view, frames)
        return view
    level = _picture_level(evidence, header, request)
    if level is not None:
        _draw_pictures(view, evidence, header, level)
        return view
    reach = math.floor(reach_cells(request))
    wide = request._replace(window=request.window.grown(reach))
    source, factor = cell_source(evidence, header, wide)

    def fill(chunk: Window) -> None:
        looked = chunk.grown(reach)
        cells = source.merged(looked)
        if cells is not None:
            _write(view, chunk, looked, cells)

    for _ in in_order(fill, chunks(request.window, factor)):
        pass
    return view


def read_change(
    evidence: Evidence,
    header: Header,
    request: Request,
    between: tuple[str | int, str | int],
    path: Path,
) -> ChangeView:
    """What changed between two moments; ConfigError when no drive is up to or after the first.

    In cells of any size an obstacle is what holds one of the map's own cells that is one, and it
    is gone only where each of those was seen again.
    """
    check_size(request.lattice, request.window)
    sessions = evidence.sessions()
    early, late = ([info.name for info in until(at, sessions, path)] for at in between)
    late = [name for name in late if name not in early]
    if not early or not late:
        gap = f"after {between[0]} and up to {between[1]}" if early else f"up to {between[0]}"
        raise ConfigError(
            f"{path} has no session {gap}, so there is nothing to compare; `fieldgrid sessions` "
            "lists the dates of its drives."
        )
    for info in sessions:
        if info.grid is not None and info.name in (*early, *late):
            check_cell_sizes(request.lattice.cell_m, info.grid.cell_m)
    change = np.zeros(request.window.shape, dtype=np.uint8)
    groups = (GROUPS["density"],)
    by = enlarged(groups, header.lattice, request.lattice)
    own = request._replace(
        lattice=header.lattice,
        window=by.under(request.window),
        sessions=(*early, *late),
    )
    source = session_source(evidence, header, own, groups)

    def fill(chunk: Window) -> None:
        under = by.under(chunk)
        states = latest_states(under.shape, source.by_session(under), late)
        before, after, lost = (by.highest(values, chunk) for values in (*states, unseen(states)))
        after[(lost > 0) & (after == 1)] = 0
        change[request.window.slices_of(chunk)] = outcome(np.stack([before, after]))

    for _ in in_order(fill, chunks(request.window, by.factor)):
        pass
    names = tuple(early), tuple(late)
    return ChangeView(request.lattice, request.window, change, header.datum, *names)


def cell_source(evidence: Evidence, header: Header, request: Request) -> tuple[CellSource, float]:
    """Where the cells that are asked for come from, and how many of those that are looked into lie
    along the side of one."""
    groups = tuple(GROUPS[name] for name in groups_of(request.layers))
    by = enlarged(groups, header.lattice, request.lattice)
    own = request._replace(lattice=header.lattice, window=by.under(request.window))
    if isinstance(by, Multiple):
        base, multiple = _own_cells(evidence, header, own, groups, by.factor)
        return Larger(base, Multiple(groups, multiple)), multiple
    folded = session_source(evidence, header, request, groups)
    if not request.beyond_density:
        return folded, 1
    touched = tuple(group for group in groups if follows_from_touched(group))
    base, _ = _own_cells(evidence, header, own, touched, 1)
    return FoldedOverBase(folded, Larger(base, by._replace(groups=touched)), groups), by.factor


def _own_cells(
    evidence: Evidence,
    header: Header,
    request: Request,
    groups: tuple[ChannelGroup, ...],
    multiple: int,
) -> tuple[CellSource, int]:
    """Where the map's own cells come from, or stored ones of a higher level of which fewer make up
    one of `multiple`."""
    if request.sessions is not None or not _stored(header, request, groups):
        return session_source(evidence, header, request, groups), multiple
    level, derived = 0, any(group.derived for group in groups)
    while not derived and level < evidence.levels() and multiple % 2 == 0:
        level, multiple = level + 1, multiple // 2
    return StoredLevel(_tables(evidence, header, groups), level, groups), multiple


def session_source(
    evidence: Evidence, header: Header, request: Request, groups: tuple[ChannelGroup, ...]
) -> SessionSource:
    """What tells the sessions apart: their own tiles, or their frames folded anew."""
    names = request.sessions
    if names is None:
        names = tuple(info.name for info in evidence.active())
    if request.lattice == header.lattice and _stored(header, request, groups):
        tables = _tables(evidence, header, groups)
        return StoredSessions(tables, evidence.session_ids(names), groups)
    near = request.lattice.bounds(request.window)
    frames = evidence.accepted(near, names, request.frame_filter)
    _check_cells(request.lattice, frames)
    by_session = [(name, [f for f in frames if f.session == name]) for name in names]
    return FoldedFrames(request.lattice, request.transfer, groups, by_session)


def _stored(header: Header, request: Request, groups: tuple[ChannelGroup, ...]) -> bool:
    """Whether tiles hold what is asked for, by the rule that is asked for."""
    by_own_rule = request.transfer is header.transfer and request.frame_filter is None
    wanted = {group.name for group in groups if not group.derived}
    return by_own_rule and wanted <= set(header.groups)


def _tables(evidence: Evidence, header: Header, groups: tuple[ChannelGroup, ...]) -> TileTables:
    """The tiles of the groups that are stored."""
    stored = [group for group in groups if not group.derived]
    return TileTables(evidence.connection, TileMatrixSet(header.lattice), stored)


def reach_cells(request: Request) -> float:
    """How many cells about a cell enter into what the layers say of it."""
    around = (LAYERS[name].around for name in request.layers)
    return max((one.reach_m for one in around if one is not None), default=0.0) / (
        request.lattice.cell_m
    )


def _write(view: MapView, chunk: Window, looked: Window, cells: Cells) -> None:
    """Fill a part of a view, and of its layers, from the channels of the cells of a window about
    it."""
    place, inside = view.window.slices_of(chunk), looked.slices_of(chunk)
    view.density[place], view.observed[place] = mean_density(
        cells["weight"][inside], cells["sum"][inside]
    )
    for name, array in view.layers.items():
        array[place] = layer_values(LAYERS[name], cells, view.lattice.cell_m)[inside]


def layer_values(layer: Layer, cells: Cells, cell_m: float) -> AnyArray:
    """What a layer says of cells of a window, and what stands for those of which nothing was
    observed."""
    values = np.where(cells["seen"] > 0, layer.values(cells), layer.nodata or 0)
    if layer.around is None:
        return values
    return layer.around.of(values, layer.around.reach_m / cell_m)


def chunks(window: Window, factor: float) -> Iterator[Window]:
    """A window cut into squares of about a million stored cells, `factor` along the side of one of
    its own; where tiles begin, if that is a small whole number."""
    side = max(1, int(_CHUNK_CELLS / factor))
    if factor in (1, 2, 3, 4, 5):
        side = TILE_CELLS * max(1, int(4 // factor))
    for j0 in range(window.j0 // side * side, window.j0 + window.height, side):
        for i0 in range(window.i0 // side * side, window.i0 + window.width, side):
            chunk = window.intersect(Window(i0, j0, side, side))
            assert chunk is not None
            yield chunk


def _picture_level(evidence: Evidence, header: Header, request: Request) -> int | None:
    """The zoom level, from the base up, whose pictures have all that is asked for, if any has."""
    plain = request.sessions is None and request.frame_filter is None and not request.beyond_density
    by = enlarged((), header.lattice, request.lattice)
    if not (plain and isinstance(by, Multiple)) or request.transfer is not header.transfer:
        return None
    level = by.factor.bit_length() - 1
    return level if by.factor == 1 << level and level <= evidence.levels() else None


def _draw_pictures(view: MapView, evidence: Evidence, header: Header, level: int) -> None:
    """Fill a view from the pictures of a level: they hold just the mean and the mask, and are read
    several times as fast as the sums that they were drawn from."""
    matrices = TileMatrixSet(header.lattice)

    def draw(picture: tuple[object, ...]) -> None:
        tile, blob = picture
        cells = tile_window(tile)  # type: ignore[arg-type]
        part = cells.intersect(view.window)
        if part is not None:
            # Its first row is the northernmost.
            grey_alpha = decode_png(blob, f"picture of tile {tuple(tile)}")[::-1]  # type: ignore[arg-type]
            grey_alpha = grey_alpha[cells.slices_of(part)]
            place = view.window.slices_of(part)
            view.density[place] = grey_alpha[..., 0]
            np.not_equal(grey_alpha[..., 1], 0, out=view.observed[place])

    for _ in in_order(draw, evidence.pictures(view.window, matrices, level)):
        pass


def sessions_at(evidence: Evidence, at: str | int, path: Path) -> tuple[str, ...]:
    """The active sessions as of a moment, or of `FROM..TO`; ConfigError when there are none."""
    found = tuple(info.name for info in during(at, evidence.sessions(), path))
    if not found:
        when = f"in {at}" if ".." in str(at) else f"up to {at}"
        raise ConfigError(
            f"{path} has no session {when}; `fieldgrid sessions` lists the dates of its drives."
        )
    return found


def extent_of(evidence: Evidence, header: Header) -> Bounds:
    """The observed cells' outer edges; MapError when there are none."""
    return header.lattice.bounds(evidence.data_window())


def _check_cells(lattice: Lattice, frames: list[FrameRecord]) -> None:
    for frame in frames:
        check_cell_sizes(lattice.cell_m, frame.spec.cell_m)

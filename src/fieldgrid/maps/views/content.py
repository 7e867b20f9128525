"""What views of one map are made of: its stored tiles where they have it, else its frames.

Cells of a whole multiple of the map's own follow from those, by one rule. Others are folded anew,
but for what only the map's own cells can tell: the highest in them, and how much was seen.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError, in_order
from fieldgrid.geometry import Lattice, Window, tile_window
from fieldgrid.maps.file.evidence import EvidenceTables
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.history import until
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import whole_blocks
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.registry import GROUPS, groups_of
from fieldgrid.maps.layers.window import with_overviews
from fieldgrid.maps.tiles.png import decode_png
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.transfer import Averaging, check_cell_sizes
from fieldgrid.maps.vector.marks import Mark, read_marks
from fieldgrid.maps.views.base_cells import Multiple, enlarged, follows_from_touched
from fieldgrid.maps.views.change import ChangeView, latest_states, outcome, unseen
from fieldgrid.maps.views.driven import DrivenWay
from fieldgrid.maps.views.read import Request, chunks
from fieldgrid.maps.views.sources import (
    CellSource,
    FoldedFrames,
    FoldedOverBase,
    LargerCells,
    StoredLevel,
)
from fieldgrid.maps.views.view import MapView, check_size, fold_as_the_paper
from fieldgrid.maps.writing.sharing import SharedMap, check_known, known_groups, opened, shared


class MapContent:
    """The content of one map, as `evidence` and `header` have it. Pickled it is where the map
    lies; where it arrives, that is opened again, for reading."""

    def __init__(self, evidence: EvidenceTables, header: MapHeader) -> None:
        self.evidence = evidence
        self.header = header

    def __reduce__(self) -> tuple[Any, ...]:
        there = shared(self.evidence.connection)
        return _arrived, (there, self.evidence.path, self.header, known_groups(self.header))

    def marks(self) -> tuple[Mark, ...]:
        """See `Content`."""
        return read_marks(self.evidence.connection)

    def ways(self, width_m: float, request: Request) -> list[DrivenWay]:
        """Where the drives went near a window of the own cells, in their order."""
        names = request.sessions
        if names is None:
            names = tuple(info.name for info in self.evidence.active())
        near = request.lattice.bounds(request.window)
        frames = self.evidence.accepted(near, names, request.frame_filter)
        groups = (GROUPS["density"],)
        cells: dict[str, Cells] = {}
        if len(names) > 1 and frames:
            cells = dict(self.session_source(request, groups).by_session(request.window))
        return [
            DrivenWay([one for one in frames if one.session == name], cells.get(name), width_m)
            for name in names
        ]

    def fill(self, view: MapView, request: Request) -> bool:
        """See `Content`: by the paper's averaging, or from pictures."""
        if request.averaging is Averaging.PAPER:
            if request.beyond_density:
                raise ConfigError(
                    "The paper's averaging gives a density only; leave the other layers out."
                )
            frames = self.evidence.accepted(view.bounds, request.sessions, request.frame_filter)
            _check_cells(request.lattice, frames)
            fold_as_the_paper(view, frames)
            return True
        level = self._picture_level(request)
        if level is not None:
            matrices = TileMatrixSet(self.header.lattice)

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

            for _ in in_order(
                draw, self.evidence.pictures(view.window, matrices, level), request.jobs
            ):
                pass
        return level is not None

    def cell_source(self, request: Request) -> tuple[CellSource, float]:
        """See `Content`."""
        groups = tuple(GROUPS[name] for name in groups_of(request.layers))
        by = enlarged(groups, self.header.lattice, request.lattice)
        own = request._replace(lattice=self.header.lattice, window=by.under(request.window))
        if isinstance(by, Multiple):
            base, multiple = self.own_cells(own, groups, by.factor)
            return LargerCells(base, Multiple(groups, multiple)), multiple
        folded = self.session_source(request, groups)
        if not request.beyond_density:
            return folded, 1
        touched = tuple(group for group in groups if follows_from_touched(group))
        base, _ = self.own_cells(own, touched, 1)
        return FoldedOverBase(
            folded, LargerCells(base, by._replace(groups=touched)), groups
        ), by.factor

    def own_cells(
        self, request: Request, groups: tuple[ChannelGroup, ...], multiple: int = 1
    ) -> tuple[CellSource, int]:
        """Where the map's own cells come from, or stored ones of a higher level of which fewer
        make up one of `multiple`."""
        wanted = {group.name for group in groups if not group.derived}
        own_rule = request.transfer is self.header.transfer and request.frame_filter is None
        if request.sessions is not None or not own_rule or not wanted <= set(self.header.groups):
            return self.session_source(request, groups), multiple
        # A map of format 3 may lack some groups above its own cells.
        level, is_whole = 0, not (self.header.is_old or any(group.derived for group in groups))
        while is_whole and level < self.evidence.levels() and multiple % 2 == 0:
            level, multiple = level + 1, multiple // 2
        return StoredLevel(self._tables(groups), level, groups), multiple

    def session_source(self, request: Request, groups: tuple[ChannelGroup, ...]) -> FoldedFrames:
        """The frames folded anew, which tell the sessions apart."""
        names = request.sessions
        if names is None:
            names = tuple(info.name for info in self.evidence.active())
        near = request.lattice.bounds(whole_blocks(request.window, request.lattice))
        frames = self.evidence.accepted(near, names, request.frame_filter)
        _check_cells(request.lattice, frames)
        by_session = [(name, [f for f in frames if f.session == name]) for name in names]
        return FoldedFrames(request.lattice, request.transfer, groups, by_session)

    def _picture_level(self, request: Request) -> int | None:
        """The zoom level, from the base up, whose pictures have all that is asked for; or None."""
        plain = (
            request.sessions is None and request.frame_filter is None and not request.beyond_density
        )
        by = enlarged((), self.header.lattice, request.lattice)
        if not (plain and isinstance(by, Multiple)) or request.transfer is not self.header.transfer:
            return None
        level = by.factor.bit_length() - 1
        return level if by.factor == 1 << level and level <= self.evidence.levels() else None

    def seen_cells(self) -> int:
        """How many of the map's own cells any frame observed: the uppermost tiles have the sum."""
        groups = (GROUPS["density"],)
        tables, level = self._tables(groups), self.evidence.levels()
        zoom = tables.matrices.base_zoom - level
        found = (tables.cells(zoom, tile) for tile in tables.tiles(zoom))
        seen = (c if level else with_overviews(groups, c) for c in found if c is not None)
        return sum(int(cells["seen"].sum()) for cells in seen)

    def _tables(self, groups: tuple[ChannelGroup, ...]) -> TileTables:
        """The tiles of those groups that are stored."""
        stored = [group for group in groups if not group.derived]
        return TileTables(self.evidence.connection, TileMatrixSet(self.header.lattice), stored)


def _arrived(there: SharedMap, path: Path, header: MapHeader, known: tuple[str, ...]) -> MapContent:
    """The content on a worker. ClusterError when it has another map, or none, or cannot read it."""
    check_known(known)
    return MapContent(EvidenceTables(opened(there), path), header)


def read_change(
    content: MapContent,
    request: Request,
    between: tuple[str | int, str | int],
    path: Path,
) -> ChangeView:
    """What changed between two moments; ConfigError when no drive is up to or after the first.

    In cells of any size an obstacle is what holds one of the map's own cells that is one, and it
    is gone only where each of those was seen again.
    """
    check_size(request.lattice, request.window)
    header, sessions = content.header, content.evidence.sessions()
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
    source = content.session_source(own, groups)

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


def _check_cells(lattice: Lattice, frames: list[FrameRecord]) -> None:
    for frame in frames:
        check_cell_sizes(lattice.cell_m, frame.spec.cell_m)

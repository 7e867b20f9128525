"""What views of one map are made of: its stored tiles where they have it, else its frames.

Cells of a whole multiple of the map's own follow from those, by one rule. Others are folded anew,
but for what only the map's own cells can tell: the highest in them, and how much was seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError, Threads
from fieldgrid.geometry import DROP_CHANNEL, Bounds, TileIndex, tile_window
from fieldgrid.maps.file.evidence import EvidenceTables
from fieldgrid.maps.file.header import MapHeader
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
from fieldgrid.maps.views.base_cells import (
    Multiple,
    Resampling,
    enlarged,
    follows_from_touched,
)
from fieldgrid.maps.views.read import Content, Request
from fieldgrid.maps.views.sources import (
    CellSource,
    FoldedFrames,
    LargerCells,
    StoredLevel,
    Together,
)
from fieldgrid.maps.views.view import MapView, fold_as_the_paper
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

    def tells_of_drops(self) -> bool:
        """See `Content`."""
        return "drop" in self.header.groups or self.evidence.has_channel(DROP_CHANNEL)

    def ways(self, request: Request) -> dict[str, list[FrameRecord]]:
        """See `Content`."""
        found: dict[str, list[FrameRecord]] = {name: [] for name in self._names(request)}
        for frame in self._frames(request, request.lattice.bounds(request.window)):
            found[frame.session].append(frame)
        return found

    def by_session(self, request: Request) -> Iterator[tuple[str, Cells]]:
        """See `Content`."""
        return self.session_source(request, (GROUPS["density"],)).by_session(request.window)

    def fill(self, view: MapView, request: Request) -> bool:
        """See `Content`: by the paper's averaging, or from pictures."""
        if request.averaging is Averaging.PAPER:
            if request.layers:
                raise ConfigError(
                    "The paper's averaging gives a density only; leave the other layers out."
                )
            fold_as_the_paper(view, self._frames(request, view.bounds))
            return True
        by = enlarged((), self.header.lattice, request.lattice)
        if (
            request.sessions is not None
            or request.frame_filter is not None
            or request.layers
            or request.transfer is not self.header.transfer
            or not isinstance(by, Multiple)
        ):
            return False
        level = by.factor.bit_length() - 1
        if by.factor != 1 << level or level > self.evidence.levels():
            return False

        def draw(picture: tuple[TileIndex, object]) -> None:
            tile, blob = picture
            cells = tile_window(tile)
            part = cells.intersect(view.window)
            if part is not None:
                # Its first row is the northernmost.
                grey_alpha = decode_png(blob, f"picture of tile {tuple(tile)}")[::-1]
                grey_alpha = grey_alpha[cells.slices_of(part)]
                place = view.window.slices_of(part)
                view.density[place] = grey_alpha[..., 0]
                np.not_equal(grey_alpha[..., 1], 0, out=view.observed[place])

        matrices = TileMatrixSet(self.header.lattice)
        for _ in Threads(request.jobs).in_order(
            draw, self.evidence.pictures(view.window, matrices, level)
        ):
            pass
        return True

    def cell_source(self, request: Request) -> tuple[CellSource, float]:
        """See `Content`."""
        groups = tuple(GROUPS[name] for name in groups_of(request.layers))
        by = enlarged(groups, self.header.lattice, request.lattice)
        own = request._replace(lattice=self.header.lattice, window=by.under(request.window))
        if isinstance(by, Multiple):
            base, multiple = self.own_cells(own, groups, by.factor)
            return LargerCells(base, Multiple(groups, multiple)), multiple
        return resampled(self, request, own, by)

    def own_cells(
        self, request: Request, groups: tuple[ChannelGroup, ...], multiple: int = 1
    ) -> tuple[CellSource, int]:
        """Where the map's own cells come from, or stored ones of a higher level of which fewer
        make up one of `multiple`."""
        own_rule = request.transfer is self.header.transfer and request.frame_filter is None
        kept = tuple(group for group in groups if group.name in self.header.groups)
        if request.sessions is not None or not own_rule or groups[0] not in kept:
            return self.folded(request, groups), multiple
        # A map of format 3 may lack some groups above its own cells.
        level, is_whole = 0, not self.header.is_old and kept == groups
        while is_whole and level < self.evidence.levels() and multiple % 2 == 0:
            level, multiple = level + 1, multiple // 2
        sources: list[CellSource] = [StoredLevel(self._tables(kept), level)]
        if level > 0:
            return sources[0], multiple
        others = [group for group in groups if group not in kept and not group.derived]
        if others:
            sources.append(self.session_source(request, (groups[0], *others)))
        return Together(sources, groups), multiple

    def folded(self, request: Request, groups: tuple[ChannelGroup, ...]) -> CellSource:
        """All that is asked for from frames folded anew."""
        return Together([self.session_source(request, groups)], groups)

    def session_source(self, request: Request, groups: tuple[ChannelGroup, ...]) -> FoldedFrames:
        """The frames folded anew, which tell the sessions apart."""
        near = request.lattice.bounds(whole_blocks(request.window, request.lattice))
        frames = self._frames(request, near)
        names = self._names(request)
        by_session = [(name, [f for f in frames if f.session == name]) for name in names]
        return FoldedFrames(request.lattice, request.transfer, groups, by_session)

    def _names(self, request: Request) -> tuple[str, ...]:
        """The sessions that are asked for, in the order of their drives."""
        if request.sessions is not None:
            return request.sessions
        return tuple(info.name for info in self.evidence.active())

    def _frames(self, request: Request, near: Bounds) -> list[FrameRecord]:
        """The frames that are asked for and may reach into bounds; ConfigError where the cells are
        smaller than theirs."""
        frames = self.evidence.accepted(near, self._names(request), request.frame_filter)
        for frame in frames:
            check_cell_sizes(request.lattice.cell_m, frame.spec.cell_m)
        return frames

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


def resampled(
    content: Content, request: Request, own: Request, by: Resampling
) -> tuple[CellSource, float]:
    """Cells that are no whole multiple of the `own` ones: frames folded anew, and beyond the
    density what only the own cells can tell."""
    folded = content.folded(request, by.groups)
    if not request.layers:
        return folded, 1
    touched = tuple(group for group in by.groups if follows_from_touched(group))
    base = LargerCells(content.own_cells(own, touched)[0], by._replace(groups=touched))
    # Maxima and overviews are those of the own cells: a new fold would blur what they tell apart.
    return Together([base, folded], by.groups, overviews=False), by.factor


def _arrived(there: SharedMap, path: Path, header: MapHeader, known: tuple[str, ...]) -> MapContent:
    """The content on a worker. ClusterError when it has another map, or none, or cannot read it."""
    check_known(known)
    return MapContent(EvidenceTables(opened(there), path), header)

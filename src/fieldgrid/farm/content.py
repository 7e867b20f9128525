"""What views over several maps are made of: the cells of each, as the layers' own rules join them.

A cell that two maps saw is what one map with the sessions of both would say of it. Larger cells of
places that a single map saw come from what that map stores of them; where the extents of two meet,
they follow from the joined own cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from fieldgrid.errors import MapError
from fieldgrid.farm.catalogue import Block
from fieldgrid.farm.maps import Maps, OpenMap
from fieldgrid.lattice import Bounds, Lattice, Window
from fieldgrid.layers import GROUPS, Cells, ChannelGroup, groups_of
from fieldgrid.layers.window import merge_sessions, with_overviews
from fieldgrid.mapfile import FrameRecord, MapView, Mark
from fieldgrid.mapfile.base_cells import Multiple, enlarged, follows_from_touched
from fieldgrid.mapfile.content import MapContent
from fieldgrid.mapfile.evidence import Evidence, reaches
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.reading import Request, chunks
from fieldgrid.mapfile.redatum import Redatum
from fieldgrid.mapfile.sources import CellSource, FoldedOverBase, Larger, assembled

_RISE_M = 1000.0
"""How far above or below its datum ground may lie: by that two planes that lean shift a place."""


class Part(NamedTuple):
    """A map as a part of a farm: its extent in the farm's plane; its sessions that are taken, by
    their names in the farm; and what brings it into the plane, None when it is of that datum."""

    block: Block
    bounds: Bounds
    names: Mapping[str, str]
    moved: Redatum | None
    header: Header

    @property
    def is_own(self) -> bool:
        """Whether its tiles are those of the farm's cells."""
        own = self.block.header
        assert own is not None
        same = own.lattice == self.header.lattice and own.transfer is self.header.transfer
        return same and self.moved is None

    def request(self, asked: Request) -> Request | None:
        """What is asked of the map itself; None for nothing."""
        names = self.names if asked.sessions is None else asked.sessions
        own = tuple(self.names[name] for name in names if name in self.names)
        if not own:
            return None
        whole = len(own) == len(self.block.sessions)
        return asked._replace(sessions=None if whole else own)

    def content(self, of_map: MapContent) -> MapContent:
        """The map's content in the cells of the farm; where its tiles are others, by its frames."""
        if self.is_own:
            return of_map
        evidence = of_map.evidence
        if self.moved is not None:
            evidence = _MovedEvidence(evidence, self.block, self.moved)
        return MapContent(evidence, self.header._replace(groups=()))


class FarmContent:
    """The content of several maps as one; see `Content`."""

    def __init__(
        self, maps: Maps, parts: Sequence[Part], header: Header, marks: tuple[Mark, ...]
    ) -> None:
        self._maps, self._parts, self._header, self._marks = maps, parts, header, marks

    @property
    def header(self) -> Header:
        """See `Content`."""
        return self._header

    def marks(self) -> tuple[Mark, ...]:
        """See `Content`."""
        return self._marks

    def fill(self, view: MapView, request: Request) -> bool:
        """See `Content`: where one map alone has all that is asked for."""
        near = [part for part in self._parts if part.bounds.overlaps(view.bounds)]
        if len(near) != 1 or (own := near[0].request(request)) is None:
            return not near
        with self._maps.reading(near[0].block) as opened:
            return near[0].content(opened.content).fill(view, own)

    def cell_source(self, request: Request) -> tuple[CellSource, float]:
        """See `Content`."""
        lattice = self._header.lattice
        groups = tuple(GROUPS[name] for name in groups_of(request.layers))
        by = enlarged(groups, lattice, request.lattice)
        own = request._replace(lattice=lattice, window=by.under(request.window))
        if not isinstance(by, Multiple):
            folded = self._joined(
                request, groups, lambda content, asked, kept: content.session_source(asked, kept)
            )
            if not request.beyond_density:
                return folded, 1
            touched = tuple(group for group in groups if follows_from_touched(group))
            base = Larger(self._own_cells(own, touched), by._replace(groups=touched))
            return FoldedOverBase(folded, base, groups), by.factor
        exact = Larger(self._own_cells(own, groups), by)
        if by.factor == 1:
            return exact, 1
        alone = [
            _FromMap(self._maps, part, asked, _whole_chunks)
            for part in self._parts
            if (asked := part.request(request)) is not None
        ]
        return _Neighbours(alone, exact, request.lattice, by.factor), 1

    def _own_cells(self, request: Request, groups: Sequence[ChannelGroup]) -> CellSource:
        return self._joined(
            request, groups, lambda content, asked, kept: content.own_cells(asked, kept)[0]
        )

    def _joined(
        self,
        request: Request,
        groups: Sequence[ChannelGroup],
        source: Callable[[MapContent, Request, tuple[ChannelGroup, ...]], CellSource],
    ) -> CellSource:
        """The same cells of all maps as one; `source` finds those of a map."""
        kept = tuple(group for group in groups if not group.derived)
        return _Joined(
            [
                _FromMap(self._maps, part, asked, lambda c, asked: source(c, asked, kept))
                for part in self._parts
                if (asked := part.request(request)) is not None
            ],
            groups,
        )


class _FromMap:
    """Cells of a map that is opened when a window touches it."""

    def __init__(
        self,
        maps: Maps,
        part: Part,
        request: Request,
        source: Callable[[MapContent, Request], CellSource],
    ) -> None:
        self._maps, self.part, self._request, self._find = maps, part, request, source

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        if not self._request.lattice.bounds(window).overlaps(self.part.bounds):
            return None
        with self._maps.reading(self.part.block) as opened:
            return self._source(opened).merged(window)

    def _source(self, opened: OpenMap) -> CellSource:
        with opened.lock:
            found = opened.sources.get(self)
            if found is None:
                content = self.part.content(opened.content)
                found = opened.sources[self] = self._find(content, self._request)
            return found


class _Joined:
    """The sessions of several maps together, cell by cell."""

    def __init__(self, sources: Sequence[CellSource], groups: Sequence[ChannelGroup]) -> None:
        self._sources, self._groups = sources, groups

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        total: Cells | None = None
        for source in self._sources:
            cells = source.merged(window)
            if cells is not None:
                total = cells if total is None else merge_sessions(self._groups, total, cells)
        return None if total is None else with_overviews(self._groups, total)


class _Neighbours:
    """Larger cells of maps whose own cells meet in few places: there they are `exact`."""

    def __init__(
        self,
        alone: Sequence[_FromMap],
        exact: CellSource,
        lattice: Lattice,
        factor: int,
    ) -> None:
        self._alone, self._exact, self._lattice, self._factor = alone, exact, lattice, factor

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        total: Cells | None = None
        near: list[Window] = []
        for source in self._alone:
            part = self._lattice.window(source.part.bounds).intersect(window)
            cells = None if part is None else source.merged(window)
            if part is not None and cells is not None:
                near.append(part)
                if total is not None:  # where both have something, `exact` follows
                    cells = Cells({k: v + total[k] for k, v in cells.items()}, cells.base_cells)
                total = cells
        if total is None:
            return None
        shared = {one.intersect(other) for one, other in combinations(near, 2)} - {None}
        for place in shared:
            assert place is not None
            for chunk in chunks(place, self._factor):
                found = self._exact.merged(chunk)
                for name, values in total.items():
                    values[window.slices_of(chunk)] = 0 if found is None else found[name]
        return total


class _WholeChunks:
    """A source that is asked for windows of any size, and looks into no more than it should."""

    def __init__(self, source: CellSource, factor: float) -> None:
        self._source, self._factor = source, factor

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""

        def found() -> Iterator[tuple[Window, Cells]]:
            for chunk in chunks(window, self._factor):
                cells = self._source.merged(chunk)
                if cells is not None:
                    yield chunk, cells

        return assembled(window, found())


def _whole_chunks(content: MapContent, request: Request) -> CellSource:
    return _WholeChunks(*content.cell_source(request))


class _MovedEvidence(Evidence):
    """The evidence of a map in the plane of another datum."""

    def __init__(self, own: Evidence, block: Block, moved: Redatum) -> None:
        super().__init__(own.connection, block.path)
        self._moved = moved

    def accepted(
        self,
        near: Bounds,
        sessions: object,
        frame_filter: Callable[[FrameRecord], bool] | None,
    ) -> list[FrameRecord]:
        """See `Evidence`; `near` is of the farm's plane, and so are the poses."""
        back = moved_bounds(Redatum(self._moved.new, self._moved.old), near)
        found = super().accepted(back, sessions, frame_filter)  # type: ignore[arg-type]
        placed = (replace(one, pose=self._moved.pose(one.pose)) for one in found)
        return [one for one in placed if reaches(one, near)]


def moved_bounds(moved: Redatum, bounds: Bounds) -> Bounds:
    """A rectangle of another plane that holds one of the old plane."""
    west, south, east, north = bounds
    corners = [west, west, east, east] * 2, [south, north, south, north] * 2
    x, y, _ = moved.places(*corners, [-_RISE_M] * 4 + [_RISE_M] * 4)
    if not np.isfinite([x, y]).all():
        raise MapError(f"The extent {tuple(bounds)} of a map is nowhere; see `fieldgrid verify`.")
    return Bounds(float(x.min()), float(y.min()), float(x.max()), float(y.max()))

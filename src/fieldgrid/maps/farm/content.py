"""What views over several maps are made of: the cells of each, as the layers' own rules join them.

A cell that two maps saw is what one map with the sessions of both would say of it. Larger cells
into which a single map sees come from what that map stores of them; those of two follow from the
joined own cells, where sums do not say it all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import MapError, check_is_here
from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps.farm.catalogue import FarmBlock
from fieldgrid.maps.farm.maps import Maps, OpenMap
from fieldgrid.maps.file.evidence import EvidenceTables, reaches
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import whole_blocks
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.registry import GROUPS, channel_names, groups_of
from fieldgrid.maps.layers.window import assembled
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.base_cells import Multiple, enlarged
from fieldgrid.maps.views.content import MapContent, resampled
from fieldgrid.maps.views.read import Request, chunks
from fieldgrid.maps.views.sources import CellSource, LargerCells, Together
from fieldgrid.maps.views.view import MapView
from fieldgrid.maps.writing.redatum import Redatum
from fieldgrid.maps.writing.sharing import check_known, known_groups

_RISE_M = 1000.0
"""How far above or below its datum ground may lie: by that two planes that lean shift a place."""


class FarmPart(NamedTuple):
    """A map as a part of a farm: its extent in the farm's plane; its sessions that are taken, by
    their names in the farm; and what brings it into the plane, None when it is of that datum."""

    block: FarmBlock
    bounds: Bounds
    names: Mapping[str, str]
    moved: Redatum | None
    header: MapHeader

    @property
    def is_own(self) -> bool:
        """Whether its tiles are those of the farm's cells."""
        own = self.block.header
        assert own is not None
        same = own.lattice == self.header.lattice and own.transfer is self.header.transfer
        return same and self.moved is None

    def reach(self, lattice: Lattice) -> Window:
        """The cells of a lattice of which the map may tell anything: those of all blocks, of the
        farm's cells and of the lattice, that hold a cell that it saw."""
        own = self.header.lattice
        held = own.bounds(whole_blocks(own.window(self.bounds), own))
        return whole_blocks(lattice.window(held), lattice)

    def request(self, asked: Request) -> Request | None:
        """What is asked of the map itself; None for nothing."""
        names = self.names if asked.sessions is None else asked.sessions
        own = tuple(self.names[name] for name in names if name in self.names)
        if not own:
            return None
        return asked._replace(sessions=None if len(own) == len(self.block.sessions) else own)

    def content(self, of_map: MapContent) -> MapContent:
        """The map's content in the cells of the farm; where its tiles are others, by its frames."""
        if self.is_own:
            return of_map
        evidence = of_map.evidence
        if self.moved is not None:
            evidence = _RebasedEvidence(evidence, self.block, self.moved)
        return MapContent(evidence, self.header._replace(groups=()))


class FarmContent:
    """The content of several maps as one; see `Content`. Pickled it is where the maps lie."""

    def __init__(
        self, maps: Maps, parts: Sequence[FarmPart], header: MapHeader, marks: tuple[Mark, ...]
    ) -> None:
        self._maps, self._parts, self._header, self._marks = maps, parts, header, marks

    def __reduce__(self) -> tuple[Any, ...]:
        blocks = [part.block._replace(path=part.block.path.absolute()) for part in self._parts]
        parts = [part._replace(block=one) for part, one in zip(self._parts, blocks, strict=True)]
        return _arrived, (parts, self._header, self._marks, known_groups(self._header))

    @property
    def header(self) -> MapHeader:
        """See `Content`."""
        return self._header

    def marks(self) -> tuple[Mark, ...]:
        """See `Content`."""
        return self._marks

    def tells_of_drops(self) -> bool:
        """See `Content`."""
        headers = (part.block.header for part in self._parts)
        return any(header is not None and "drop" in header.groups for header in headers)

    def ways(self, request: Request) -> dict[str, list[FrameRecord]]:
        """See `Content`."""
        found: list[tuple[int, str, list[FrameRecord]]] = []
        for part, content, asked in self._near(request):
            own = content.ways(asked)
            ends = {info.name: info.last_time_ns or -1 for info in part.block.sessions}
            found += [(ends[was], name, own[was]) for name, was in part.names.items() if was in own]
        return {name: frames for _, name, frames in sorted(found, key=lambda way: way[0])}

    def by_session(self, request: Request) -> Iterator[tuple[str, Cells]]:
        """See `Content`."""
        for part, content, asked in self._near(request):
            names = {was: name for name, was in part.names.items()}
            yield from ((names[was], cells) for was, cells in content.by_session(asked))

    def _near(self, request: Request) -> Iterator[tuple[FarmPart, MapContent, Request]]:
        """The maps that may tell of a window of the own cells, and what is asked of each."""
        for part in self._parts:
            asked = part.request(request)
            if asked is not None and part.reach(request.lattice).intersect(request.window):
                with self._maps.reading(part.block) as opened:
                    yield part, part.content(opened.content), asked

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
            return resampled(self, request, own, by)
        exact = LargerCells(self.own_cells(own, groups)[0], by)
        if by.factor == 1:
            return exact, 1
        needed = exact if request.layers else None
        alone = [
            _FromMap(
                self._maps,
                part,
                asked,
                lambda content, request: _WholeChunks(*content.cell_source(request)),
            )
            for part in self._parts
            if (asked := part.request(request)) is not None
        ]
        return _Neighbours(alone, needed, groups, by.factor), 1

    def own_cells(
        self, request: Request, groups: tuple[ChannelGroup, ...]
    ) -> tuple[CellSource, int]:
        """See `Content`."""
        return self._joined(
            request, groups, lambda content, asked, kept: content.own_cells(asked, kept)[0]
        ), 1

    def folded(self, request: Request, groups: tuple[ChannelGroup, ...]) -> CellSource:
        """See `Content`."""
        return self._joined(
            request, groups, lambda content, asked, kept: content.folded(asked, kept)
        )

    def _joined(
        self,
        request: Request,
        groups: tuple[ChannelGroup, ...],
        source: Callable[[MapContent, Request, tuple[ChannelGroup, ...]], CellSource],
    ) -> CellSource:
        """The cells of all maps as those of one; `source` finds the cells of a map."""
        kept = tuple(group for group in groups if not group.derived)
        together = _TogetherCells(
            [
                _FromMap(self._maps, part, asked, lambda c, asked: source(c, asked, kept))
                for part in self._parts
                if (asked := part.request(request)) is not None
            ],
            kept,
        )
        return Together([together], groups)


def _arrived(
    parts: Sequence[FarmPart], header: MapHeader, marks: tuple[Mark, ...], known: tuple[str, ...]
) -> FarmContent:
    """The content on a worker, which opens maps as it needs them. ClusterError where it lacks one
    or cannot read them."""
    check_known(known)
    for part in parts:
        check_is_here(part.block.path, part.block.size_bytes, "maps")
    return FarmContent(Maps(), parts, header, marks)


class _FromMap:
    """Cells of a map that is opened when a window touches it."""

    def __init__(
        self,
        maps: Maps,
        part: FarmPart,
        request: Request,
        source: Callable[[MapContent, Request], CellSource],
    ) -> None:
        self._maps, self._part, self._request, self._find = maps, part, request, source

    def near(self, window: Window) -> tuple[Window, Cells] | None:
        """What of a window lies in the map's reach, and its cells; None where it saw nothing."""
        part = self._part.reach(self._request.lattice).intersect(window)
        if part is None:
            return None
        with self._maps.reading(self._part.block) as opened:
            cells = self._source(opened).merged(part)
        return None if cells is None else (part, cells)

    def _source(self, opened: OpenMap) -> CellSource:
        with opened.lock:
            found = opened.sources.get(self)
            if found is None:
                content = self._part.content(opened.content)
                found = opened.sources[self] = self._find(content, self._request)
            return found


class _TogetherCells:
    """The cells of several maps as their sessions meet in them."""

    def __init__(self, sources: Sequence[_FromMap], groups: Sequence[ChannelGroup]) -> None:
        self._sources, self._groups = sources, groups

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        found = (source.near(window) for source in self._sources)
        return assembled(self._groups, window, filter(None, found))


class _Neighbours:
    """Larger cells of several maps: sums, and `exact` where two of them see into one cell.

    The density alone needs the sums only, and then there is no `exact`.
    """

    def __init__(
        self,
        alone: Sequence[_FromMap],
        exact: CellSource | None,
        groups: Sequence[ChannelGroup],
        factor: int,
    ) -> None:
        self._alone, self._exact, self._factor = alone, exact, factor
        blocks = (channel_names(group) for group in groups if group.blocks)
        self._tell = ("weight", *chain.from_iterable(blocks))

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        maps, parts = np.zeros(window.shape, np.uint16), []
        for part, cells in filter(None, (source.near(window) for source in self._alone)):
            # Of a block that it saw a part of, a map tells in the cells beside that, too.
            tell = (cells[name] != 0 for name in self._tell if name in cells)
            maps[window.slices_of(part)] += reduce(np.logical_or, tell)
            parts.append((part, cells))
        total = assembled((), window, parts)
        if total is None or self._exact is None or maps.max() < 2:
            return total
        arrays = {name: np.array(values) for name, values in total.items()}
        for chunk in chunks(window, self._factor):
            place = window.slices_of(chunk)
            if (maps[place] > 1).any():
                exact = self._exact.merged(chunk)
                for name, values in arrays.items():
                    values[place] = 0 if exact is None else exact[name]
        return Cells(arrays, total.base_cells)


class _WholeChunks:
    """A source that is asked for windows of any size, and looks into no more than it should."""

    def __init__(self, source: CellSource, factor: float) -> None:
        self._source, self._factor = source, factor

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        parts = chunks(window, self._factor)
        return assembled((), window, ((chunk, self._source.merged(chunk)) for chunk in parts))


class _RebasedEvidence(EvidenceTables):
    """The evidence of a map in the plane of another datum."""

    def __init__(self, own: EvidenceTables, block: FarmBlock, moved: Redatum) -> None:
        super().__init__(own.connection, block.path)
        self._moved = moved

    def accepted(
        self,
        near: Bounds,
        sessions: object,
        frame_filter: Callable[[FrameRecord], bool] | None,
    ) -> list[FrameRecord]:
        """See `EvidenceTables`; `near` is of the farm's plane, and so are the poses."""
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

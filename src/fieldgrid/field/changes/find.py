"""Finding the objects that changed between two times of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from fieldgrid.core import ConfigError
from fieldgrid.field.changes.cells import (
    SQUARE_CELLS,
    CellChanges,
    changed_cells,
    surroundings,
)
from fieldgrid.field.changes.objects import described, things_of, votes_of, with_moved
from fieldgrid.field.changes.observations import observers
from fieldgrid.field.changes.relative_sigmas import RelativeSigma, relative_sigmas
from fieldgrid.field.changes.result import ChangedObject, ChangeKind, Changes
from fieldgrid.geometry import Bounds, aligned_parts
from fieldgrid.maps import Change, MapFile

SIGMAS, GROWTH_M, MOVED_M, MIN_AREA_M2, MIN_CONFIDENCE = 3.0, 0.4, 3.0, 0.05, 0.5
"""Defaults of `find_changes`."""


def find_changes(
    universal: MapFile,
    from_: str | int,
    to: str | int,
    *,
    bounds: Bounds | None = None,
    cell_m: float | None = None,
    min_area_m2: float = MIN_AREA_M2,
    min_confidence: float = MIN_CONFIDENCE,
    sigmas: float = SIGMAS,
    growth_m: float = GROWTH_M,
    moved_m: float = MOVED_M,
    position_sigma_m: float | None = None,
) -> Changes:
    """The objects that appeared, vanished, moved, grew or were cut back between two times.

    What the drives after `from_` and up to `to` found, beside what was known by `from_`, as in
    `MapFile.diff`, whose `bounds` and `cell_m` these are. Objects below `min_area_m2` or
    `min_confidence` (0..1) are left out. What is nearer than `sigmas` standard deviations
    of both positions to what the other side saw is no change; what is nearer than `growth_m` is
    growth; an object may have moved by up to `moved_m`. `position_sigma_m` is taken in place of
    what the frames say; without it drives that were aligned are as sure as they lie beside each
    other.

    `docs/changes.md` has the definitions. Raises ConfigError as `diff` does, and for settings that
    cannot be.
    """
    for what, value, most in (
        ("least area", min_area_m2, 1e6),
        ("least confidence", min_confidence, 1.0),
        ("number of sigmas", sigmas, 100.0),
        ("growth", growth_m, 100.0),
        ("distance that an object moves", moved_m, 1e4),
        ("position sigma", position_sigma_m or 0.0, 100.0),
    ):
        if not (math.isfinite(value) and 0.0 <= value <= most):
            raise ConfigError(f"A {what} of {value} is outside 0..{most:g}.")
    view = universal.diff(from_, to, bounds, cell_m)
    kinds = Change.APPEARED, Change.VANISHED
    places = [
        place
        for place in aligned_parts(view.window, SQUARE_CELLS, SQUARE_CELLS)
        if np.isin(view.change[view.window.slices_of(place)], kinds).any()
    ]
    beside: Mapping[str, RelativeSigma] = {}
    if position_sigma_m is None and places:
        beside = relative_sigmas(universal, view.before, view.after)
    infos = {info.name: info for info in universal.sessions()}
    wide = [surroundings(place, view.lattice) for place in places]
    before, after = (
        {
            name: observers(
                universal.frames(name, with_grid=True),
                infos[name],
                view.lattice,
                wide,
                position_sigma_m,
                beside.get(name),
            )
            for name in names
        }
        for names in (view.before, view.after)
    )
    parts = [changed_cells(before, after, view.lattice, place, sigmas) for place in places]
    found = list[ChangedObject]()
    if parts:
        appeared, vanished = (CellChanges.joined(cells) for cells in zip(*parts, strict=True))
        for cells, became, sides in (
            (appeared, (ChangeKind.APPEARED, ChangeKind.GROWN), (after, before)),
            (vanished, (ChangeKind.VANISHED, ChangeKind.CUT_BACK), (before, after)),
        ):
            things = things_of(cells, became, view.lattice, growth_m, min_area_m2)
            stood = votes_of(things, sides[0], view.lattice, [t.cells.stood for t in things])
            freed = votes_of(things, sides[1], view.lattice, [t.cells.freed for t in things])
            found += [
                described(thing, one, other, sides, view.lattice, view.datum)
                for thing, one, other in zip(things, stood, freed, strict=True)
            ]
    sure = [o for o in with_moved(found, moved_m) if o.confidence >= min_confidence]
    sure.sort(key=lambda o: (-o.confidence, -o.area_m2, o.east_m, o.north_m))
    return Changes(tuple(o._replace(id=f"c{k}") for k, o in enumerate(sure, 1)), view)

"""What is found: objects that changed between two times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from fieldgrid.core import notebook
from fieldgrid.maps import ChangeView


class ChangeKind(StrEnum):
    """What became of an object."""

    APPEARED = "appeared"
    VANISHED = "vanished"
    MOVED = "moved"
    GROWN = "grown"
    CUT_BACK = "cut_back"


class ChangedObject(NamedTuple):
    """One object that changed.

    `area` is a shapely polygon (or several) in metres east and north, around the cells that were
    seen to change, so the part of the object that both sides looked at; pinholes are closed in it.
    `area_m2` is that of the cells, `east_m` and `north_m` are their mean, `length_m` and `width_m`
    the sides of the smallest rectangle around them, `heading_deg` (-90, 90] the way of its longer
    side.
    `away_m` is the shift that would explain it by what the other side saw elsewhere, or where it
    did not look; `sigma_m` is how unsure both positions are together. `stood` and `freed` name the
    drives that saw it standing, and its place free, with `looks_stood` and `looks_freed` looks at
    it. An object that moved comes from (`from_east_m`, `from_north_m`), NaN for others.
    """

    id: str
    kind: ChangeKind
    area: Any
    area_m2: float
    east_m: float
    north_m: float
    lat_deg: float
    lon_deg: float
    length_m: float
    width_m: float
    heading_deg: float
    confidence: float
    away_m: float
    sigma_m: float
    looks_stood: float
    looks_freed: float
    stood: tuple[str, ...]
    freed: tuple[str, ...]
    from_east_m: float = float("nan")
    from_north_m: float = float("nan")


@dataclass(frozen=True, slots=True)
class Changes(Sequence[ChangedObject]):
    """The objects that changed, the surest first, and `view`, what became of each cell."""

    objects: tuple[ChangedObject, ...]
    view: ChangeView

    def __len__(self) -> int:
        return len(self.objects)

    def __getitem__(self, k: Any) -> Any:
        return self.objects[k]

    def _repr_html_(self) -> str:
        """A table, for a notebook."""
        rows = [
            (o.id, o.kind.value, f"{o.area_m2:.2f}", f"{o.east_m:.2f}", f"{o.north_m:.2f}",
             f"{o.confidence:.2f}")
            for o in self.objects
        ]  # fmt: skip
        return notebook.table(rows, ("id", "change", "m²", "east", "north", "confidence"))

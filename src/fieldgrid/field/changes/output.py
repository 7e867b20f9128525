"""Changes as features, for every format that `geometry.shapes.vectors` writes."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.field.changes.result import Changes
from fieldgrid.geometry import Feature, write_features


def change_features(changes: Changes) -> list[Feature]:
    """The objects as areas, the surest first; their properties are the fields of
    `ChangedObject`."""
    return [
        Feature(
            o.kind.value,
            o.area,
            {key: v for key, v in o._asdict().items() if key not in ("kind", "area")},
        )
        for o in changes
    ]


def write_changes(changes: Changes, path: Path, *, overwrite: bool = False) -> None:
    """Write changes as .geojson, .gpkg, .csv, .kml or .dxf, by the ending of `path`."""
    write_features(path, change_features(changes), changes.view.datum, overwrite=overwrite)

"""How sure aligned drives lie beside each other, which is told with the transform of each: of two
poor receivers neither knows the place, and yet they coincide."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from fieldgrid.field.align.report import MapAlignment
from fieldgrid.maps import MapFile, RelativeError, placing


def with_beside(universal: MapFile, found: MapAlignment) -> MapAlignment:
    """The outcome, with what each drive that moves is sure of beside those it was matched with."""
    pairs = [pair for pair in found.pairs if pair.doubt is None and pair.matches]
    matched = {name for pair in pairs for name in (pair.a, pair.b)}
    placings = {
        drive.name: placing(
            drive.after, (f.driven for f in universal.frames(drive.name) if f.accepted)
        )
        for drive in found.drives
        if drive.name in matched
    }
    beside = defaultdict[str, list[RelativeError]](list)
    for pair in pairs:
        for one, other in ((pair.a, pair.b), (pair.b, pair.a)):
            beside[one].append(RelativeError(other, pair.sigma_m, placings[other]))
    drives = []
    for drive in found.drives:
        aligned = drive.after.aligned
        if drive.moved and aligned is not None:
            aligned = replace(aligned, beside=tuple(beside[drive.name]))
            drive = drive._replace(after=replace(drive.after, aligned=aligned))
        drives.append(drive)
    return found._replace(drives=tuple(drives))

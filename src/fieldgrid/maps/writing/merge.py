"""Copying maps and bringing several together as one new map, in the plane of one datum."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, DatumError, quoted, refuse_input
from fieldgrid.geometry import Datum, Pose
from fieldgrid.maps.file.database import USUAL_PATIENCE, Patience
from fieldgrid.maps.file.geometry import Ring
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.store import create_map, open_map
from fieldgrid.maps.transfer import Transfer
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.writing.redatum import Redatum
from fieldgrid.maps.writing.transform import placing
from fieldgrid.maps.writing.twins import REMEDY, SAME_PLACE_M, Twin, twin_of


@dataclass(frozen=True, slots=True)
class MergedSession:
    """A session that came into the new map.

    `source` is the file it came from, `name` what it is called now, `was` what it was called
    there. `twin` names the session of the new map that is the same drive, which was then taken
    once; None for one that was taken.
    """

    source: Path
    was: str
    name: str
    twin: str | None = None


def merge_maps(
    sources: Sequence[str | Path],
    out: str | Path,
    *,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
    datum: Datum | None = None,
    overwrite: bool = False,
    patience: Callable[[Path], Patience] | None = None,
) -> list[MergedSession]:
    """Make the map `out` of all active sessions and marks of some maps; with one, a copy.

    The cells and the rule are those of the first map unless given: every frame is folded anew.
    Sessions that are the same drive, bit for bit, are taken once; different ones of one name get
    the name of their file behind it. Marks that are alike are taken once, too. What was removed
    stays behind. The new map appears when it is complete; it cannot take the place of one of them.
    With a `datum` all maps are laid into its plane, as `Redatum` says, and may have datums of their
    own. `patience` tells of each map how long a commit of another program is waited for. Raises
    DatumError when the maps differ in their datum, ConfigError when they have one drive in two
    places.
    """
    paths = [Path(source) for source in sources]
    if not paths:
        raise ConfigError("There is no map to merge; name at least one.")
    refuse_input(Path(out), paths)
    with ExitStack() as opened:
        maps = [
            opened.enter_context(
                open_map(path, patience=patience(path) if patience else USUAL_PATIENCE)
            )
            for path in paths
        ]
        for other in maps[1:]:
            if datum is None and not maps[0].has_datum(other.datum):
                raise DatumError(
                    f"{other.path} has the datum {other.datum.described()} and {paths[0]} has "
                    f"{maps[0].datum.described()}, so their cells do not coincide; bring them into "
                    f"one plane with --datum-from {paths[0]}."
                )
        target = opened.enter_context(
            create_map(
                out,
                datum or maps[0].datum,
                cell_m=maps[0].cell_m if cell_m is None else cell_m,
                transfer=transfer or maps[0].transfer,
                overwrite=overwrite,
            )
        )
        merged: list[MergedSession] = []
        taken = dict[str, Twin]()
        for universal in maps:
            merged += _take_all(universal, target, taken)
        if not merged:
            raise ConfigError(f"{paths[0]} has no session to copy; restore or add one first.")
        marks = marks_together(maps, target.datum)
        if marks:
            target.add_marks(marks)
        return merged


def marks_together(maps: Iterable[MapFile], datum: Datum) -> list[Mark]:
    """The marks in the plane of a datum; the same words of the same person at the same time and
    place are one."""
    found: list[Mark] = []
    alike: defaultdict[Mark, list[Mark]] = defaultdict(list)
    for universal in maps:
        moved = None if universal.has_datum(datum) else Redatum(universal.datum, datum)
        marks, up_m = universal.marks(), 0.0
        if marks and moved is not None:
            # On the ground that was driven, not on the plane.
            up_m = next((frame.driven.up_m for frame in universal.frames()), 0.0)
        for mark in marks:
            if moved is not None:
                outline, *holes = (_moved(ring, moved, np.nan_to_num(up_m)) for ring in mark.rings)
                mark = mark._replace(corners=outline, holes=tuple(holes))
            others = alike[mark._replace(id=0, corners=(), holes=())]
            if not any(_same_place(mark, other) for other in others):
                others.append(mark)
                found.append(mark._replace(id=0))
    return found


def _moved(ring: Ring, moved: Redatum, up_m: float) -> Ring:
    east, north = np.transpose(ring)
    places = moved.places(east, north, np.full(len(east), up_m))[:2]
    return tuple(map(tuple, np.transpose(places).tolist()))


def _same_place(one: Mark, other: Mark) -> bool:
    return [*map(len, one.rings)] == [*map(len, other.rings)] and all(
        np.hypot(*np.transpose(np.subtract(mine, its))).max() <= SAME_PLACE_M
        for mine, its in zip(one.rings, other.rings, strict=True)
    )


def _take_all(universal: MapFile, target: MapFile, taken: dict[str, Twin]) -> list[MergedSession]:
    """Copy the active sessions of a map, but for those that the new one has."""
    moved = None
    if not universal.has_datum(target.datum):
        moved = Redatum(universal.datum, target.datum)
    merged, firsts, placings = list[MergedSession](), dict[str, Pose](), dict[str, str]()
    # All names first: alignments speak of sessions that come later, too.
    for info in (info for info in universal.sessions() if info.active):
        twin = twin_of(universal, info, moved)
        same = next((name for name, other in taken.items() if other.is_drive(twin)), None)
        if same is not None and (why := twin.contradiction(taken[same])) is not None:
            raise ConfigError(
                f"Session {quoted(info.name)} of {universal.path} is the same drive as "
                f"{quoted(same)}, which comes from a map before it, but it {why}; {REMEDY}, and "
                "merge again."
            )
        name = same or free_name(info.name, universal.path.stem, taken)
        taken.setdefault(name, twin)
        merged.append(MergedSession(universal.path, info.name, name, same))
        frames = [] if moved is None else list(universal.frames(info.name))
        if moved is not None and frames:
            firsts[info.name] = first = frames[0].driven
            driven = [frame.driven for frame in frames if frame.accepted]
            placed = placing(moved.transform(info.transform, first), map(moved.pose, driven))
            placings[placing(info.transform, driven)] = placed
    names = {one.was: one.name for one in merged}
    for one in (one for one in merged if one.twin is None):
        metadata = universal.metadata(one.was)
        if moved is not None and one.was in firsts:
            metadata = moved.metadata(metadata, firsts[one.was])
        transform = metadata.transform.speaking_of(names, placings)
        with target.add_session_of(
            metadata._replace(name=one.name, transform=transform)
        ) as session:
            for frame in universal.frames(one.was, with_grid=True):
                pose = frame.driven if moved is None else moved.pose(frame.driven)
                session.add_staged(frame.staged(), pose, quality=frame.quality)
    return merged


def free_name(name: str, stem: str, taken: Collection[str]) -> str:
    """The name of a session beside others: its own, or with that of its file behind it."""
    named = chain([name, f"{name} ({stem})"], (f"{name} ({stem} {k})" for k in count(2)))
    return next(one for one in named if one not in taken)

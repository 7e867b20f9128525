"""Copying maps and bringing several of one datum together, as one new map."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from fieldgrid.errors import ConfigError, DatumError
from fieldgrid.mapfile.map_file import MapFile
from fieldgrid.mapfile.records import SessionInfo
from fieldgrid.mapfile.store import create_map, open_map
from fieldgrid.publish import refuse_input
from fieldgrid.transfer import Transfer


@dataclass(frozen=True, slots=True)
class Merged:
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
    overwrite: bool = False,
) -> list[Merged]:
    """Make the map `out` of all active sessions and marks of some maps; with one, a copy.

    The cells and the rule are those of the first map unless given: every frame is folded anew.
    Sessions that are the same drive, bit for bit, are taken once; different ones of one name get
    the name of their file behind it. Marks that are alike are taken once, too. What was removed
    stays behind. The new map appears when it is complete; it cannot take the place of one of them.
    Raises DatumError when the maps differ in their datum, ConfigError when they have one drive in
    two places.
    """
    paths = [Path(source) for source in sources]
    if not paths:
        raise ConfigError("There is no map to merge; name at least one.")
    refuse_input(Path(out), paths)
    with ExitStack() as opened:
        maps = [opened.enter_context(open_map(path)) for path in paths]
        _check_datum(maps)
        target = opened.enter_context(
            create_map(
                out,
                maps[0].datum,
                cell_m=maps[0].cell_m if cell_m is None else cell_m,
                transfer=transfer or maps[0].transfer,
                overwrite=overwrite,
            )
        )
        merged: list[Merged] = []
        taken: dict[str, str] = {}
        for universal in maps:
            for info in universal.sessions():
                if info.active:
                    merged.append(_take(universal, info, target, taken))
        if not merged:
            raise ConfigError(f"{paths[0]} has no session to copy; restore or add one first.")
        # The same words of the same person at the same time are one mark.
        marks = dict.fromkeys(mark._replace(id=0) for one in maps for mark in one.marks())
        if marks:
            target.add_marks(marks)
        return merged


def _take(universal: MapFile, info: SessionInfo, target: MapFile, taken: dict[str, str]) -> Merged:
    """Copy one session; `taken` has the names of the new map by digest."""
    if info.digest in taken:
        twin = taken[info.digest]
        if target.transform(twin) != info.transform:
            raise ConfigError(
                f"Session {info.name!r} of {universal.path} is the same drive as {twin!r}, which "
                "comes from before it, but it lies in another place; shift one of them with "
                "`fieldgrid sessions --shift` to where the other is, or remove it, and merge again."
            )
        return Merged(universal.path, info.name, twin, twin=twin)
    name = _free_name(info.name, universal.path.stem, set(taken.values()))
    metadata = universal.metadata(info.name)._replace(name=name)
    with target.add_session_of(metadata) as session:
        for frame in universal.frames(info.name, with_grid=True):
            session.add_staged(frame.staged(), frame.driven, quality=frame.quality)
    taken[info.digest] = name
    return Merged(universal.path, info.name, name)


def _free_name(name: str, stem: str, taken: set[str]) -> str:
    if name not in taken:
        return name
    candidate = f"{name} ({stem})"
    count = 2
    while candidate in taken:
        candidate = f"{name} ({stem} {count})"
        count += 1
    return candidate


def _check_datum(maps: Sequence[MapFile]) -> None:
    first = maps[0]
    for other in maps[1:]:
        if not first.has_datum(other.datum):
            raise DatumError(
                f"{other.path} has the datum {other.datum.described()} and {first.path} has "
                f"{first.datum.described()}, so their cells do not coincide; build one of them "
                f"again with --datum-from {first.path}."
            )

"""The map that sessions are put into: opened or made, and what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fieldgrid.core import BuildSettings, ConfigError, MapExistsError, quoted
from fieldgrid.geometry import Datum
from fieldgrid.maps import MapFile, Patience, check_name, create_map, open_map
from fieldgrid.pipeline.staging.kept_frames import KeptDrive


def opened_map(
    out: Path, settings: BuildSettings, datum: Datum | None, patience: Patience | None
) -> MapFile:
    """The map to which sessions are added, as the settings want it."""
    return open_map(
        out,
        datum=datum,
        cell_m=settings.map.cell_m,
        transfer=settings.map.transfer,
        layers=settings.map.kept_layers(),
        patience=patience or Patience(),
    )


def made_map(
    out: Path, settings: BuildSettings, datum: Datum, *, overwrite: bool = False
) -> MapFile:
    """A new map, as the settings want it."""
    return create_map(
        out,
        datum,
        cell_m=settings.universal_cell_m,
        transfer=settings.map.transfer,
        layers=settings.map.kept_layers(),
        overwrite=overwrite,
    )


def check_output(path: Path, *, append: bool, overwrite: bool) -> None:
    """Raise before any work is done when the output cannot be what was asked for."""
    if append and overwrite:
        raise ConfigError("--append and --overwrite exclude each other; give one of them.")
    if append and not path.exists():
        raise ConfigError(f"There is no map {path} to append to; leave out --append to make it.")


def exists_already(out: Path) -> MapExistsError:
    """The error of a map that is there, where a new one was to be made."""
    return MapExistsError(
        f"{out} exists already; give another name, or --append to add the drive to it."
    )


def check_names(names: Sequence[str], taken: Sequence[str]) -> None:
    """Raise before any work is done when a session could not get its name."""
    for k, name in enumerate(names):
        check_name(name)
        if name in taken:
            raise ConfigError(
                f"The map has a session {quoted(name)} already; give another with --name."
            )
        if name in names[:k]:
            raise ConfigError(
                f"Two of the recordings are called {quoted(name)}; build them one after the other, "
                "the second with --append and a --name."
            )


def is_in_map(universal: MapFile, name: str, staged: KeptDrive) -> bool:
    """Whether a session of the map has the frames that were staged, and no others."""
    kept = {
        frame.frame_id: (frame.cells_sha256, frame.images_sha256)
        for frame in universal.frames(name)
    }
    frames = (staged[k] for k in range(len(staged.frames)))
    return kept == {f.frame_id: (f.cells_sha256, f.images_sha256) for f in frames}

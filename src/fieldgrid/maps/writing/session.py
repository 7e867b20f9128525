"""Adding a drive to a map: all of it, or nothing."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from fieldgrid.core import AnyArray, ConfigError, quoted
from fieldgrid.geometry import GridSpec, LocalGrid, Pose
from fieldgrid.maps.file.codec import as_decoded
from fieldgrid.maps.file.database import explained
from fieldgrid.maps.file.digest import frame_digest
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import (
    SessionMetadata,
    name_is_taken,
    put_arrays,
    quality_at,
    sum_up,
)
from fieldgrid.maps.file.records import check_pose, frame_values, is_accepted
from fieldgrid.maps.file.schema import NOW_SQL
from fieldgrid.maps.layers.frame import FrameCells
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.transfer import check_cell_sizes
from fieldgrid.maps.writing import derived
from fieldgrid.maps.writing.placing import RECENT_FRAMES, FoldedTiles, PlacedFrame
from fieldgrid.maps.writing.staging import StagedFrame, StagedFrames, StageFile, stage


class _PendingFrame(NamedTuple):
    """A frame to be added: what reads it where it is staged, its pose as driven, the quality of its
    fix, and its cells where they are still at hand."""

    load: Callable[[], StagedFrame]
    pose: Pose
    quality: int | None
    cells: FrameCells | None

    def decoded(self) -> FrameCells:
        """Its cells."""
        return self.cells or self.load().cells()


class Session:
    """One drive on its way into a map; made by `MapFile.add_session`, used with `with`.

    Nothing is in the map before the end of the block, and nothing ever when it raises.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        path: Path,
        metadata: SessionMetadata,
        header: MapHeader,
        *,
        committing: Callable[[], AbstractContextManager[MapHeader]],
        on_end: Callable[[bool], None],
    ) -> None:
        self.name = metadata.name
        self._metadata = metadata
        self._connection = connection
        self._path = path
        self._header = header
        self._groups = header.writable_groups(path)
        self._committing = committing
        self._on_end = on_end
        self._spec: GridSpec | None = None
        self._own = StageFile(path)
        self._frames: dict[str, _PendingFrame] = {}
        self._open = True
        self._committed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None and self._open:
                self._commit()
                self._committed = True
        finally:
            self.discard()

    def add(
        self,
        grid: LocalGrid,
        pose: Pose,
        *,
        frame_id: str | None = None,
        images: Sequence[str] = (),
        images_sha256: Sequence[str] = (),
        channels: Mapping[str, AnyArray] | None = None,
    ) -> None:
        """Keep one frame: its local grid and pose, and, when accepted, its share of the map.

        Without `frame_id` frames are numbered from "000000". `images` names the files that the
        grid was made from, `images_sha256` are their hashes; `channels` are further values a cell.
        Raises ConfigError for a grid unlike the session's others, cells larger than the map's or a
        frame that is there already, DatumError for a pose too far from the datum.
        """
        identity = f"{len(self._frames):06d}" if frame_id is None else str(frame_id)
        frame = stage(
            grid,
            identity,
            pose.time_ns,
            images=images,
            images_sha256=images_sha256,
            channels=channels,
        )
        cells = as_decoded(grid, channels or {}) if len(self._frames) < RECENT_FRAMES else None
        self._take(frame, pose, cells=cells)

    def add_staged(
        self,
        source: StagedFrames | StagedFrame,
        pose: Pose,
        index: int = 0,
        *,
        quality: int | None = None,
    ) -> None:
        """Keep a frame that was staged before, or the one at `index` of staged frames, which can
        be read until the session has ended.

        `quality` is that of its fix, taken from the trajectory when not given. Errors as in `add`.
        """
        if isinstance(source, StagedFrame):
            self._take(source, pose, quality)
        else:
            self._take(source[index], pose, quality, partial(source.__getitem__, index))

    def discard(self) -> None:
        """Forget everything that was added; nothing happens when it is in the map already."""
        if self._open:
            self._open = False
            self._own.close()
            self._on_end(self._committed)

    def _take(
        self,
        frame: StagedFrame,
        pose: Pose,
        quality: int | None = None,
        load: Callable[[], StagedFrame] | None = None,
        cells: FrameCells | None = None,
    ) -> None:
        """Keep a frame, which `load` reads where it is staged; without it, it is staged here."""
        spec = frame.spec
        if not self._open:
            raise ConfigError(
                f"Session {quoted(self.name)} has ended; add frames inside its block."
            )
        if frame.frame_id in self._frames:
            raise ConfigError(
                f"Frame {quoted(frame.frame_id)} is in this session already; give each frame its "
                "own frame_id."
            )
        if self._spec is not None and spec != self._spec:
            raise ConfigError(
                f"Session {quoted(self.name)} has local grids of {_described(self._spec)}, and "
                f"cannot take one of {_described(spec)}; make them alike, or use two sessions."
            )
        check_cell_sizes(self._header.lattice.cell_m, spec.cell_m)
        check_pose(self._metadata.transform.pose(pose))
        if load is None:
            load = partial(self._own.__getitem__, self._own.append(frame))
        if quality is None:
            quality = quality_at(self._metadata.trajectory, pose.time_ns)
        self._frames[frame.frame_id] = _PendingFrame(load, pose, quality, cells)
        self._spec = spec

    def _commit(self) -> None:
        place = self._metadata.transform.pose
        frames = [
            PlacedFrame(place(frame.pose), self._spec, frame.decoded)
            for frame in self._frames.values()
            if is_accepted(frame.pose) and self._spec is not None
        ]
        fold = partial(FoldedTiles, frames, self._header.lattice, self._header.transfer)
        with ExitStack() as stack:
            stack.enter_context(explained(self._path, writing=True))
            tiles = stack.enter_context(fold(self._groups))
            header = stack.enter_context(self._committing())
            if header.groups != self._header.groups:  # by another program since this one began
                tiles = stack.enter_context(fold(header.writable_groups(self._path)))
            session_id = self._insert_session()
            for pending in self._frames.values():
                frame = pending.load()
                values = frame_values(
                    replace(pending.pose, time_ns=frame.time_ns),
                    frame.frame_id,
                    pending.quality,
                    frame.images,
                    frame.images_sha256,
                    frame.cells_sha256,
                )
                cursor = self._connection.execute(
                    f"INSERT INTO fieldgrid_frame VALUES (NULL, ?{', ?' * 16})",
                    (session_id, *values, frame_digest(values)),
                )
                self._connection.executemany(
                    "INSERT INTO fieldgrid_grid VALUES (?, ?, ?, ?)",
                    [(cursor.lastrowid, *channel) for channel in frame.channels],
                )
            put_arrays(self._connection, session_id, self._metadata.arrays)
            sum_up(self._connection, session_id, self._metadata)
            derived.show_features(self._connection, session_id, self._metadata)
            tables = derived.tables_of(self._connection, header, self._path)
            Pyramid(tables).change(None, tiles)
            derived.touch(self._connection)

    def _insert_session(self) -> int:
        metadata, spec = self._metadata, self._spec
        try:
            cursor = self._connection.execute(
                "INSERT INTO fieldgrid_session (name, created, transform, source, source_sha256, "
                "config, software_version, heading_source, frames, accepted, grid_width_m, "
                "grid_length_m, grid_cell_m, digest) VALUES "
                f"(?, coalesce(nullif(?, ''), {NOW_SQL}), ?, ?, ?, ?, ?, ?, 0, 0, ?, ?, ?, '')",
                (
                    metadata.name,
                    metadata.created,
                    metadata.transform.to_text(),
                    metadata.source,
                    metadata.source_sha256,
                    metadata.config,
                    metadata.software_version,
                    metadata.heading_source,
                    *((spec.width_m, spec.length_m, spec.cell_m) if spec else (None, None, None)),
                ),
            )
        except sqlite3.IntegrityError as error:  # added by another program since this one began
            raise name_is_taken(self.name, self._path) from error
        assert cursor.lastrowid is not None
        return cursor.lastrowid


def _described(spec: GridSpec) -> str:
    return f"{spec.width_m} x {spec.length_m} m in cells of {spec.cell_m} m"

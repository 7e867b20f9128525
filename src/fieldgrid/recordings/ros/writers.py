"""New bags, which appear whole under their name or not at all."""

from __future__ import annotations

import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import lz4.frame
from mcap.writer import CompressionType, Writer
from rosbags.convert.converter import migrate_message
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as RosbagsRos1Writer
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter
from rosbags.rosbag2.metadata import dump_qos_v8

from fieldgrid.core import Draft, DraftFolder, mentions, writing
from fieldgrid.recordings.ros.definitions import ros1_types, types
from fieldgrid.recordings.ros.folder import is_ros2_folder

_MESSAGE_ENCODINGS = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1", "jsonschema": "json"}
_FOREVER = QosTime(9223372036, 854775807)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    False,
)
_CALLER = "/fieldgrid"


class _BagWriter(ABC):
    """A bag in the making; a context manager.

    It appears under `path` when the block ends well; nothing of it is left when it does not.
    Raises MapExistsError for a path that is taken and MapWriteError where the disk refuses.
    """

    def __init__(self, path: Path, draft: Draft | DraftFolder) -> None:
        self._path, self._draft = path, draft
        self._connections: dict[tuple[str, str], Any] = {}
        try:
            with _refused(path):
                self._begin()
        except BaseException:
            draft.discard()
            raise

    @abstractmethod
    def _begin(self) -> None:
        """Open the draft."""

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Write a message that is an instance of one of the classes of `types()`.

        What is `latched` is played to those too who subscribe later, as a map is.
        """
        with _refused(self._path):
            self._write(topic, message.__msgtype__, message, time_ns, latched)

    @abstractmethod
    def _write(self, topic: str, name: str, message: Any, time_ns: int, latched: bool) -> None:
        """Write a message of the type of this name."""

    @abstractmethod
    def _end(self, *, is_good: bool) -> None:
        """Close the draft, which is published if the block ended well."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with _refused(self._path):
                self._end(is_good=kind is None)
            if kind is None:
                self._draft.publish()
        finally:
            self._draft.discard()


class McapWriter(_BagWriter):
    """One `.mcap` file in the making, zstd-compressed and indexed."""

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        def is_ours(file: Path) -> bool:
            # The header names the writer: the files of others are recordings.
            with file.open("rb") as opened:
                return b"fieldgrid" in opened.read(64)

        draft = Draft(path, overwrite=overwrite, ours=is_ours, what="an MCAP")
        self._target = draft.file
        super().__init__(path, draft)

    def _begin(self) -> None:
        self._schemas: dict[tuple[str, str], int] = {}
        self._file = self._target.open("wb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="fieldgrid")

    def _write(self, topic: str, name: str, message: Any, time_ns: int, latched: bool) -> None:
        text = ""
        if (name, "ros2msg") not in self._schemas:
            text, _ = types().generate_msgdef(name, ros_version=2)
        data = bytes(types().serialize_cdr(message, name))
        self.write_raw(topic, name, "ros2msg", text.encode(), data, time_ns, latched=latched)

    def write_raw(
        self,
        topic: str,
        schema_name: str,
        encoding: str,
        schema_data: bytes,
        data: bytes,
        time_ns: int,
        *,
        latched: bool = False,
    ) -> None:
        """Write a message that is serialised already.

        `encoding` is that of the schema, of https://mcap.dev/spec/registry: "protobuf",
        "jsonschema", "ros2msg", ...; it implies that of the message.
        """
        schema = schema_name, encoding
        with _refused(self._path):
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(*schema, schema_data)
            channel = self._connections.get((topic, schema_name))
            if channel is None:
                about = {"offered_qos_profiles": dump_qos_v8([_LATCHED])} if latched else {}
                channel = self._connections[topic, schema_name] = self._writer.register_channel(
                    topic,
                    _MESSAGE_ENCODINGS.get(encoding, encoding),
                    self._schemas[schema],
                    about,
                )
            self._writer.add_message(channel, log_time=time_ns, data=data, publish_time=time_ns)

    def _end(self, *, is_good: bool) -> None:
        if is_good:
            self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()


class _RosbagsWriter(_BagWriter):
    """A bag that rosbags writes."""

    _writer: Any

    def _put(self, topic: str, name: str, data: Any, time_ns: int, **about: Any) -> None:
        """Write a serialised message of a connection of which `about` is told."""
        if (topic, name) not in self._connections:
            self._connections[topic, name] = self._writer.add_connection(topic, name, **about)
        self._writer.write(self._connections[topic, name], time_ns, data)


class BagFolderWriter(_RosbagsWriter):
    """A ROS 2 bag that is a folder in the making.

    `storage` is "sqlite3" or "mcap". One that is overwritten must hold a bag.
    """

    def __init__(
        self,
        path: Path,
        *,
        storage: Literal["sqlite3", "mcap"] = "sqlite3",
        overwrite: bool = False,
    ) -> None:
        def is_ours(folder: Path) -> bool:
            mark = b"written_by: fieldgrid"
            return is_ros2_folder(folder) and mentions(folder / "metadata.yaml", mark)

        what = "a bag that fieldgrid has written"
        draft = DraftFolder(path, overwrite=overwrite, ours=is_ours, what=what)
        # The files within are named after this folder.
        self._inner = draft.folder / path.resolve().name
        self._storage = StoragePlugin[storage.upper()]
        super().__init__(path, draft)

    def _begin(self) -> None:
        self._writer = RosbagsWriter(self._inner, version=8, storage_plugin=self._storage)
        self._writer.open()
        self._writer.set_custom_data("written_by", "fieldgrid")

    def _write(self, topic: str, name: str, message: Any, time_ns: int, latched: bool) -> None:
        data, qos = types().serialize_cdr(message, name), [_LATCHED] if latched else []
        self._put(topic, name, data, time_ns, typestore=types(), offered_qos_profiles=qos)

    def _end(self, *, is_good: bool) -> None:
        if not is_good:
            self._writer.abort()
            return
        self._writer.close()
        for file in self._inner.iterdir():
            file.rename(self._inner.parent / file.name)
        self._inner.rmdir()


class Ros1BagWriter(_RosbagsWriter):
    """A `.bag` of ROS 1 in the making.

    Messages are those of ROS 2, of which ROS 1 gets what it has of them.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        def is_ours(file: Path) -> bool:
            return mentions(file, b"callerid=" + _CALLER.encode())

        draft = Draft(path, overwrite=overwrite, ours=is_ours, what="a ROS 1 bag")
        self._target = draft.file
        super().__init__(path, draft)

    def _begin(self) -> None:
        self._migrations: dict[str, object] = {}
        self._target.unlink()  # rosbags makes its files itself
        self._writer = RosbagsRos1Writer(self._target)
        self._writer.set_compression(RosbagsRos1Writer.CompressionFormat.LZ4)
        # ROS 1 reads no other frames: rosbags' own stop `rosbag play`.
        self._writer.compressor = partial(
            lz4.frame.compress,
            block_size=lz4.frame.BLOCKSIZE_MAX1MB,
            block_linked=False,
            content_checksum=True,
            store_size=False,
        )
        self._writer.open()

    def _write(self, topic: str, name: str, message: Any, time_ns: int, latched: bool) -> None:
        made = self._migrated(message)
        if name == "grid_map_msgs/msg/GridMap":
            made.info.header = self._migrated(message.header)
        data = ros1_types().serialize_ros1(made, name)
        about = {"typestore": ros1_types(), "callerid": _CALLER, "latching": int(latched)}
        self._put(topic, name, data, time_ns, **about)

    def _migrated(self, message: Any) -> Any:
        """The message as ROS 1 has it."""
        kind = message.__msgtype__
        return migrate_message(types(), ros1_types(), kind, kind, self._migrations, message)

    def _end(self, *, is_good: bool) -> None:
        self._writer.close()


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Makes an error of the disk one of fieldgrid, also where SQLite met it."""
    with writing(path):
        try:
            yield
        except sqlite3.Error as error:
            raise OSError(str(error)) from error

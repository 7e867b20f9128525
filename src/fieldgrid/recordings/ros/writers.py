"""New bags, which appear whole under their name or not at all."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import lz4.frame
from mcap.writer import CompressionType, Writer
from rosbags.convert.converter import migrate_message
from rosbags.interfaces import (
    Connection,
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
_PLUGINS = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}


def _is_ours(file: Path) -> bool:
    """Whether the header of an MCAP names us as its writer: others are recordings."""
    with file.open("rb") as opened:
        return b"fieldgrid" in opened.read(64)


def _is_our_bag(file: Path) -> bool:
    """Whether the connections of a ROS 1 bag name us as who spoke on them."""
    return mentions(file, b"callerid=" + _CALLER.encode())


def _is_our_folder(folder: Path) -> bool:
    """Whether a bag's metadata name us as its writer."""
    return is_ros2_folder(folder) and mentions(folder / "metadata.yaml", b"written_by: fieldgrid")


class McapWriter:
    """One `.mcap` file in the making, zstd-compressed and indexed; a context manager.

    It appears under `path` when the block ends well; nothing of it is left when it does not.
    Raises MapExistsError for a path that is taken and MapWriteError where the disk refuses.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self._path = path
        self._draft = Draft(path, overwrite=overwrite, ours=_is_ours, what="an MCAP")
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, int], int] = {}
        try:
            with _refused(path):
                self._file = self._draft.file.open("wb")
                self._writer = Writer(self._file, compression=CompressionType.ZSTD)
                self._writer.start(profile="ros2", library="fieldgrid")
        except BaseException:
            self._draft.discard()
            raise

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Write a message that is an instance of one of the classes of `types()`.

        What is `latched` is played to those too who subscribe later, as a map is.
        """
        name = message.__msgtype__
        schema = self._schemas.get((name, "ros2msg"))
        if schema is None:
            text, _ = types().generate_msgdef(name, ros_version=2)
            schema = self._schema(name, "ros2msg", text.encode())
        data = bytes(types().serialize_cdr(message, name))
        self._add(topic, schema, "cdr", data, time_ns, latched=latched)

    def write_raw(
        self,
        topic: str,
        schema_name: str,
        encoding: str,
        schema_data: bytes,
        data: bytes,
        time_ns: int,
    ) -> None:
        """Write a message that is serialised already.

        `encoding` is that of the schema, of https://mcap.dev/spec/registry: "protobuf",
        "jsonschema", "ros2msg", ...; it implies that of the message.
        """
        schema = self._schemas.get((schema_name, encoding))
        if schema is None:
            schema = self._schema(schema_name, encoding, schema_data)
        self._add(topic, schema, _MESSAGE_ENCODINGS.get(encoding, encoding), data, time_ns)

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with _refused(self._path):
                if kind is None:
                    self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.close()
            if kind is None:
                self._draft.publish()
        finally:
            self._draft.discard()

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        with _refused(self._path):
            number: int = self._writer.register_schema(name, encoding, data)
        self._schemas[name, encoding] = number
        return number

    def _add(
        self,
        topic: str,
        schema: int,
        encoding: str,
        data: bytes,
        time_ns: int,
        *,
        latched: bool = False,
    ) -> None:
        with _refused(self._path):
            channel = self._channels.get((topic, schema))
            if channel is None:
                about = {"offered_qos_profiles": dump_qos_v8([_LATCHED])} if latched else {}
                channel = self._writer.register_channel(topic, encoding, schema, about)
                self._channels[topic, schema] = channel
            self._writer.add_message(channel, log_time=time_ns, data=data, publish_time=time_ns)


class BagFolderWriter:
    """A ROS 2 bag that is a folder in the making; a context manager.

    `storage` is "sqlite3" or "mcap". The folder appears under `path` when the block ends well;
    nothing of it is left when it does not. One that is overwritten must hold a bag. Raises
    MapExistsError for a path that is taken and MapWriteError where the disk refuses.
    """

    def __init__(
        self,
        path: Path,
        *,
        storage: Literal["sqlite3", "mcap"] = "sqlite3",
        overwrite: bool = False,
    ) -> None:
        self._path = path
        self._draft = DraftFolder(
            path, overwrite=overwrite, ours=_is_our_folder, what="a bag that fieldgrid has written"
        )
        self._connections: dict[tuple[str, str], Connection] = {}
        # The files within are named after this folder.
        self._inner = self._draft.folder / path.resolve().name
        try:
            with _refused(path):
                self._writer = RosbagsWriter(
                    self._inner, version=8, storage_plugin=_PLUGINS[storage]
                )
                self._writer.open()
                self._writer.set_custom_data("written_by", "fieldgrid")
        except BaseException:
            self._draft.discard()
            raise

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Write a message that is an instance of one of the classes of `types()`.

        What is `latched` is played to those too who subscribe later, as a map is.
        """
        name = message.__msgtype__
        with _refused(self._path):
            connection = self._connections.get((topic, name))
            if connection is None:
                connection = self._writer.add_connection(
                    topic,
                    name,
                    typestore=types(),
                    offered_qos_profiles=[_LATCHED] if latched else [],
                )
                self._connections[topic, name] = connection
            self._writer.write(connection, time_ns, types().serialize_cdr(message, name))

    def __enter__(self) -> BagFolderWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with _refused(self._path):
                if kind is None:
                    self._writer.close()
                    for file in self._inner.iterdir():
                        file.rename(self._draft.folder / file.name)
                    self._inner.rmdir()
                else:
                    self._writer.abort()
            if kind is None:
                self._draft.publish()
        finally:
            self._draft.discard()


class Ros1BagWriter:
    """A `.bag` of ROS 1 in the making; a context manager.

    Messages are those of ROS 2, of which ROS 1 gets what it has of them. The file appears under
    `path` when the block ends well; nothing of it is left when it does not. Raises MapExistsError
    for a path that is taken and MapWriteError where the disk refuses.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self._path = path
        self._draft = Draft(path, overwrite=overwrite, ours=_is_our_bag, what="a ROS 1 bag")
        self._connections: dict[tuple[str, str], Connection] = {}
        self._known: dict[str, object] = {}
        try:
            with _refused(path):
                self._draft.file.unlink()  # rosbags makes its files itself
                self._writer = RosbagsRos1Writer(self._draft.file)
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
        except BaseException:
            self._draft.discard()
            raise

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Write a message that is an instance of one of the classes of `types()`.

        What is `latched` is played to those too who subscribe later, as a map is.
        """
        name, store = message.__msgtype__, ros1_types()
        made: Any = migrate_message(types(), store, name, name, self._known, message)
        if name == "grid_map_msgs/msg/GridMap":
            header = message.header
            made.info.header = migrate_message(
                types(), store, header.__msgtype__, header.__msgtype__, self._known, header
            )
        with _refused(self._path):
            connection = self._connections.get((topic, name))
            if connection is None:
                connection = self._writer.add_connection(
                    topic, name, typestore=store, callerid=_CALLER, latching=int(latched)
                )
                self._connections[topic, name] = connection
            self._writer.write(connection, time_ns, store.serialize_ros1(made, name))

    def __enter__(self) -> Ros1BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with _refused(self._path):
                self._writer.close()
            if kind is None:
                self._draft.publish()
        finally:
            self._draft.discard()


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Makes an error of the disk one of fieldgrid, also where SQLite met it."""
    with writing(path):
        try:
            yield
        except sqlite3.Error as error:
            raise OSError(str(error)) from error

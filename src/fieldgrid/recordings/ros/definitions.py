"""What the bytes of a message mean: its definition, from the bag or from a ROS distribution."""

from __future__ import annotations

import re
import struct
from functools import cache, lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fieldgrid.core import RecordingError, quoted, shortened
from fieldgrid.recordings.ros.model import Connection, Message

_HEADER = "std_msgs/msg/Header"
_HEADER_FIRST = re.compile(
    r"(?:[ \t]*+(?:#[^\n]*|[^\s#][^\n#=]*+=[^\n]*)?+\r?\n)*+"  # remarks and constants
    r"[ \t]*+(?:std_msgs/(?:msg/)?)?Header[ \t]"
)
_ENCODINGS = ("cdr", "ros1")
_STAMP_AT = 4  # after the CDR encapsulation or the sequence number

_NMEA = "std_msgs/Header header\nstring sentence\n"
_GEO_POINT = "float64 latitude\nfloat64 longitude\nfloat64 altitude\n"
_MAP_UPDATE = """std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""
_FILTER_INFO = """std_msgs/Header header
uint8 type
string filter_mask_topic
float32 base
float32 multiplier
"""
_GRID_MAP = """std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
"""
_GRID_MAP_INFO = """float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""

# In ROS 1 the header of a grid map is in its info.
_ROS1_GRID_MAP = _GRID_MAP.removeprefix("std_msgs/Header header\n")
_ROS1_GRID_MAP_INFO = "std_msgs/Header header\n" + _GRID_MAP_INFO
_TF = "geometry_msgs/TransformStamped[] transforms\n"

_FIRST_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""What ROS 1 called a type at first."""

_MATRICES = {"sensor_msgs/msg/CameraInfo": frozenset("DKRP"), "stereo_msgs/msg/DisparityImage": "T"}
"""Fields that ROS 1 writes large, and ROS 2 small."""

# RealSense's recorder has a version in the place of the frame, and where it is 1, the unit of
# depths after what the definition says: third-party/realsense-file/rosbag/msgs/sensor_msgs/Image.h
# in librealsense.
_VERSION_AT, _WITH_UNIT, _UNIT_BYTES = slice(12, 17), b"\x01\x00\x00\x001", 4

_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){2,}", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_MAX_UNROLLED = 10_000
_MAX_ARRAY = 1 << 26
_MAX_DEPTH = 50
_MAX_TYPES = 1000

# What rosbags raises for definitions that are none, on purpose and not.
_BAD_DEFINITION = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    NameError,
    RecursionError,
    SyntaxError,
    TypeError,
    TypesysError,
    ValueError,
)
_BAD_MESSAGE = (*_BAD_DEFINITION, SerdeError, MemoryError)

_Fields = dict[str, Any]  # as rosbags parses them: type -> (constants, [(name, description)])


def _with(release: Stores, more: dict[str, str]) -> Typestore:
    store = get_typestore(release)
    for name, text in more.items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def types() -> Typestore:
    """The types of ROS 2 Humble, and those beside them that are read or written."""
    more = {
        "geographic_msgs/msg/GeoPoint": _GEO_POINT,
        "map_msgs/msg/OccupancyGridUpdate": _MAP_UPDATE,
        "nav2_msgs/msg/CostmapFilterInfo": _FILTER_INFO,
        "nmea_msgs/msg/Sentence": _NMEA,
        "grid_map_msgs/msg/GridMapInfo": _GRID_MAP_INFO,
        "grid_map_msgs/msg/GridMap": _GRID_MAP,
    }
    return _with(Stores.ROS2_HUMBLE, more)


def encoded(message: Any) -> bytes:
    """A message of one of the classes of `types()` as ROS 2 sends it."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


@cache
def ros1_types() -> Typestore:
    """The types of ROS Noetic, and those beside them that are written."""
    more = {
        "tf2_msgs/msg/TFMessage": _TF,
        "grid_map_msgs/msg/GridMapInfo": _ROS1_GRID_MAP_INFO,
        "grid_map_msgs/msg/GridMap": _ROS1_GRID_MAP,
    }
    return _with(Stores.ROS1_NOETIC, more)


def has_header(connection: Connection) -> bool:
    """Whether the messages begin with a standard header; False where that is unknown."""
    if connection.encoding not in _ENCODINGS:
        return False
    if connection.definition is not None:  # parsing takes long
        return _HEADER_FIRST.match(connection.definition) is not None
    _, fields = _standard(connection.encoding).fielddefs.get(connection.type, ([], []))
    return bool(fields) and fields[0][1] == (Nodetype.NAME, _HEADER)


def stamp_ns(encoding: str, data: bytes | memoryview) -> int:
    """The stamp of the standard header that a message begins with; 0 where it is too short."""
    if len(data) < _STAMP_AT + 8:
        return 0
    order = "<II" if encoding == "ros1" else "<iI" if data[1] & 1 else ">iI"
    seconds, nanoseconds = struct.unpack_from(order, data, _STAMP_AT)
    return int(seconds) * 10**9 + int(nanoseconds)


def decode(message: Message) -> Any:
    """The message as a dataclass whose fields are named as in ROS 2, that of ROS 1 too.

    A bag brings the definitions of its types along. A type that ROS has is sure to have the fields
    that it has there. Raises RecordingError for bytes that do not fit the definition, for a type
    without one, and for messages that are not of ROS.
    """
    connection, data = message.connection, message.data
    name = connection.type
    if connection.topic.startswith("/device_") and name == "sensor_msgs/msg/Image":
        data = data[:-_UNIT_BYTES] if data[_VERSION_AT] == _WITH_UNIT else data
    if connection.encoding not in _ENCODINGS:
        raise RecordingError(
            f"Messages of {connection.topic} are encoded as {quoted(connection.encoding)}, which "
            "is not read; record them as ROS messages."
        )
    try:
        store = _store(name, connection.definition, connection.encoding)
    except _BAD_DEFINITION as error:
        raise RecordingError(
            f"The type {quoted(name)} of {connection.topic} has no definition that can be used "
            f"({shortened(error)}); convert the bag with a ROS distribution that knows the type."
        ) from error
    try:
        if connection.encoding == "ros1":
            return store.deserialize_ros1(data, name)
        return store.deserialize_cdr(data, name)
    except _BAD_MESSAGE as error:
        raise RecordingError(
            f"A message of {connection.topic} ({len(data)} bytes) does not fit its type "
            f"{quoted(name)}; leave it out."
        ) from error


def _standard(encoding: str) -> Typestore:
    return ros1_types() if encoding == "ros1" else types()


@lru_cache(maxsize=256)
def _store(name: str, definition: str | None, encoding: str) -> Typestore:
    """A store of one definition alone, so that none is in conflict with another: of the types that
    it needs, those that it leaves out taken from the standard ones. The constants are left out.

    rosbags makes code of these types and runs it, so the names, the sizes and the nesting are
    checked to be what they should; a type that ROS 2 has must have the fields that it has there.
    """
    known: _Fields = dict(_standard(encoding).fielddefs)
    if definition is not None:
        known.update(get_types_from_msg(definition.replace("\r\n", "\n"), name))
    needed: _Fields = {}
    _collect(name, known, needed, set(), _MAX_DEPTH)
    usual = types().fielddefs
    for own, (_, fields) in needed.items():
        _, wanted = usual.get(_FIRST_NAMES.get(own, own), ([], []))
        lacking = [field for field, kind in wanted if (field, kind) not in fields]
        if lacking:
            raise TypesysError(f"{own.rpartition('/')[2]} without a {lacking[0]}")
    store = get_typestore(Stores.EMPTY)
    store.register(needed)
    store.get_msgdef(name)
    return store


def _collect(
    name: str, known: _Fields, needed: _Fields, without_bytes: set[str], depth: int
) -> None:
    """Gather the type and the types of its fields in `needed`."""
    if name in needed:
        return
    if depth == 0 or len(needed) > _MAX_TYPES:
        raise TypesysError(f"{name} is nested too deep")
    if not _TYPE_NAME.fullmatch(name):
        raise TypesysError(f"{quoted(name)} is no type")
    fields = known[name][1]
    has_bytes = False
    for field, (kind, inner) in fields:
        if not _FIELD_NAME.fullmatch(field):
            raise TypesysError(f"{quoted(field)} is no field")
        element, named = (kind, inner)
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (element, named), count = inner
            # rosbags writes a line of code for each element that is not a number.
            unrolled = element == Nodetype.NAME or named[0] == "string"
            if kind == Nodetype.ARRAY and not 1 <= count <= (
                _MAX_UNROLLED if unrolled else _MAX_ARRAY
            ):
                raise TypesysError(f"{field} of {count} elements")
        if element == Nodetype.NAME:
            _collect(named, known, needed, without_bytes, depth - 1)
            if kind != Nodetype.NAME and named in without_bytes:
                raise TypesysError(f"{field} of nothing")  # as many as the bytes claim
        has_bytes = has_bytes or element != Nodetype.NAME or named not in without_bytes
    if not has_bytes:
        without_bytes.add(name)
    large = _MATRICES.get(name, ())
    renamed = [(field.lower() if field in large else field, kind) for field, kind in fields]
    if len({field for field, _ in renamed}) != len(renamed):
        raise TypesysError(f"{name} has two fields of one name")
    needed[name] = ([], renamed)

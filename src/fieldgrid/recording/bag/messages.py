"""Decoded messages that have the fields which their type promises.

A bag brings the definitions of its types along. One that is damaged, or was made to do harm, may
define an image without pixels.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from fieldgrid.errors import RecordingError
from fieldgrid.ros import Bag, Message, types

_ALSO = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}  # what ROS 1 called it first


def decoded(bag: Bag, message: Message) -> Any:
    """The message as a dataclass with the fields of its type, of ROS 2 or as ROS 1 writes them.

    Raises RecordingError for bytes that do not fit, and for a definition that is another.
    """
    found = bag.decode(message)
    if not _is_usual(found):
        raise RecordingError(
            f"{bag.path}: the messages of {message.topic} do not have the fields of "
            f"{found.__msgtype__}; record them with the definition of a ROS distribution."
        )
    return found


def field(message: Any, name: str) -> Any:
    """A field by its name in ROS 2; ROS 1 writes those of matrices large."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())


def _is_usual(found: Any) -> bool:
    kind: Any = type(found)
    nested = _nested(kind)
    if nested is None:
        return False
    for name in nested:
        inner = getattr(found, name)
        if not all(map(_is_usual, inner if isinstance(inner, list) else (inner,))):
            return False
    return True


@lru_cache(maxsize=1024)
def _nested(kind: Any) -> tuple[str, ...] | None:
    """The fields of a message class that hold messages; None for a class that lacks a field of
    its type, or has another in its place."""
    fields = _fields(kind)
    name = kind.__msgtype__
    usual = _fields(types().types[_ALSO.get(name, name)])
    for key, annotation in usual.items():
        if annotation not in (fields.get(key), fields.get(key.upper())):
            return None
    return tuple(key for key, annotation in usual.items() if "__msg__" in annotation)


def _fields(kind: Any) -> dict[str, str]:
    # Constants are class variables.
    fields = kind.__dataclass_fields__.values()
    return {one.name: one.type for one in fields if not one.type.startswith("ClassVar")}

"""YAML files of calibrations, from strangers: numbers, sizes and matrices with errors that name
the file."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fieldgrid.core import CalibrationError, Float64, shortened
from fieldgrid.recordings.files import read_text

_MAX_BYTES = 1 << 16
_MAX_DEPTH = 50
_MAX_SCALAR = 1000
_MERGE = "tag:yaml.org,2002:merge"


class _Loader(yaml.SafeLoader):
    """Plain YAML in which each value stands for itself, so that what it unfolds to is not larger
    than its text; and OpenCV's tag for a matrix as the mapping that it is."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node; ValueError for one that is not plain."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        if getattr(event, "anchor", None) is not None:
            raise ValueError(
                f"line {line} has an anchor or alias where the value itself must stand"
            )
        if len(getattr(event, "value", "")) > _MAX_SCALAR:
            raise ValueError(f"a value in line {line} has more than {_MAX_SCALAR} characters")
        if self.depth == _MAX_DEPTH:
            raise ValueError(f"line {line} is nested too deeply")
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        if node is not None and node.tag == _MERGE:
            raise ValueError(f"line {line} has a merge key where the values themselves must stand")
        return node


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def parse_yaml(text: str) -> Any:
    """The value of a YAML document without aliases. ValueError says why there is none."""
    if len(text) > _MAX_BYTES:
        raise ValueError(f"it has more than {_MAX_BYTES} characters")
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, TypeError, LookupError) as problem:
        raise ValueError(shortened(problem)) from problem


def load_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a file; CalibrationError for anything else."""
    # OpenCV's own reader of this format is not made for files from strangers.
    text = read_text(path, _MAX_BYTES, CalibrationError)
    if text.startswith("%YAML:1.0"):  # OpenCV's header, which is no YAML
        text = text.partition("\n")[2]
    try:
        document = parse_yaml(text)
    except ValueError as problem:
        raise CalibrationError(f"{path} is not YAML: {problem}; correct it.") from problem
    if not isinstance(document, dict):
        raise CalibrationError(f"{path} holds no calibration; write it again.")
    return document


def image_size(document: Mapping[str, Any], path: Path) -> tuple[int, int]:
    """image_width and image_height."""
    sizes = []
    for key in ("image_width", "image_height"):
        value = document.get(key)
        if not isinstance(value, int):
            raise CalibrationError(
                f"{path}: {key} is {shortened(repr(value), 60)}; add the image size in pixels."
            )
        sizes.append(value)
    return sizes[0], sizes[1]


def resolution(document: Mapping[str, Any], path: Path) -> tuple[int, int]:
    """`resolution` as Kalibr and EuRoC write it."""
    value = document.get("resolution")
    whole = isinstance(value, list) and all(type(v) is int for v in value)
    if not (isinstance(value, list) and whole and len(value) == 2):
        raise CalibrationError(
            f"{path}: resolution is {shortened(repr(value), 60)}; give [width, height] in pixels."
        )
    return value[0], value[1]


def matrix(
    document: Mapping[str, Any], key: str, shape: tuple[int, int] | None, path: Path
) -> Float64:
    """The matrix `key`, of `shape` or of any; its numbers stand below `data`."""
    entry = document.get(key)
    data = entry.get("data") if isinstance(entry, dict) else None
    return _numbers(data, key, shape, path)


def rows(document: Mapping[str, Any], key: str, shape: tuple[int, int], path: Path) -> Float64:
    """The matrix `key`, written as a list of rows."""
    lines = document.get(key)
    flat: list[object] = []
    for line in lines if isinstance(lines, list) else ():
        whole = isinstance(line, list) and len(line) == shape[1]
        flat += line if whole else [None]
    return _numbers(flat, key, shape, path)


def listed(document: Mapping[str, Any], key: str, count: int | None, path: Path) -> Float64:
    """The list `key`, of `count` numbers or of any."""
    values = _numbers(document.get(key), key, None if count is None else (1, count), path)
    return values.ravel()


def _numbers(data: object, key: str, shape: tuple[int, int] | None, path: Path) -> Float64:
    try:
        found = [float(v) for v in data] if isinstance(data, list) else [math.nan]
    except (TypeError, ValueError, OverflowError):
        found = [math.nan]
    values = np.array(found, dtype=np.float64)
    size = values.size if shape is None else shape[0] * shape[1]
    if values.size != size or not np.isfinite(values).all():
        wanted = "a matrix" if shape is None else f"a matrix of {shape[0]} x {shape[1]}"
        raise CalibrationError(f"{path} lacks {key} as {wanted} of numbers; add its data.")
    return values if shape is None else values.reshape(shape)

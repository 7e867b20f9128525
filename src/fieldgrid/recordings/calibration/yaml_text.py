"""YAML files of calibrations, from strangers: sizes and numbers with errors that name the file."""

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
_MAX_NUMBER = 1e9
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
    """The (width, height) of images: `resolution`, or image_width and image_height."""
    apart = [document.get("image_width"), document.get("image_height")]
    size_px = document.get("resolution", apart)
    is_list = isinstance(size_px, list) and len(size_px) == 2
    if not (is_list and all(type(side) is int for side in size_px)):
        raise CalibrationError(
            f"{path}: the size of its images is {shortened(repr(size_px), 60)}; give image_width "
            "and image_height in pixels, or resolution: [width, height]."
        )
    return size_px[0], size_px[1]


def numbers(
    document: Mapping[str, Any], key: str, shape: tuple[int, ...] | None, path: Path
) -> Float64:
    """The numbers `key`, of `shape` or in a row of any length: a matrix of OpenCV with its `data`,
    a list, a list of rows, or words in a line."""
    entry = document.get(key)
    entry = entry.get("data") if isinstance(entry, dict) else entry
    try:
        values = np.asarray(entry.split() if isinstance(entry, str) else entry, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.array(math.nan)
    count = values.size if shape is None else math.prod(shape)
    in_rows = values.ndim == 1 or values.shape == shape
    if not (in_rows and values.size == count and (np.abs(values) < _MAX_NUMBER).all()):
        size = "" if shape is None else f"{' x '.join(map(str, shape))} "
        raise CalibrationError(f"{path} lacks {key} as {size}numbers; add or restore them.")
    return values.reshape(-1 if shape is None else shape)

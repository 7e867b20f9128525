"""Pairs of images that a process has matched before are not matched again.

OpenCV's matcher takes three quarters of the time of a frame, and hundreds of tests that are about
something else give it the same few images of the example.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid import stereo
from fieldgrid.settings import StereoSettings

KEPT = 200
"""Disparity maps of half a megabyte each."""

_Images = npt.NDArray[np.uint8]
_Disparity = npt.NDArray[np.int16]

_make = stereo.make_matcher
_known: dict[tuple[object, ...], _Disparity] = {}


class Matcher:
    """What `stereo.make_matcher` makes, with a memory: for the same settings and the same pixels
    it says the same, whichever thread asks."""

    def __init__(self, settings: StereoSettings, num_disparities: int) -> None:
        self._of = settings.model_dump_json(), num_disparities
        self._matcher = _make(settings, num_disparities)
        self.matched = 0

    def compute(self, left: _Images, right: _Images) -> _Disparity:
        key = (*self._of, *_told(left), *_told(right))
        found = _known.get(key)
        if found is None:
            self.matched += 1
            found = _known[key] = self._matcher.compute(left, right)
            if len(_known) > KEPT:
                del _known[next(iter(_known))]
        return found.copy()


def _told(image: _Images) -> tuple[object, ...]:
    return image.shape, str(image.dtype), hashlib.sha256(np.ascontiguousarray(image)).digest()


@contextmanager
def matched_once() -> Iterator[None]:
    """Within it, this process matches a pair once; processes that it starts do not know."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stereo, "make_matcher", Matcher)
        yield

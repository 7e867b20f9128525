"""The version of this package."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version


@cache
def software_version() -> str:
    """The version of this package, as it is written into maps."""
    try:
        return version("fieldgrid")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"

"""Files that this machine and the workers of a cluster are to have at the same path."""

from __future__ import annotations

import platform
from pathlib import Path

from fieldgrid.core.errors import ClusterError


def check_is_here(path: Path, size: int | None, things: str) -> None:
    """Raise ClusterError when this worker has no file at a path, or one of another size, bytes;
    None for a folder. `things` are what is to be copied there."""
    remedy = f"mount or copy the {things} to the same path on every worker."
    if not path.exists():
        raise ClusterError(f"{path} does not exist on the worker {platform.node()}; {remedy}")
    found = path.stat().st_size
    if size is not None and found != size:
        raise ClusterError(
            f"{path} has {found} bytes on the worker {platform.node()}, and {size} here; {remedy}"
        )

"""The first run on a machine says that it compiles, before it does."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("flags", [(), ("--quiet",)])
def test_compiling_is_said_also_where_no_terminal_is(
    flags: tuple[str, ...], two_lanes_map: Path, tmp_path: Path
) -> None:
    asked = [sys.executable, "-m", "fieldgrid", "rows", str(two_lanes_map), *flags]
    first, later = (
        subprocess.run(
            asked,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    )
    assert first.stderr.count("fieldgrid: compiling") == (0 if flags else 1)
    assert "fieldgrid: compiling" not in later.stderr
    assert later.stdout == first.stdout

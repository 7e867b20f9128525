"""Every reader under 1 GB of address space and 20 s of processor time, whatever it is given."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.bounds.inputs import CASES

ROOT = Path(__file__).parents[2]

QUICK = (
    "frames_of_one_line", "time_log_of_entities", "keys_of_dots", "keys_of_dots_of_a_vehicle",
    "keys_of_dots_of_a_build", "deep_documents", "yaml_of_aliases", "array", "pcd", "las",
    "picture_headers_without_end", "las_of_records",
    "archive_at_a_url", "opencv_of_aliases", "journal_of_a_map",
    "bag_of_zstd", "database_of_zeros", "truth_origin", "map_of_many_sessions",
)  # fmt: skip
"""Refused at once; they run with each change. The others are a million rows and the like."""

READ = {
    "stamps_of_kitti", "table_of_fixes", "sentences", "solution_of_rtklib", "logs_of_novatel",
    "ubx_messages", "ubx_heads", "taskdata",
    "gyro_and_wheels", "poses_with_times", "poses_without_times", "ply", "pcd_as_text",
    "database_of_zeros", "truth_poses", "survey_features", "marks", "route_poses", "route_figure",
    "live_journal", "growing_table",
}  # fmt: skip
"""What is long, but good; the others are refused."""


def check(names: tuple[str, ...], folder: Path) -> None:
    # Threads of BLAS take addresses that no reader asked for.
    alone = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "tests.bounds.run", str(folder), *names],
        cwd=ROOT,
        env={**os.environ, **alone},
        capture_output=True,
        text=True,
        check=True,
    )
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert [name for name, *_ in said] == list(names)
    for name, became, *_ in said:
        wanted = "read" if name in READ else "refused: "
        assert became.startswith(wanted), f"{name}: {became}\n{done.stderr[-2000:]}"
        assert became.count("\n") == 0
        assert len(became) < 1000


def test_small_files_that_unfold_to_much(tmp_path: Path) -> None:
    check(QUICK, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(CASES.keys() - set(QUICK)))
def test_long_files(name: str, tmp_path: Path) -> None:
    check((name,), tmp_path)

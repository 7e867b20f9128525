"""Maps of format 2, which hold densities of 8 bits and nothing else, are aligned as any others."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.field import align_map
from fieldgrid.maps import Transform, open_map
from fieldgrid.maps.file.codec import encode_channels
from fieldgrid.maps.file.digest import as_json
from tests.field.align.field import SPEC, Drive, Field, write_field

FORMAT_2 = Path(__file__).parents[2] / "maps" / "file" / "format2.gpkg"
OFF = Transform(0.6, -0.4)


def older(path: Path, drives: Mapping[str, Drive]) -> Path:
    """The map of format 2 of the tests, with other frames in two of its drives."""
    shutil.copy(FORMAT_2, path)
    with closing(sqlite3.connect(path)) as database:
        database.execute("DELETE FROM fieldgrid_frame")
        for session_id, (name, frames) in enumerate(drives.items(), 1):
            database.execute(
                "UPDATE fieldgrid_session SET name = ?, first_time_ns = ?, last_time_ns = ?, "
                "frames = ?, accepted = ?, grid_width_m = ?, grid_length_m = ?, grid_cell_m = ? "
                "WHERE id = ?",
                (name, frames[0][1].time_ns, frames[-1][1].time_ns, len(frames), len(frames),
                 SPEC.width_m, SPEC.length_m, SPEC.cell_m, session_id),
            )  # fmt: skip
            for k, (grid, pose) in enumerate(frames):
                values = [f"{k:06d}", *astuple(pose)[:8], pose.status.value, "", None, "[]", "[]"]
                hashed = hashlib.sha256(as_json(values))
                hashed.update(grid.density.tobytes())
                hashed.update(np.packbits(grid.observed).tobytes())
                cells = {c.name: c.data for c in encode_channels(grid, {})[0]}
                database.execute(
                    "INSERT INTO fieldgrid_frame (session_id, frame_id, time_ns, east_m, north_m, "
                    "up_m, heading_deg, position_sigma_m, heading_sigma_deg, speed_mps, status, "
                    "reason, quality, images, images_sha256, digest, density, observed) "
                    f"VALUES (?{', ?' * 17})",
                    (session_id, *values, hashed.hexdigest(), cells["density"], cells["observed"]),
                )
        database.commit()
    return path


@pytest.fixture(scope="module")
def drives() -> dict[str, Drive]:
    field = Field()
    return {
        "june": field.drive([0.0], sigma_m=0.02),
        "july": field.drive([0.0], by=OFF, seed=7, start_s=1e5),
    }


def test_what_is_found_is_that_of_a_map_of_today(
    tmp_path: Path, drives: Mapping[str, Drive]
) -> None:
    path = older(tmp_path / "old.gpkg", drives)
    before = path.read_bytes()
    with (
        open_map(write_field(tmp_path / "new.gpkg", drives)) as new,
        open_map(path) as old,
    ):
        found, expected = align_map(old), align_map(new)
    assert path.read_bytes() == before
    assert found.transforms == expected.transforms
    (pair,) = found.pairs
    assert pair.doubt is None
    assert pair.before_m == pytest.approx([0.6, -0.4], abs=0.05)
    assert np.hypot(*pair.after_m) < 0.05


def test_it_is_brought_to_the_present_format_and_back_into_place(
    tmp_path: Path, drives: Mapping[str, Drive]
) -> None:
    path = older(tmp_path / "old.gpkg", drives)
    with open_map(path) as old:
        found = align_map(old)
        names = [info.name for info in old.sessions()]
        poses = [frame.pose for name in names for frame in old.frames(name)]
    with open_map(path, writable=True) as universal:
        universal.set_transforms(found.transforms)
        picture = universal.read()
        moved = [frame.pose for name in names for frame in universal.frames(name)]
        assert moved != poses
        universal.set_transforms({name: Transform() for name in found.transforms})
        assert [frame.pose for name in names for frame in universal.frames(name)] == poses
        assert (picture.density > 100).any()

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays_of

from fieldgrid.core import ConfigError, MapError
from fieldgrid.maps import create_map, open_map
from fieldgrid.maps.file import arrays as arrays_module
from fieldgrid.maps.file.arrays import ArrayKind, array_rows, read_arrays
from tests.maps.file.maps import CELL_M, DATUM, drive, grid_of, pose_at, track


def through_a_database(named: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    database = sqlite3.connect(":memory:")
    database.execute(
        "CREATE TABLE fieldgrid_array (session_id, kind, name, part, dtype, shape, data)"
    )
    rows = [(1, *row) for row in array_rows(ArrayKind.INPUT, named)]
    database.executemany("INSERT INTO fieldgrid_array VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    try:
        return read_arrays(database, 1, ArrayKind.INPUT)
    finally:
        database.close()


@settings(max_examples=60, deadline=None)
@given(
    arrays_of.arrays(
        st.one_of(
            arrays_of.boolean_dtypes(),
            arrays_of.integer_dtypes(),
            arrays_of.unsigned_integer_dtypes(),
            arrays_of.floating_dtypes(sizes=(16, 32, 64)),
            arrays_of.complex_number_dtypes(sizes=(64, 128)),
            arrays_of.datetime64_dtypes(max_period="s", min_period="ns"),
            arrays_of.byte_string_dtypes(),
            arrays_of.unicode_string_dtypes(),
        ),
        arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
    )
)
def test_an_array_reads_back_bit_for_bit(array: np.ndarray) -> None:
    read = through_a_database({"a": array})["a"]
    assert read.shape == array.shape
    assert read.dtype == array.dtype.newbyteorder("=")
    assert read.tobytes() == array.astype(array.dtype.newbyteorder("=")).tobytes()


def test_a_long_array_is_stored_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays_module, "_PART_BYTES", 100)
    gyro = np.arange(99.0).reshape(33, 3)
    assert len(list(array_rows(ArrayKind.INPUT, {"gyro": gyro}))) == 9
    np.testing.assert_array_equal(through_a_database({"gyro": gyro})["gyro"], gyro)


def test_what_a_session_was_made_from_comes_back(tmp_path: Path) -> None:
    given_arrays = {
        "gyro_rad_s": np.random.default_rng(1).normal(size=(500, 3)),
        "fix/time_ns": np.arange(7),
        "empty": np.zeros((0, 3), dtype=np.float32),
        "one": np.float64(2.5),
    }
    with create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M) as universal:
        with universal.add_session("a", inputs=given_arrays, trajectory=track(4)) as session:
            session.add(*drive(1)[0])
        with universal.add_session("b") as session:
            session.add(grid_of(1), pose_at(0.0, 0.0, 0.0))
    with open_map(tmp_path / "map.gpkg") as universal:
        read = universal.session_inputs("a")
        assert universal.session_inputs("b") == {}
        with pytest.raises(ConfigError, match="no session 'c'"):
            universal.session_inputs("c")
    assert sorted(read) == sorted(given_arrays)
    for name, array in given_arrays.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == np.asarray(array).dtype


@pytest.mark.parametrize(
    "array", [np.array([object()]), np.zeros(2, dtype=[("a", "f8"), ("b", "i4")])]
)
def test_what_is_no_plain_array_is_refused_before_anything_is_done(
    array: np.ndarray, tmp_path: Path
) -> None:
    with (
        create_map(tmp_path / "map.gpkg", DATUM) as universal,
        pytest.raises(ConfigError, match=r"'x' holds .*an array a field"),
    ):
        universal.add_session("a", inputs={"x": array})


@pytest.mark.parametrize(
    "change",
    [
        "dtype = 'O'",
        "dtype = 'nonsense'",
        "shape = '[9000000000000]'",
        "shape = '[-1]'",
        "shape = 'x'",
        "part = 1",
        "data = 'text'",
        "data = zeroblob(9)",
    ],
)
def test_a_damaged_array_is_an_error_of_ours(change: str) -> None:
    database = sqlite3.connect(":memory:")
    database.execute(
        "CREATE TABLE fieldgrid_array (session_id, kind, name, part, dtype, shape, data)"
    )
    rows = [(1, *row) for row in array_rows(ArrayKind.INPUT, {"a": np.arange(10.0)})]
    database.executemany("INSERT INTO fieldgrid_array VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    database.execute(f"UPDATE fieldgrid_array SET {change}")
    with pytest.raises(MapError, match="damaged"):
        read_arrays(database, 1, ArrayKind.INPUT)
    database.close()

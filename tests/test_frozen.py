"""Frozen figures: what a benchmark printed is compared with what it printed before."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from benchmarks import frozen
from benchmarks.frozen_text import figures_of

TABLE = """\
forward on the rows; asked of RTK: precision >= 94 %
                          frames  prec 10cm    25cm
true poses                 31/31     97.0 %  99.2 %
RTK, 128 disparities       31/31     97.3 %  99.4 %
  with holes               30/31     95.0 %       -

layout 1: 35 right, 0 false; 100.0% of 68 lane ends within 1 m; 0.7 s
layout 2: 25 right, 0 false; 100.0% of 48 lane ends within 1 m; 1.1 s
nothing with a number
"""


class Bench:
    """A file of frozen figures, and outputs that stand for what is run."""

    def __init__(self, folder: Path) -> None:
        self.file, self._folder = folder / "frozen.json", folder

    def __call__(self, text: str, *arguments: str, part: str = "rows") -> int:
        output = self._folder / "output.txt"
        output.write_text(text, "utf-8")
        return frozen.main([*arguments, "--file", str(self.file), "--output", f"{part}={output}"])

    def entries(self, part: str = "rows") -> dict[str, dict[str, float | str]]:
        found: dict[str, dict[str, float | str]] = json.loads(self.file.read_text("utf-8"))[part][
            "figures"
        ]
        return found


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


@pytest.fixture
def table(bench: Bench, capsys: pytest.CaptureFixture[str]) -> Bench:
    """With the table frozen."""
    assert bench(TABLE, "--write") == 0
    capsys.readouterr()
    return bench


def test_figures_are_named_by_the_text_around_them() -> None:
    found = {figure.name: figure.value for figure in figures_of(TABLE)}
    assert found == {
        "true poses / frames": 31.0,
        "true poses / frames (2)": 31.0,
        "true poses / prec 10cm": 97.0,
        "true poses / 25cm": 99.2,
        "RTK, 128 disparities / frames": 31.0,
        "RTK, 128 disparities / frames (2)": 31.0,
        "RTK, 128 disparities / prec 10cm": 97.3,
        "RTK, 128 disparities / 25cm": 99.4,
        "RTK, 128 disparities / with holes / frames": 30.0,
        "RTK, 128 disparities / with holes / frames (2)": 31.0,
        "RTK, 128 disparities / with holes / prec 10cm": 95.0,
        **{
            f"layout {n} / {what}": value
            for n, right, ends, seconds in ((1, 35.0, 68.0, 0.7), (2, 25.0, 48.0, 1.1))
            for what, value in (
                ("# right", right),
                ("# false", 0.0),
                ("#% of # lane ends within # m; # s", 100.0),
                ("#% of # lane ends within # m; # s (2)", ends),
                ("#% of # lane ends within # m; # s (3)", 1.0),
                ("#% of # lane ends within # m; # s (4)", seconds),
            )
        },
    }


def test_values_are_named_alike_however_wide_they_are() -> None:
    lines = "NMEA: {} sentences/s, {} times\nsf1          off by {} m\nshare  7 of {}"
    names = [
        [figure.name for figure in figures_of(lines.format(*values))]
        for values in (("1,234", "9.1", "+0.123", "  5 %"), ("999", "12.0", "-12.1", "100 %"))
    ]
    assert names[0] == names[1]


def test_sentences_below_each_other_are_no_table() -> None:
    lines = (
        "lanes  gnss_rtk      obstacles   54.0 m²  moved  0.013 m²",
        "slope  gnss_rtk      obstacles   13.5 m²  moved  0.005 m²",
    )
    assert [figure.name for figure in figures_of("\n".join(lines))] == [
        "lanes gnss_rtk / obstacles # m²",
        "lanes gnss_rtk / moved # m²",
        "slope gnss_rtk / obstacles # m²",
        "slope gnss_rtk / moved # m²",
    ]


def test_a_header_may_follow_rows() -> None:
    lines = (
        "fault            drives      used   in 3 sigma",
        "none                 10   100.0 %      100.0 %",
        "sensors          drives      used   in 3 sigma",
        "gyro, 10 Hz           3       8 %            -",
    )
    assert {figure.name: figure.value for figure in figures_of("\n".join(lines))} == {
        "fault / none / drives": 10.0,
        "fault / none / used": 100.0,
        "fault / none / in 3 sigma": 100.0,
        "sensors / gyro, 10 Hz / drives": 3.0,
        "sensors / gyro, 10 Hz / used": 8.0,
    }


def test_the_same_output_has_not_moved(table: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert table(TABLE) == 0
    assert capsys.readouterr().out == ("rows: 23 figures, 0 moved, 0 lines vanished, 0 appeared\n")


def test_what_moved_is_named(table: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert table(TABLE.replace("97.3", "97.4").replace("0.7 s", "0.8 s")) == 0
    assert table(TABLE.replace("97.3", "91.3")) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[-2].startswith("rows: 23 figures, 1 moved")
    assert told[-1].startswith(
        "  moved  rows / RTK, 128 disparities / prec 10cm: was 97.3, is 91.3, tolerance 0.2"
    )


def test_lines_that_vanish_or_appear_are_named(
    table: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert table(TABLE.replace("layout 2:", "layout 3:").replace("99.2 %", "     -")) == 1
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  vanished  rows / layout 2 (6 figures)",
        "  vanished  rows / true poses / 25cm",
        "  appeared  rows / layout 3 (6 figures)",
    ]


def test_a_tolerance_by_hand_stays(table: Bench) -> None:
    text = table.file.read_text("utf-8")
    entry = '"RTK, 128 disparities / 25cm": {"value": 99.4, "tolerance": '
    assert entry in text
    before, after = text.split(entry)
    after = after.split("}", 1)[1]
    table.file.write_text(f'{before}{entry}5.0, "by": "hand"}}{after}', "utf-8")
    assert table(TABLE.replace("99.4", "98.0")) == 0
    assert table(TABLE.replace("99.4", "98.0"), "--write") == 0
    entries = table.entries()
    assert entries["RTK, 128 disparities / 25cm"] == {
        "value": 98.0,
        "tolerance": 5.0,
        "by": "hand",
    }
    assert "by" not in entries["true poses / 25cm"]


def test_other_parts_stay(table: Bench) -> None:
    rows = table.entries()
    assert table("NMEA: 200,000 sentences/s", "--write", part="parsing") == 0
    assert table.entries() == rows
    assert table.entries("parsing") == {
        "NMEA / # sentences/s": {"value": 200000.0, "tolerance": 80000.0}
    }


def test_another_seed_widens(bench: Bench) -> None:
    text = "fault   drives    used    wrong\nnone        10  {} %        1\n"
    assert bench(text.format("99.0"), "--write", part="random_drives_0") == 0
    narrow = bench.entries("random_drives_0")["fault / none / used"]["tolerance"]
    assert bench(text.format("19.0"), "--write", part="random_drives_5000") == 0
    for part in ("random_drives_0", "random_drives_5000"):
        assert bench.entries(part)["fault / none / used"]["tolerance"] == 80.0
    assert float(narrow) < 30.0


def test_what_cannot_be_measured_is_named(
    table: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And nothing that was frozen is lost."""
    frozen_before = table.file.read_text("utf-8")
    parts = {
        "rows": frozen.Part("benchmarks.rows", ("not_at_hand",)),
        "routes": frozen.Part("benchmarks.no_such_module"),
    }
    monkeypatch.setattr(frozen, "PARTS", parts)
    for arguments in ([], ["--write"]):
        assert frozen.main([*arguments, "--file", str(table.file)]) == 1
        told = capsys.readouterr().out
        assert "absent from ../shared/data: not_at_hand" in told
        assert "routes: not " in told
        assert "failed with exit status 1" in told
    assert table("no number") == 1
    assert table(TABLE, part="routes") == 1
    assert table.file.read_text("utf-8") == frozen_before
    told = capsys.readouterr().out
    assert "rows: not compared: it printed no figures" in told
    assert "routes: not compared: it has no frozen figures" in told


def test_every_part_is_a_benchmark() -> None:
    for part in frozen.PARTS.values():
        assert importlib.util.find_spec(part.command.split()[0]) is not None


def test_what_is_frozen_is_of_the_parts() -> None:
    """With different names, by which each line of the file can be found."""
    kept = json.loads(frozen.FROZEN.read_text("utf-8"))
    assert kept.keys() <= frozen.PARTS.keys()
    for part in kept.values():
        assert all(entry["tolerance"] >= 0.0 for entry in part["figures"].values())
    assert frozen.FROZEN.read_text("utf-8") == frozen._as_text(kept)


def test_the_parts_are_listed(table: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert frozen.main(["--list", "--file", str(table.file)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert len(told) == len(frozen.PARTS)
    assert any(line.startswith("rows ") and "23 figures" in line for line in told)

"""The documentation checker notices what is wrong, and only that."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import check_docs, tables
from tools.check_docs import Report, output_matches


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """A directory with a stand-in `fieldgrid` that prints its arguments, one a line."""
    directory = tmp_path / "bin"
    directory.mkdir()
    program = directory / "fieldgrid"
    program.write_text(
        "#!/bin/sh\n"
        'if [ "$1" = fail ]; then echo "Error: no such map" >&2; exit 3; fi\n'
        'for word in "$@"; do echo "$word"; done\n'
    )
    program.chmod(0o755)
    return directory


def check(text: str, programs: Path) -> Report:
    document = programs.parent / "page.md"
    document.write_text(text, encoding="utf-8")
    examples = programs.parent / "the examples"
    examples.mkdir(exist_ok=True)
    (examples / "drive.txt").write_text("tractor\n")
    report = Report()
    check_docs.check_document(document, examples, programs, report)
    return report


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ([], []),
        (["12 frames"], ["12 frames  ", ""]),
        (["12 frames in ... s"], ["12 frames in 3.4 s"]),
        (["... frames in ... s"], ["12 frames in 3.4 s"]),
        (["..."], []),
        (["..."], ["a", "b"]),
        (["a", "...", "d"], ["a", "b", "c", "d"]),
        (["a", "...", "d"], ["a", "d"]),
        (["...", "b", "c"], ["b", "a", "b", "c"]),
        (["a", "..."], ["a", "b", "c"]),
        (["...", "x ... z", "..."], ["a", "x y z", "b"]),
    ],
)
def test_output_as_shown_matches(shown: list[str], printed: list[str]) -> None:
    assert output_matches(shown, printed)


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ([], ["a"]),
        (["a"], []),
        (["12 frames"], ["13 frames"]),
        (["12 frames"], ["112 frames"]),
        (["a.c"], ["abc"]),
        (["12 frames in ... s"], ["13 frames in 3.4 s"]),
        (["12 frames in ... s"], ["12 frames in", "3.4 s"]),
        (["a", "...", "d"], ["a", "b", "c"]),
        (["a", "...", "d"], ["a", "d", "e"]),
        (["...", "b", "c"], ["b", "a", "c"]),
    ],
)
def test_other_output_does_not_match(shown: list[str], printed: list[str]) -> None:
    assert not output_matches(shown, printed)


def test_a_command_that_prints_what_is_shown_passes(programs: Path) -> None:
    report = check(
        "```console\n"
        "$ git clone somewhere\n"
        "Cloning...\n"
        "$ fieldgrid one two | sort -r\n"
        "two\n"
        "o...e\n"
        "$ fieldgrid a \\\n"
        ">     b\n"
        "a\n"
        "b\n"
        "```\n",
        programs,
    )
    assert (report.run, report.skipped, report.failures) == (1, 0, [])


def test_folders_are_made_and_files_are_shown(programs: Path) -> None:
    text = (
        "```console\n$ mkdir out\n$ fieldgrid 'a word' > out/said\n$ cat out/said\na word\n"
        "$ cathedral\n```\n"
    )
    report = check(text, programs)
    assert (report.run, report.failures) == (1, [])
    (failure,) = check(text.replace("\na word\n", "\nanother\n"), programs).failures
    assert "-another\n+a word" in failure.message


def test_a_command_that_prints_something_else_fails_with_a_diff(programs: Path) -> None:
    report = check(
        "Text\n\n```console\n$ fieldgrid one two\none\nthree\n```\n",
        programs,
    )
    (failure,) = report.failures
    assert failure.line == 4
    assert str(failure).startswith(f"{programs.parent / 'page.md'}:4: $ fieldgrid one two\n")
    assert "\n one\n-three\n+two" in failure.message


def test_the_diff_leaves_out_what_an_ellipsis_allows(programs: Path) -> None:
    report = check("```console\n$ fieldgrid 'in 3 s' two\nin ... s\n2\n```\n", programs)
    (failure,) = report.failures
    assert "\n in ... s\n-2\n+two" in failure.message


def test_a_command_must_succeed_unless_its_status_is_shown(programs: Path) -> None:
    failing = "```console\n$ fieldgrid fail\nError: no such map\n"
    (failure,) = check(failing + "```\n", programs).failures
    assert "exit status 3, not 0" in failure.message
    assert "Error: no such map" in failure.message

    assert check(failing + "$ echo $?\n3\n```\n", programs).failures == []


def test_a_block_marked_as_not_run_is_skipped_and_counted(programs: Path) -> None:
    report = check(
        "<!-- not run: needs a receiver -->\n"
        "```console\n$ fieldgrid fail\n```\n\n"
        "<!-- not run: needs a camera -->\n\n"
        "```python\n1 / 0\n```\n",
        programs,
    )
    assert (report.run, report.skipped, report.failures) == (0, 2, [])


@pytest.mark.parametrize(
    "before", ["<!-- not run: -->", "<!-- not run -->", "<!-- not run: it is slow -->\nText"]
)
def test_a_skip_needs_a_reason_right_before_the_block(before: str, programs: Path) -> None:
    report = check(f"{before}\n```python\n1 / 0\n```\n", programs)
    assert (report.run, report.skipped, len(report.failures)) == (1, 0, 1)


def test_blocks_share_a_directory_and_python_blocks_a_namespace(programs: Path) -> None:
    report = check(
        "1. In a list\n"
        "   ```python\n"
        "   from pathlib import Path\n"
        "   drive = Path('examples/drive.txt').read_text()\n"
        "   ```\n"
        "```console\n$ fieldgrid made > map.txt\n```\n"
        "```python\nassert drive == 'tractor\\n'\nassert Path('map.txt').read_text() == 'made\\n'\n"
        "```\n"
        "```sh\nno such program\n```\n",
        programs,
    )
    assert (report.run, report.failures) == (3, [])
    assert not Path("map.txt").exists()


@pytest.mark.parametrize(
    ("code", "line", "message"),
    [
        ("x = 1\nassert x == 2", 5, "AssertionError"),
        ("def f():\n    return {}['key']\nf()", 5, "KeyError: 'key'"),
        ("x = 1\nx ==== 2", 5, "SyntaxError"),
        ("print('got here')\nraise SystemExit(1)", 5, "got here"),
    ],
)
def test_python_that_fails_is_reported_at_its_line(
    code: str, line: int, message: str, programs: Path
) -> None:
    (failure,) = check(f"Title\n\n```python\n{code}\n```\n", programs).failures
    assert failure.line == line
    assert message in failure.message


def test_the_exit_status_and_the_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = tmp_path / "good.md"
    good.write_text("```python\nassert True\n```\n")
    bad = tmp_path / "bad.md"
    bad.write_text("```python\nassert False\n```\n")

    assert check_docs.main([str(good)]) == 0
    assert capsys.readouterr().out == "1 documents: 1 blocks run, 0 skipped, 0 failures\n"
    assert check_docs.main([str(good), str(bad)]) == 1
    out = capsys.readouterr().out
    assert out.startswith(f"{bad}:2: ")
    assert out.endswith("2 documents: 2 blocks run, 0 skipped, 1 failures\n")


def test_a_table_that_is_out_of_date_is_reported(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("# Page\n\n<!-- table: formats -->\n| old |\n<!-- end of table -->\n")
    report = Report()
    check_docs.check_document(document, tmp_path, tmp_path, report)
    (failure,) = report.failures
    assert (failure.line, "a table is out of date" in failure.message) == (4, True)
    document.write_text(tables.renewed(document.read_text()))
    assert "| `geotiff` | `.tif` `.tiff` |" in document.read_text()
    check_docs.check_document(document, tmp_path, tmp_path, fresh := Report())
    assert fresh.failures == []


def test_all_tables_stand_in_a_document() -> None:
    found = [
        name for one in tables.documents() for _, name, _ in tables.MARKED.findall(one.read_text())
    ]
    assert sorted(found) == sorted(tables.TABLES)

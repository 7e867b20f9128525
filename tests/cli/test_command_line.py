"""What holds of every command: help, completion, quiet and verbose, colours, and the last line of
defence."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fieldgrid.cli import defect, output
from fieldgrid.cli.listing import COMMANDS, load
from tests.cli.conftest import Run, a_terminal
from tests.conftest import TWO_LANES


def shell(*command: str, **environment: str) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    return done.stdout


SCRIPT = str(Path(sys.executable).with_name("fieldgrid"))


# --- help


@pytest.mark.parametrize("name", [None, *COMMANDS])
@pytest.mark.parametrize("columns", ["80", "200"])
def test_no_line_of_help_is_cut_or_too_long(
    name: str | None, columns: str, fieldgrid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    text = fieldgrid(*([] if name is None else [name, "--help-all"])).output()
    lines = text.splitlines()
    assert max(map(len, lines)) <= min(int(columns), 100)
    assert not [line for line in lines if line.endswith("...") and "Usage" not in line]
    # A word that was broken to fit would go on in the next line without a blank.
    assert not re.search(r"\w\|\n|\|\w+\n +\w+\|", text)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_shows_its_default_once(name: str, fieldgrid: Run) -> None:
    for line in re.split(r"\n(?=  -)", fieldgrid(name, "--help-all").output()):
        assert line.count("default:") <= 1, line


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_shows_how_it_is_used(name: str, fieldgrid: Run) -> None:
    _, found, examples = re.split(
        r"\n  (Examples?:)\n", fieldgrid(name, "--help-all").output(), maxsplit=1
    )
    assert found
    assert f"fieldgrid {name}" in examples


def test_options_are_grouped(fieldgrid: Run) -> None:
    text = fieldgrid("build", "--help-all").output()
    headings = re.findall(r"^(\w.*):$", text, re.MULTILINE)
    assert headings[:2] == ["Session and map file", "Recording"]
    assert headings[-1] == "Options"
    assert "Poses" in headings
    poses = text.partition("Poses:")[2].partition("\n\n")[0]
    assert "--heading" in poses
    assert "--gnss" not in poses


def test_a_command_like_another_is_suggested(fieldgrid: Run) -> None:
    assert "No such command 'bild'. Did you mean 'build'?" in fieldgrid("bild").usage()
    assert fieldgrid("xyz").usage().rstrip().endswith("No such command 'xyz'.")
    assert "--gnss" in fieldgrid("build", "--gns", "x").usage()


def test_every_command_reports_as_json_or_says_why_not(fieldgrid: Run) -> None:
    """`--json` for every command that reports."""
    for name in COMMANDS:
        assert "--json" in fieldgrid(name, "--help-all").output(), name


# --- completion


@pytest.mark.parametrize("shell_name", ["bash", "zsh", "fish", "powershell"])
def test_completion_scripts(shell_name: str) -> None:
    script = shell(
        SCRIPT, "--show-completion", shell_name, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1"
    )
    assert "fieldgrid" in script
    assert "_FIELDGRID_COMPLETE" in script


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("fieldgrid in", {"inspect", "info"}),
        ("fieldgrid build --match", {"--matcher"}),
        ("fieldgrid build --matcher s", {"sgbm", "sgbm3way"}),
        ("fieldgrid build --transfer ", {"centre", "area"}),
        ("fieldgrid show --figure tr", {"trajectory"}),
    ],
)
def test_completion_in_bash(words: str, expected: set[str]) -> None:
    count = len(words.split(" ")) - 1
    found = shell(
        SCRIPT, _FIELDGRID_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(count)
    )
    assert set(found.split()) == expected


# --- quiet, verbose, colours


def test_quiet_says_nothing_and_does_the_same(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / "a.csv"
    assert fieldgrid("export", two_lanes_map, out, "--cell", "1", "-q").output() == ""
    assert out.exists()
    assert "not observed" in fieldgrid("query", two_lanes_map, "0", "60", "-q").output()
    report = fieldgrid("export", two_lanes_map, tmp_path / "b.csv", "--cell", "1").output()
    assert "b.csv" in report


def test_verbose_says_how_long_on_stderr(fieldgrid: Run, two_lanes_map: Path) -> None:
    result = fieldgrid("sessions", two_lanes_map, "--json", "-v")
    assert result.status == 0
    json.loads(result.out)
    assert f"fieldgrid sessions {two_lanes_map} --json -v" in result.err
    assert re.search(r"[\d.]+ s of processor time, \d+ MB of memory", result.err)
    assert fieldgrid("sessions", two_lanes_map).err == ""


@pytest.mark.parametrize(
    ("term", "no_color", "coloured"),
    [("xterm-256color", "", True), ("xterm-256color", "1", False), ("dumb", "", False)],
)
def test_colours_are_for_terminals_that_want_them(
    term: str,
    no_color: str,
    coloured: bool,
    fieldgrid: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = tmp_path / "empty"
    broken.mkdir()
    monkeypatch.setenv("TERM", term)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", no_color)
    with a_terminal() as (stream, shown), monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", stream)
        assert fieldgrid("inspect", broken).status == 1
    text = b"".join(shown)
    assert b"error" in text
    assert (b"\x1b[31merror\x1b[0m" in text) is coloured
    assert (b"\x1b[3" in text) is coloured
    piped = fieldgrid("inspect", broken)
    assert "error" in piped.out
    assert "\x1b" not in piped.out + piped.err


def test_a_name_cannot_move_the_cursor(fieldgrid: Run, capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table(("a", "b"), [("\x1b[2Jx", "1\n2")], title="t\r")
    output.print_line("\x1b]0;owned\x07 täglich 3 °")
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        "t\\r",
        "a            b",
        "\\x1b[2Jx  1\\n2",
        "\\x1b]0;owned\\x07 täglich 3 °",
    ]
    sentence = fieldgrid("sessions", "a\x1b[2J\nb").sentence()
    assert "a\\x1b[2J\\nb" in sentence


def test_a_path_that_is_no_text(fieldgrid_process: Run, tmp_path: Path) -> None:
    path = os.fsencode(tmp_path) + b"/\xff\xfe.gpkg"
    result = fieldgrid_process("verify", os.fsdecode(path))
    assert "There is no map" in result.sentence()


def test_a_message_has_an_end(fieldgrid: Run, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(f"'{'x' * 100_000}' = 1")
    sentence = fieldgrid(
        "build", TWO_LANES, "-o", tmp_path / "m.gpkg", "--config", config
    ).sentence()
    assert len(sentence) < 2100


# --- info


def test_info_says_versions_extras_and_caches(fieldgrid: Run) -> None:
    found = json.loads(fieldgrid("info", "--json").output())
    assert found["fieldgrid"] == importlib.metadata.version("fieldgrid")
    assert found["libraries"]["numpy"] == importlib.metadata.version("numpy")
    assert set(found["extras"]) >= {"gis", "tables", "foxglove", "isoxml"}
    assert "rasterio" in found["extras"]["gis"]
    assert Path(found["compiled_kernels_in"]).is_dir()
    text = fieldgrid("info").output()
    assert re.search(r"^extra gis +(installed|lacks .+)$", text, re.MULTILINE)


# --- the last line of defence


def test_what_nobody_foresaw_is_one_sentence_with_a_file_to_send(
    fieldgrid: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("float\ndivision")

    monkeypatch.setattr("fieldgrid.maps.file.store.open_map", broken)
    monkeypatch.setattr(defect.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("tests.cli.conftest.DEFECTS_ALLOWED", True)
    result = fieldgrid("verify", "x.gpkg")
    assert result.status == 70
    assert result.out == ""
    assert result.err.count("\n") == 1
    assert "stopped at an error of its own (ZeroDivisionError: float\\ndivision)" in result.err
    (file,) = tmp_path.iterdir()
    assert str(file) in result.err
    text = file.read_text()
    assert "$ fieldgrid verify x.gpkg" in text
    assert "Traceback" in text

    def cut(*_: object, **__: object) -> None:
        raise EOFError("marshal data too short")

    monkeypatch.setattr("fieldgrid.maps.file.store.open_map", cut)
    ended = fieldgrid("verify", "x.gpkg")
    assert (ended.status, "EOFError: marshal data too short" in ended.err) == (70, True)
    monkeypatch.setattr("fieldgrid.maps.file.store.open_map", broken)
    monkeypatch.setattr(defect.tempfile, "tempdir", str(tmp_path / "nowhere"))
    assert "please report it with the command" in fieldgrid("verify", "x.gpkg").err


def test_a_request_to_end_within_compiled_code_is_no_defect(
    fieldgrid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        try:
            raise SystemExit(143)
        except SystemExit as request:
            raise SystemError("returned a result with an exception set") from request

    monkeypatch.setattr("fieldgrid.maps.file.store.open_map", interrupted)
    result = fieldgrid("verify", "x.gpkg")
    assert (result.status, result.err) == (143, "fieldgrid: interrupted.\n")


def test_a_full_memory_is_a_sentence(fieldgrid: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def greedy(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("fieldgrid.maps.file.store.open_map", greedy)
    assert "The memory is full" in fieldgrid("verify", "x.gpkg").sentence()


# --- what it costs to start


def test_listing_commands_imports_no_array_library() -> None:
    loaded = shell(
        sys.executable,
        "-c",
        "import sys; sys.argv = ['fieldgrid', '--help']\nfrom fieldgrid.cli import main\n"
        "main()\nprint(list(sys.modules))",
    )
    assert "'fieldgrid.cli'" in loaded.splitlines()[-1]
    for heavy in ("'numpy'", "'pydantic'", "'rich'", "'numba'", "'importlib.metadata'"):
        assert heavy not in loaded.splitlines()[-1]


@pytest.mark.parametrize("command", COMMANDS)
def test_each_failure_ends_with_a_sentence(command: str, fieldgrid: Run, tmp_path: Path) -> None:
    given = [tmp_path / "nothing-here"]
    given += [tmp_path / "out.gpkg"] if command in ("export", "evaluate", "convert") else []
    given += ["-o", tmp_path / "out.gpkg"] if command in ("build", "merge", "live") else []
    for wrong, status in (("--no-such-option", 2), ("", 1)):
        if command == "info" and not wrong:
            continue  # it cannot fail
        result = fieldgrid(command, *given, *filter(None, [wrong]))
        assert result.status in {status, 2}, result
        assert result.err.splitlines()[-1].startswith("fieldgrid: "), result
        assert result.err.endswith(".\n"), result


def test_the_module_is_the_command() -> None:
    asked = [sys.executable, "-m", "fieldgrid"]
    assert shell(*asked, "--version") == f"fieldgrid {importlib.metadata.version('fieldgrid')}\n"
    ended = subprocess.run([*asked, "sessions", "none.gpkg"], capture_output=True, text=True)
    assert ended.returncode == 1
    assert ended.stderr.startswith("fieldgrid: There is no map none.gpkg")


@pytest.mark.parametrize("command", ["sessions", "verify"])
def test_looking_at_a_map_compiles_nothing(two_lanes_map: Path, command: str) -> None:
    loaded = shell(
        sys.executable,
        "-c",
        f"import sys; sys.argv = ['fieldgrid', {command!r}, {str(two_lanes_map)!r}]\n"
        "from fieldgrid.cli import main\nmain()\nprint([m for m in sys.modules if '.' not in m])",
    )
    assert "two_lanes" in loaded
    for heavy in ("'numba'", "'scipy'", "'cv2'", "'matplotlib'"):
        assert heavy not in loaded.splitlines()[-1]


def test_each_command_has_the_name_of_its_module() -> None:
    for name in COMMANDS:
        assert load(name).name == name


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_a_dozen_options_and_help_all_the_others(name: str, fieldgrid: Run) -> None:
    def shown(*flags: str) -> set[str]:
        text = re.split("Examples?:", fieldgrid(name, *flags).output())[1]
        return set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", text, re.MULTILINE))

    options = {
        max((text for text in one.opts if text.startswith("--")), key=len)
        for one in load(name).params
        if one.param_type_name == "option"
    } | {"--help"}
    usual = COMMANDS[name].usual.split()
    if not usual:
        assert shown("-h") == options - {"--help-all"}
        assert len(options) <= 13
        return
    assert shown("-h") == {*usual, "--help", "--help-all"} & options
    assert len(usual) <= 12
    assert set(usual) < options
    assert shown("--help-all") == options

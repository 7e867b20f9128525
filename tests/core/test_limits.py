"""Limits of what an input may unfold to."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from fieldgrid.core import LimitError, bounded_lines, input_limits as module
from fieldgrid.core.input_limits import limited

ENDS = ["", "\n", "\r", "\r\n", "a", "a\nb", "a\n\nb\n", "a\rb\r\nc\n\r", "ab\x0bc\u2028d\r\r\n\n"]


@pytest.mark.parametrize("text", [*ENDS, "xy".join(ENDS)])
@pytest.mark.parametrize("newline", ["", None])
@pytest.mark.parametrize("at_once", [1, 2, 3, 1000])
def test_lines_are_those_of_the_file(
    text: str, newline: str | None, at_once: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_READ_CHARACTERS", at_once)
    path = tmp_path / "text"
    path.write_text(text, encoding="utf-8", newline="")
    with path.open(encoding="utf-8", newline=newline) as file:
        expected = list(file)
    with path.open(encoding="utf-8", newline=newline) as file:
        assert list(bounded_lines(file, path)) == expected


def test_lines_without_a_character() -> None:
    assert list(bounded_lines(io.StringIO("a\0b\n\0\0"), "log", without="\0")) == ["ab\n"]


@pytest.mark.parametrize(
    "before", ["", "a\n", "a" * 1000 + "\n", "a" * 1023 + "\n" + "b" * 500 + "\r"]
)
@pytest.mark.parametrize("at_once", [1, 700, 1 << 16])
@pytest.mark.parametrize(("length", "too_long"), [(1023, False), (1024, True), (5000, True)])
def test_a_line_may_be_so_long(
    before: str, at_once: int, length: int, too_long: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its end, of 1024 characters."""
    monkeypatch.setattr(module, "_READ_CHARACTERS", at_once)
    text = io.StringIO(before + length * "x" + "\nc\n", newline="")
    with limited(line_kib=1):
        if too_long:
            with pytest.raises(LimitError, match="LINE_KIB=4"):
                list(bounded_lines(text, "log"))
        else:
            assert "".join(bounded_lines(text, "log")).endswith("x\nc\n")


def test_a_line_that_is_too_long_is_never_in_memory() -> None:
    class Endless(io.StringIO):
        taken = 0

        def read(self, size: int | None = -1, /) -> str:
            self.taken += size or 0
            return "x" * (size or 0)

        readline = read

    text = Endless()
    with limited(line_kib=1), pytest.raises(LimitError, match="is no table or log"):
        next(bounded_lines(text, "log"))
    assert text.taken < 4096

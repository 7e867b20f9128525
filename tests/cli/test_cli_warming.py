"""The first run on a machine says that it compiles."""

from collections.abc import Callable

import pytest

from fieldgrid.cli import output, warming


@pytest.mark.parametrize("on_terminal", [True, False])
def test_compiling_is_said_on_a_terminal(
    on_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[Callable[[], None]] = []
    monkeypatch.setattr(warming, "when_compiling", said.append)
    monkeypatch.setattr(output, "shows_progress", lambda: on_terminal)
    warming.tell_of_compiling()
    (say,) = said
    say()
    assert ("compiling the inner loops" in capsys.readouterr().err) == on_terminal

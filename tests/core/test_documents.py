"""TOML and JSON of others: what they say, and what they may cost."""

from __future__ import annotations

import tracemalloc
from decimal import Decimal

import pytest

from fieldgrid.core import parse_json, parse_toml


def test_what_a_document_says() -> None:
    assert parse_toml("a.b.c = 1.50 # a.b\n[d.e]\nf = 'x.y'", Decimal) == {
        "a": {"b": {"c": Decimal("1.50")}},
        "d": {"e": {"f": "x.y"}},
    }
    assert parse_json(b'{"a": [1.5]}', Decimal) == {"a": [Decimal("1.5")]}


DOTS = ".".join(["a"] * 40_000)


@pytest.mark.parametrize(
    "text",
    [
        f"{DOTS} = 1",
        f"[{DOTS}]",
        f"x = {{ {DOTS} = 1 }}",
        f"# '''\n{DOTS} = 1\n# '''",
        f'x = \'# """\'\n{DOTS} = 1',
        " . ".join(['"a"'] * 40_000) + " = 1",
        f"x = {'[' * 50_000}",
    ],
    ids=["key", "table", "inline", "comment", "string", "quoted", "arrays"],
)
def test_a_document_that_is_too_deep_costs_nothing(text: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_toml(text)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_many_dots_in_a_text_are_none_in_a_key() -> None:
    dots = "a." * 100
    text = f'x = "{dots}" # {dots}\ny = \'{dots}\'\nz = """{dots}\n\\"{dots}"""\n'
    assert parse_toml(text) == {"x": dots, "y": dots, "z": f'{dots}\n"{dots}'}


def test_json_that_is_too_deep() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 1_000_000)

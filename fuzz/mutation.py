"""Mutants of good input, each the same for the same seed and number."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

_MOST_BYTES = 8192
_TOKENS = [
    b"",
    b",",
    b"*",
    b"$",
    b"#",
    b";",
    b"\r\n",
    b"\n",
    b"\x00",
    b"\xff" * 4,
    b"\xb5\x62",
    b"<",
    b">",
    b"&",
    b'"',
    b"0",
    b"-1",
    b"1e999",
    b"nan",
    b"inf",
    b"9" * 40,
    b"-" + b"9" * 20,
    b"0.",
    b".",
    b"1_0",
    b"240000",
    b"235960",
    b"99999999",
    "٣".encode(),
]


def mutant(seeds: Sequence[bytes], mend: Callable[[bytes], bytes], seed: int, number: int) -> bytes:
    """Mutant `number` of a run: a few changes to a seed, in three of four cases mended."""
    source = random.Random(f"{seed}:{number}")
    data = bytearray(source.choice(seeds))
    for _ in range(source.choice((1, 1, 2, 3, 5, 9))):
        source.choice(_CHANGES)(data, source, seeds)
    changed = bytes(data[:_MOST_BYTES])
    return mend(changed) if source.random() < 0.75 else changed


def _span(data: bytearray, source: random.Random, most: int = 64) -> slice:
    start = source.randint(0, len(data))
    return slice(start, start + source.randint(0, most))


def _flip(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    if data:
        data[source.randrange(len(data))] ^= 1 << source.randrange(8)


def _replace_token(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    data[_span(data, source, 12)] = source.choice(_TOKENS)


def _replace_field(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    commas = [k for k, byte in enumerate(data) if byte in b",;"]
    if len(commas) > 1:
        k = source.randrange(len(commas) - 1)
        data[commas[k] + 1 : commas[k + 1]] = source.choice(_TOKENS)


def _replace_digit(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    digits = [k for k, byte in enumerate(data) if 48 <= byte <= 57]
    for _ in range(min(len(digits), source.randint(1, 4))):
        data[source.choice(digits)] = source.choice(b"0123456789-.")


def _delete(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    del data[_span(data, source)]


def _repeat(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    span = _span(data, source, 256)
    data[span.start : span.start] = data[span] * source.randint(1, 5)


def _noise(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    data[_span(data, source, 8)] = source.randbytes(source.randint(1, 32))


def _splice(data: bytearray, source: random.Random, seeds: Sequence[bytes]) -> None:
    other = source.choice(seeds)
    start = source.randint(0, len(other))
    data[_span(data, source)] = other[start : start + source.randint(0, 400)]


def _cut(data: bytearray, source: random.Random, _seeds: Sequence[bytes]) -> None:
    del data[source.randint(0, len(data)) :]


_CHANGES = [
    _flip,
    _replace_token,
    _replace_field,
    _replace_field,
    _replace_digit,
    _delete,
    _repeat,
    _noise,
    _splice,
    _cut,
]

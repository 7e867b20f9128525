"""The fields of sentences, and what they are checked by."""

from __future__ import annotations

from functools import reduce
from operator import xor

from hypothesis import given, strategies as st

from fieldgrid.poses.gnss.fields import checksums


@given(st.lists(st.binary(max_size=300)))
def test_checksums_of_many_texts(texts: list[bytes]) -> None:
    assert checksums(texts) == [reduce(xor, text, 0) for text in texts]

"""The built page is that of its sources, and the licences of what it contains are with it."""

from __future__ import annotations

import hashlib
import re

import fieldgrid.view
from fieldgrid.view.page import TYPES, read_file
from tests.conftest import ROOT

PAGE = ROOT / "page"


def test_the_built_page_is_that_of_its_sources() -> None:
    """As `page/build.mjs` counts them; without npm."""
    names = ["build.mjs", "package.json", "package-lock.json", "tsconfig.json"]
    names += [path.relative_to(PAGE).as_posix() for path in (PAGE / "src").rglob("*.*")]
    found = hashlib.sha256()
    for name in sorted(names):
        found.update(f"{name}\n".encode() + (PAGE / name).read_bytes() + b"\n")
    first = read_file("viewer.js").decode().splitlines()[0]
    assert f"built from {found.hexdigest()};" in first, "make page"


def test_the_page_names_no_other_host() -> None:
    for name in ("index.html", "viewer.css"):
        text = read_file(name).decode()
        assert not re.search(r"https?://", text.replace("http://www.w3.org/2000/svg", ""))
    html = read_file("index.html").decode()
    assert not re.search(r"<script(?![^>]*\bsrc=)|\bon\w+=|<style|\bstyle=", html)


def test_every_package_has_its_licence() -> None:
    text = read_file("licences.txt").decode()
    assert re.search(r"^ol .*BSD-2-Clause", text, re.MULTILINE)
    assert re.search(r"^uplot .*MIT", text, re.MULTILINE)
    kinds = re.findall(r"^\S+ [\d.]+ \((.+)\)$", text, re.MULTILINE)
    assert set(kinds) <= {"MIT", "ISC", "BSD-2-Clause", "BSD-3-Clause"}


def test_what_is_served_is_what_was_built() -> None:
    folder = next(iter(fieldgrid.view.__path__))
    assert {path.name for path in (ROOT / folder / "static").iterdir()} == set(TYPES)

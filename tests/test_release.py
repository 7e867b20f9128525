"""What belongs to a release agrees with the package: its version, its Pythons, its files."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import fieldgrid

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def pythons() -> list[str]:
    """The versions that the package says it runs on."""
    named = (re.search(r":: (3\.\d+)$", line) for line in PROJECT["classifiers"])
    return [found[1] for found in named if found]


def test_the_version_is_said_once_in_the_code() -> None:
    source = "".join(path.read_text() for path in (ROOT / "src").rglob("*.py"))
    assert f'"{PROJECT["version"]}"' not in source
    assert fieldgrid.__version__ == PROJECT["version"]


def test_the_citation_has_the_version_and_the_licence() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["references"][0]["year"] == 2012


def test_the_changelog_begins_with_what_is_not_released() -> None:
    assert re.search(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)[1] in (  # type: ignore[index]
        "Unreleased",
        PROJECT["version"],
    )


def test_every_python_is_checked_by_every_change() -> None:
    assert pythons()[0] == PROJECT["requires-python"].removeprefix(">=")
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    assert jobs["check"]["strategy"]["matrix"]["python"] == pythons()
    assert {"run": ".ci/run"} in jobs["check"]["steps"]
    assert any("make dist" in step.get("run", "") for step in jobs["distribution"]["steps"])


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_may_write_nothing(path: Path) -> None:
    assert yaml.safe_load(path.read_text())["permissions"] == {"contents": "read"}


def test_the_container_is_made_of_what_is_there_and_of_the_lock() -> None:
    text = (ROOT / "Dockerfile").read_text()
    base = re.search(r"^FROM python:(3\.\d+)-slim$", text, re.M)
    assert base is not None
    assert base[1] in pythons()
    for line in re.findall(r"^COPY (.+) \S+$", text, re.M):
        assert all((ROOT / name).exists() for name in line.split())
    assert "--require-hashes -r requirements.lock" in text
    assert not re.search(r"curl|wget|apt-get|https?://", text)


@pytest.mark.parametrize("name", ["SECURITY.md", "CONTRIBUTING.md", "LICENSE", "docs/release.md"])
def test_what_a_stranger_looks_for_is_there(name: str) -> None:
    assert len((ROOT / name).read_text()) > 500


def test_ways_to_install_are_named() -> None:
    text = (ROOT / "README.md").read_text()
    for way in ("pip install .", "pipx install", "uv tool install", "docker build"):
        assert way in text


def test_the_long_run_tries_all_properties_with_its_profile() -> None:
    """Also those that are marked `long`."""
    recipe = re.search(r"^long:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe is not None
    (run,) = recipe[1].splitlines()
    assert '-m "long or hypothesis"' in run
    assert "--hypothesis-profile=long" in run

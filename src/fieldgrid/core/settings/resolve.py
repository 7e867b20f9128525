"""From a settings file and flags to checked settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fieldgrid.core.documents import MAX_BYTES, parse_toml
from fieldgrid.core.errors import ConfigError
from fieldgrid.core.input_limits import check_local_grid, file_bytes
from fieldgrid.core.settings.declare import SettingsProblem, declared, first_problem
from fieldgrid.core.settings.models import BuildSettings

Overrides = Mapping[str, Mapping[str, Any]]
"""What flags say: {table: {key: value}}; a value of None was not given."""


def resolve(path: str | Path | None, overrides: Overrides) -> BuildSettings:
    """Settings from a TOML file (or none) with `overrides` on top.

    Unknown keys and impossible values are a ConfigError that names them.
    """
    path = None if path is None else Path(path)
    tables = {} if path is None else _read(path)
    flagged = set()
    for table, values in overrides.items():
        given = {key: value for key, value in values.items() if value is not None}
        base = tables.get(table, {})
        if given and isinstance(base, dict):  # else the check below says that it is no table
            tables[table] = {**base, **given}
            flagged |= {(table, key) for key in given}
    try:
        settings = BuildSettings.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(_sentence(first_problem(error), path, flagged)) from error
    check_local_grid(settings.grid.width_m, settings.grid.length_m, settings.grid.cell_m)
    return settings


def _read(path: Path) -> dict[str, Any]:
    try:
        file_bytes(path)
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(
            f"The settings file {path} cannot be read ({error.strerror}); check its path."
        ) from error
    if len(content) > MAX_BYTES:
        raise ConfigError(
            f"The settings file {path} has more than {MAX_BYTES} bytes; give a TOML file of "
            "settings."
        )
    try:
        return parse_toml(content.decode())
    except ValueError as error:
        raise ConfigError(f"The settings file {path} is not TOML: {error}.") from error


def _sentence(problem: SettingsProblem, path: Path | None, flagged: set[tuple[str, str]]) -> str:
    flags = {one.path: one.flag for one in declared(BuildSettings)}
    flag = flags.get(problem.place) if problem.place in flagged else None
    where = f" in {path}" if path is not None else ""
    if flag is not None:
        where = f" ({flag.name.partition('/')[0]})"
    if problem.unknown:
        return f"There is no setting {problem.name}{where}; `docs/settings.md` lists all."
    return f"Setting {problem.setting}{where} is not possible: {problem.why}."

"""The settings of a build: defaults, over them a TOML file, over that what was given by hand."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fieldgrid.errors import ConfigError
from fieldgrid.grids import GridSpec
from fieldgrid.localgrid import DensitySettings
from fieldgrid.pose import PoseSettings
from fieldgrid.stereo import StereoSettings
from fieldgrid.transfer import Transfer


class GridSettings(BaseModel):
    """The vehicle-fixed local grid: metres across, metres ahead, metres a cell (L_L)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    width_m: float = 10.0
    length_m: float = 15.0
    cell_m: float = 0.05

    def spec(self) -> GridSpec:
        """The validated geometry."""
        return GridSpec(self.width_m, self.length_m, self.cell_m)


class MapSettings(BaseModel):
    """The universal grid of a new map; `cell_m` (L_U) is that of the local grid if not given,
    `transfer` is centre. An existing map keeps its own.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    cell_m: float | None = Field(default=None, gt=0.0)
    transfer: Transfer | None = None


class BuildSettings(BaseModel):
    """Everything that decides what a map says; the resolved values go into it with a session."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    grid: GridSettings = GridSettings()
    stereo: StereoSettings = StereoSettings()
    density: DensitySettings = DensitySettings()
    pose: PoseSettings = PoseSettings()
    map: MapSettings = MapSettings()

    @property
    def universal_cell_m(self) -> float:
        """L_U in metres."""
        return self.grid.cell_m if self.map.cell_m is None else self.map.cell_m


def resolve(path: Path | None, overrides: dict[str, dict[str, Any]]) -> BuildSettings:
    """Settings from a TOML file (or none) with `overrides`, {table: {key: value}}, on top.

    Overrides of None were not given. Unknown keys and impossible values are a ConfigError
    that names them.
    """
    tables: dict[str, Any] = _read_toml(path) if path is not None else {}
    for table, values in overrides.items():
        given = {key: value for key, value in values.items() if value is not None}
        if given:
            base = tables.get(table, {})
            tables[table] = {**base, **given} if isinstance(base, dict) else base
    try:
        settings = BuildSettings.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(_sentence(error, path)) from error
    settings.grid.spec()
    return settings


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ConfigError(
            f"The settings file {path} cannot be read ({error.strerror}); check its path."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"The settings file {path} is not TOML: {error}.") from error


def _sentence(error: ValidationError, path: Path | None) -> str:
    first = error.errors()[0]
    name = ".".join(str(part) for part in first["loc"]) or "settings"
    where = f" in {path}" if path is not None else ""
    if first["type"] == "extra_forbidden":
        return f"There is no setting {name}{where}; `docs/settings.md` lists all."
    message = str(first["msg"]).removeprefix("Value error, ")
    return (
        f"Setting {name} = {first['input']!r}{where} cannot be: {message[0].lower()}{message[1:]}."
    )

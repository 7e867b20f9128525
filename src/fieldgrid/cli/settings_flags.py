"""The flags that the settings declare, as options of a command."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from functools import cached_property
from typing import Any, get_args, get_origin

import typer

from fieldgrid.cli.groups import option
from fieldgrid.cli.options import numbers
from fieldgrid.core import BuildSettings, DeclaredSetting, Flag, Overrides, declared

_PANELS = {
    "grid": "Local grid and map",
    "map": "Local grid and map",
    "stereo": "Stereo and density",
    "density": "Stereo and density",
    "pose": "Poses",
    "checks": "Checks",
}


class SettingsFlags:
    """The flags of all settings, or of those at some places (a table, or a setting in one); the
    command gets what was given as {table: {key: value}}."""

    def __init__(self, *places: str) -> None:
        self._places = places

    @cached_property
    def _flags(self) -> dict[Flag, list[DeclaredSetting]]:
        return by_flag(
            one
            for one in declared(BuildSettings)
            if not self._places or {one.path[0], ".".join(one.path)} & set(self._places)
        )

    def names(self) -> set[str]:
        """The names of the options as parameters."""
        return {flag.parameter for flag in self._flags}

    def parameters(self) -> Iterable[inspect.Parameter]:
        """An option a flag."""
        for flag, settings in self._flags.items():
            yield flag_option(flag, settings, _PANELS[settings[0].path[0]])

    def value(self, given: Mapping[str, Any]) -> Overrides:
        """The tables of what was given."""
        tables: dict[str, dict[str, Any]] = {}
        for one, value in flag_values(self._flags, given):
            tables.setdefault(one.table, {})[one.path[-1]] = value
        return tables


def by_flag(settings: Iterable[DeclaredSetting]) -> dict[Flag, list[DeclaredSetting]]:
    """The settings that have a flag, by their flags."""
    found: dict[Flag, list[DeclaredSetting]] = {}
    for one in settings:
        if one.flag is not None:
            found.setdefault(one.flag, []).append(one)
    return found


def flag_option(
    flag: Flag, settings: Sequence[DeclaredSetting], panel: str, where: str = ""
) -> inspect.Parameter:
    """The option that a flag is; `where` it counts stands behind its help."""
    annotation = settings[0].info.annotation
    kinds = [kind for kind in (annotation, *get_args(annotation)) if isinstance(kind, type)]
    words = [str(one) for kind in kinds if issubclass(kind, Enum) for one in kind]
    words += [
        one
        for kind in (annotation, *get_args(annotation))
        for one in get_args(kind)
        if isinstance(one, str)
    ]
    # Numbers are checked here, everything else with the settings.
    number = next((kind for kind in (int, float) if kind in kinds and not flag.separator), str)
    says = flag.says or settings[0].info.description or ""
    info = typer.Option(
        flag.name,
        metavar=flag.metavar or None,
        help=f"{says[0].upper()}{says[1:]}{where} [default: {_usual(flag, settings)}].",
        rich_help_panel=panel,
        autocompletion=(lambda: list(dict.fromkeys(words))) if words else None,
        show_default=False,
    )
    kind = number if flag.metavar else bool
    several = get_origin(annotation) is frozenset
    return option(flag.parameter, (list[str] if several else kind) | None, None, info)


def flag_values(
    flags: Mapping[Flag, list[DeclaredSetting]], given: Mapping[str, Any]
) -> Iterable[tuple[DeclaredSetting, Any]]:
    """The settings that were given by their flags; a usage error for a text that has not a number
    for each setting of its flag."""
    for flag, settings in flags.items():
        value = given[flag.parameter]
        if value is None:
            continue
        values = [value]
        if isinstance(value, list):
            values = [[word for text in value for word in text.split(",")]]
        if flag.separator:
            form, usual = flag.metavar, _usual(flag, settings)
            values = list(numbers(flag.name, value, flag.separator, form, usual))
        yield from zip(settings, values, strict=True)


def _usual(flag: Flag, settings: Sequence[DeclaredSetting]) -> str:
    """The default as the flag would say it."""
    if not flag.metavar:
        return "on" if settings[0].info.default else "off"
    return flag.separator.join(one.usual for one in settings)

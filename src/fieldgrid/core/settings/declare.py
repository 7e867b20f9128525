"""How a setting is declared: once, with its default, range, unit, flag and meaning.

The flags of the commands, the checks of a settings file and `docs/settings.md` all follow from
the declarations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo


class Flag(NamedTuple):
    """A flag that sets one number or word, or with a `separator` the numbers of all settings that
    it is declared for, of which it `says` what they are together; without a `metavar`, a switch."""

    name: str
    metavar: str
    separator: str = ""
    says: str = ""

    @property
    def parameter(self) -> str:
        """Its name as an identifier."""
        return self.name.partition("/")[0].strip("-").replace("-", "_")


class Settings(BaseModel):
    """A table of settings: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def setting(
    default: Any, says: str, *, flag: Flag | None = None, usual: str = "", **limits: Any
) -> Any:
    """A setting: `says` is its meaning in a few words, `usual` what None stands for, and `limits`
    are those of pydantic (`gt`, `ge`, `lt`, `le`, `min_length`)."""
    return Field(
        default=default,
        description=says,
        json_schema_extra={"flag": flag and list(flag), "usual": usual},
        **limits,
    )


class SettingsProblem(NamedTuple):
    """Why values are no settings: the first place, what stands there, and why it cannot."""

    place: tuple[str, ...]
    value: Any
    unknown: bool
    why: str

    @property
    def name(self) -> str:
        """The place as a settings file has it."""
        return ".".join(self.place) or "settings"

    @property
    def setting(self) -> str:
        """What was set, as a settings file has it; settings that do not go together, all of
        them."""
        return ", ".join(_assigned(self.place, self.value)) or f"{self.name} = {self.value!r}"


def _assigned(place: tuple[str, ...], value: object) -> Iterator[str]:
    if not isinstance(value, Mapping):
        yield f"{'.'.join(place)} = {value!r}"
        return
    for name, inner in value.items():
        yield from _assigned((*place, str(name)), inner)


def first_problem(error: ValidationError) -> SettingsProblem:
    """The first of what is wrong, in words that stand in the middle of a sentence."""
    first = error.errors()[0]
    why = str(first["msg"]).removeprefix("Value error, ")
    unknown = first["type"] == "extra_forbidden"
    return SettingsProblem(
        tuple(map(str, first["loc"])), first["input"], unknown, why[0].lower() + why[1:]
    )


class DeclaredSetting(NamedTuple):
    """A setting with its place, such as ("pose", "gnss", "max_hdop")."""

    path: tuple[str, ...]
    info: FieldInfo

    @property
    def table(self) -> str:
        """The table of a settings file that it is in."""
        return ".".join(self.path[:-1])

    @property
    def flag(self) -> Flag | None:
        """The flag that sets it, if there is one."""
        flag = self._extra("flag")
        return None if flag is None else Flag(*flag)

    @property
    def usual(self) -> str:
        """The default in words."""
        return self._extra("usual") or described(self.info.default)

    def _extra(self, key: str) -> Any:
        extra = self.info.json_schema_extra
        return extra.get(key) if isinstance(extra, dict) else None

    @property
    def limits(self) -> str:
        """The range in words: "3 to 51", "above 0, up to 90"; nothing where there is none."""
        words = []
        for limit in self.info.metadata:
            match limit:
                case Ge(ge=low):
                    words.append(f"from {described(low)}")
                case Gt(gt=low):
                    words.append(f"above {described(low)}")
                case Le(le=high):
                    words.append(f"up to {described(high)}")
                case Lt(lt=high):
                    words.append(f"below {described(high)}")
        return ", ".join(words)


def declared(model: type[BaseModel], path: tuple[str, ...] = ()) -> Iterator[DeclaredSetting]:
    """All settings of a model and of the tables in it, in the order of their declaration."""
    for name, info in model.model_fields.items():
        kind = info.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from declared(kind, (*path, name))
        else:
            yield DeclaredSetting((*path, name), info)


def described(value: object) -> str:
    """A default as it is written in help and documents."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (frozenset, tuple)):
        return ", ".join(map(str, sorted(value)))
    if isinstance(value, float):
        return f"{value:g}"
    return "" if value is None else str(value)

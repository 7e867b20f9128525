"""Options that belong together: declared once, taken by a command as one parameter.

A command says `drive: Annotated[DriveOptions, FieldsOf(DriveOptions)]`; on the command line each
field is an option of its own, and the command gets the tuple of them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Protocol, get_type_hints, runtime_checkable


@runtime_checkable
class OptionGroup(Protocol):
    """Stands in an annotation for several options."""

    def parameters(self) -> Iterable[inspect.Parameter]:
        """The options, each annotated with a `typer.Option` and with a default."""
        ...

    def value(self, given: Mapping[str, Any]) -> Any:
        """What the command gets, by the values of the options."""
        ...


class FieldsOf:
    """The fields of a NamedTuple as options; the command gets the tuple. `others` are options that
    stand for those of the fields of these names."""

    def __init__(self, kind: type[Any], **others: Any) -> None:
        self._kind, self._others = kind, others

    def parameters(self) -> Iterable[inspect.Parameter]:
        """An option a field."""
        hints = get_type_hints(self._kind, include_extras=True)
        hints |= {name: Annotated[hints[name].__origin__, o] for name, o in self._others.items()}
        return [
            option(name, hints[name], self._kind._field_defaults[name])
            for name in self._kind._fields
        ]

    def value(self, given: Mapping[str, Any]) -> Any:
        """The tuple."""
        return self._kind(**given)


def option(name: str, annotation: Any, default: Any, info: Any = None) -> inspect.Parameter:
    """A parameter that is an option; `info` is its `typer.Option` if the annotation has none."""
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=annotation if info is None else Annotated[annotation, info],
    )


def expanded(function: Callable[..., None], *always: OptionGroup) -> Callable[..., None]:
    """The function with options in place of its groups, and those of groups that act by
    themselves."""
    hints = get_type_hints(function, include_extras=True)
    parameters: list[inspect.Parameter] = []
    groups: list[tuple[str, OptionGroup, list[str]]] = []

    def take(name: str, group: OptionGroup) -> None:
        options = list(group.parameters())
        parameters.extend(options)
        groups.append((name, group, [one.name for one in options]))

    for name, parameter in inspect.signature(function).parameters.items():
        marks = getattr(hints[name], "__metadata__", ())
        group = next((mark for mark in marks if isinstance(mark, OptionGroup)), None)
        if group is not None:
            take(name, group)
        else:
            kind = inspect.Parameter.KEYWORD_ONLY
            parameters.append(parameter.replace(annotation=hints[name], kind=kind))
    for group in always:
        take("", group)

    def call(**given: Any) -> None:
        for name, group, names in groups:
            value = group.value({one: given.pop(one) for one in names})
            if name:
                given[name] = value
        function(**given)

    call.__doc__ = function.__doc__
    call.__name__ = function.__name__
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    return call

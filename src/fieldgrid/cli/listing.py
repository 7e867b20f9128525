"""The commands, each imported when it is asked for, and how their help looks."""

from __future__ import annotations

import difflib
import importlib
import inspect
import signal
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from fieldgrid.cli.groups import expanded, option
from fieldgrid.cli.output import VERBOSITY
from fieldgrid.core import quoted

WIDTH = 100
"""Help is no wider, however wide the terminal."""


class Entry(NamedTuple):
    """A command in the list of `fieldgrid --help`. Its module is `fieldgrid.cli.commands.NAME`.

    `usual` are the options that its help shows; `--help-all` shows the others too. Without any it
    shows all.
    """

    group: str
    says: str
    usual: str = ""


SHOWS_ALL = "fieldgrid.shows_all"

_DRIVES, _MAPS, _USE, _HEALTH = "Drives", "Maps", "Using a map", "Health and help"

COMMANDS: dict[str, Entry] = {
    "inspect": Entry(
        _DRIVES,
        "Show what is in a recording and what would go wrong.",
        "--gnss --topic --mounting --time-offset --from --until --figure --json",
    ),
    "track": Entry(
        _DRIVES,
        "Write position, heading and gear over time, with sigmas.",
        "--gnss --out --figure --columns --from --until --heading --accuracy "
        "--quality --poses --datum --json",
    ),
    "mount": Entry(
        _DRIVES,
        "Estimate the mounting of the camera from the drive alone.",
        "--gnss --topic --mounting --write --antenna --figure --jobs --json",
    ),
    "convert": Entry(_DRIVES, "Write a recording as one standard MCAP file."),
    "build": Entry(
        _MAPS,
        "Make a map from recordings, or append them to one.",
        "--out --append --overwrite --name --gnss --mounting --poses --heading "
        "--grid --cell --align --resume",
    ),
    "live": Entry(
        _MAPS,
        "Map during the drive: local grids and poses now, the map at the end.",
        "--out --images --camera --mcap --ros --gnss --replay --finish --view "
        "--foxglove --cell --append",
    ),
    "sessions": Entry(_MAPS, "List the drives of a map; remove, restore or rename one."),
    "mark": Entry(
        _MAPS,
        "Draw keep-outs, corrections and places on a map; undo them.",
        "--add --polygon --point --kind --name --note --remove --restore --out --json",
    ),
    "align": Entry(
        _MAPS,
        "Align the drives of a map by what they saw.",
        "--session --to --reach --dry-run --undo --rows --figure --json",
    ),
    "farm": Entry(_MAPS, "List a folder of maps; write a STAC catalogue of them."),
    "merge": Entry(_MAPS, "Make one map of several, or a copy of one."),
    "show": Entry(
        _USE,
        "Draw a map.",
        "--out --figure --layer --cell --bounds --at --session --route --rows --overwrite --json",
    ),
    "view": Entry(_USE, "Look at maps in the browser."),
    "serve-ros": Entry(_USE, "Publish a map and its keep-outs to Nav2 and RViz."),
    "rows": Entry(
        _USE,
        "Find rows of plants, lanes, gaps and headlands.",
        "--out --crop --spacing --obstacle-above --headland --bounds --at --keep "
        "--agopengps --truth --overwrite --json",
    ),
    "route": Entry(
        _USE,
        "Plan a route that a vehicle can drive.",
        "--from --to --cover --survey --crop --vehicle --out --swaths "
        "--allow-unknown --at --overwrite --json",
    ),
    "export": Entry(
        _USE,
        "Write a map for another program.",
        "--format --layer --cell --bounds --at --epsg --obstacle-above --features "
        "--guidance --overwrite --jobs --json",
    ),
    "query": Entry(_USE, "List the frames behind a cell's value."),
    "diff": Entry(
        _USE,
        "Compare a map before and after a date.",
        "--from --to --out --min-area --min-confidence --cell --bounds --overwrite --json",
    ),
    "evaluate": Entry(_USE, "Compare a map with surveyed or simulated truth."),
    "verify": Entry(_HEALTH, "Check that a map is complete and undamaged."),
    "repair": Entry(_HEALTH, "Rebuild a map's derived tables from its frames."),
    "info": Entry(_HEALTH, "Print versions, extras and caches, for bug reports."),
}


class Command(TyperCommand):
    """A command whose help lists its options by their panels."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """`[OPTIONS]`, then the arguments as they are called in the text."""
        arguments = [one for one in self.get_params(ctx) if one.param_type_name == "argument"]
        return [
            str(self.options_metavar),
            *(str(one.metavar) if one.required else f"[{one.metavar}]" for one in arguments),
        ]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """The arguments that need a word, then the options, a panel after the other."""
        panels: dict[str, list[tuple[str, str]]] = {}
        usual = COMMANDS[str(self.name)].usual.split()
        hides = usual and not ctx.meta.get(SHOWS_ALL)
        shown = {*usual, "--help", "--help-all"}
        for one in self.get_params(ctx):
            if hides and one.param_type_name == "option" and not shown.intersection(one.opts):
                continue
            if one.param_type_name == "argument":
                if help_ := getattr(one, "help", None):
                    panels.setdefault("Arguments", []).append((str(one.metavar), help_))
            elif (record := one.get_help_record(ctx)) is not None:
                panel = getattr(one, "rich_help_panel", None) or "Options"
                panels.setdefault(panel, []).append(record)
        for title, rows in sorted(panels.items(), key=lambda panel: panel[0] == "Options"):
            with formatter.section(title):
                formatter.write_dl(rows)


class _HelpAll:
    """`--help-all`, which is `hidden` where the help shows all options itself."""

    def __init__(self, hidden: bool) -> None:
        self._hidden = hidden

    def parameters(self) -> Iterable[inspect.Parameter]:
        says = "Show all options and exit."
        info = typer.Option(
            "--help-all", is_eager=True, callback=self._show, help=says, hidden=self._hidden
        )
        return [option("help_all", bool, False, info)]

    def value(self, given: Mapping[str, Any]) -> None:
        """Nothing: it acts when it is read."""

    def _show(self, ctx: typer.Context, wanted: bool) -> None:
        if wanted:
            ctx.meta[SHOWS_ALL] = True
            typer.echo(ctx.get_help())
            raise typer.Exit


class Commands(TyperGroup):
    """All commands; only the one that runs is imported."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names, in the order of a user's work."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, None when there is none."""
        if cmd_name in COMMANDS and cmd_name not in self.commands:
            self.commands[cmd_name] = load(cmd_name)
        return self.commands.get(cmd_name)

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Typer answers the end of what is read with "Aborted!" and status 1, as
        if a user had ended a question; here nothing asks, so that it is an error as any other.
        Ctrl-C it answers without a word; here it is a request to end, as SIGTERM is."""
        try:
            return super().invoke(ctx)
        except EOFError as error:
            raise RuntimeError(f"EOFError: {error}") from error
        except KeyboardInterrupt as interrupt:
            request = SystemExit(128 + signal.SIGINT)
            for note in getattr(interrupt, "__notes__", []):
                request.add_note(note)
            raise request from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """A name that is none is answered with those that are like it."""
        if args[0] not in COMMANDS and not args[0].startswith("-"):
            near = difflib.get_close_matches(args[0], COMMANDS)
            hint = f" Did you mean {', '.join(map(repr, near))}?" if near else ""
            ctx.fail(f"No such command {quoted(args[0])}.{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """A line a command, by what they are for."""
        for group in dict.fromkeys(entry.group for entry in COMMANDS.values()):
            with formatter.section(group):
                formatter.write_dl(
                    [(name, entry.says) for name, entry in COMMANDS.items() if entry.group == group]
                )


def load(name: str) -> Any:
    """Import a command's module and make a command of its function."""
    module = importlib.import_module(f"fieldgrid.cli.commands.{name.replace('-', '_')}")
    one = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    settings = {**CONTEXT, **getattr(module, "CONTEXT", {})}
    help_text = getattr(module, "help_text", str)
    one.command(
        name, cls=Command, context_settings=settings, help=help_text(inspect.getdoc(module.command))
    )(expanded(module.command, VERBOSITY, _HelpAll(not COMMANDS[name].usual)))
    return typer.main.get_command(one)


CONTEXT: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": WIDTH}

"""`fieldgrid sessions`: what is in a map, and what should not be."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.maps import MapFile, SessionInfo, Transform


def command(
    map_: options.MapArgument,
    remove: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Remove a session from the map; its evidence stays in the file."
        ),
    ] = None,
    restore: Annotated[
        str | None, typer.Option(metavar="NAME", help="Put a removed session back.")
    ] = None,
    shift: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="NAME E,N[,TURN]",
            help="Shift a session by metres east and north and turn it by degrees clockwise. "
            "Replaces an earlier shift; 0,0 removes it.",
        ),
    ] = None,
    rename: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="NAME NEW", help="Give a session another name."),
    ] = None,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    as_json: options.AsJson = False,
) -> None:
    """List the drives of a map; remove, restore, shift or rename one.

    Examples:

        fieldgrid sessions vineyard.gpkg

        fieldgrid sessions vineyard.gpkg --remove june-17

        fieldgrid sessions vineyard.gpkg --rename june-17 june-17-second-pass

        fieldgrid sessions vineyard.gpkg --shift june-17 0.12,-0.31,0.2
    """
    given = {"--remove": remove, "--restore": restore, "--shift": shift, "--rename": rename}
    changes = [flag for flag, value in given.items() if value is not None]
    if len(changes) > 1:
        raise typer.BadParameter(f"give it without {changes[1]}", param_hint=changes[0])
    move = None if shift is None else (shift[0], _parsed(shift[1]))
    from fieldgrid.maps import open_map

    patience = progress.patience(map_, wait_s)
    with open_map(map_, writable=bool(changes), patience=patience) as universal:
        if remove is not None:
            universal.remove_session(remove)
        if restore is not None:
            universal.restore_session(restore)
        if rename is not None:
            universal.rename_session(*rename)
        if move is not None:
            universal.set_transform(move[0], *move[1])
        infos = universal.sessions()
        if as_json:
            output.print_json(_as_dict(map_, universal, infos))
            return
    output.print_table(
        ("session", "driven", "GNSS", "used", "rejected", ""), [_row(info) for info in infos]
    )


def _parsed(text: str) -> tuple[float, ...]:
    """East and north in metres, and the turn in degrees where there is one."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    options.refuse(
        len(values) not in (2, 3),
        "--shift",
        f"{quoted(text)} is not EAST,NORTH in metres or EAST,NORTH,TURN with degrees clockwise, as "
        "in 0.12,-0.31,0.2",
    )
    return values


def _row(info: SessionInfo) -> tuple[str, ...]:
    return (
        info.name,
        info.driven,
        info.source,
        str(info.accepted),
        str(info.frames - info.accepted),
        ", ".join(
            note
            for note in (
                "" if info.active else "removed",
                _shift_text(info.transform),
                f"poses of {info.config['poses']}" if "poses" in info.config else "",
            )
            if note
        ),
    )


def _shift_text(transform: Transform) -> str:
    """Where a session was put, in words; empty for where it was driven."""
    if transform.is_identity:
        return ""
    east_m, north_m, turn_deg = (
        transform.shift_east_m, transform.shift_north_m, transform.turn_deg,
    )  # fmt: skip
    if (aligned := transform.aligned) is not None:
        place = f"aligned: {east_m:+.3f} m east, {north_m:+.3f} m north"
        if aligned.sigma_m is None:
            return f"{place}, for poses that have changed since; align it again"
        heights = transform.heights
        up = "" if heights is None else f", {heights.mean_m:+.3f} m up"
        return f"{place} ± {aligned.sigma_m:.3f} m, {turn_deg:+.2f}°{up}"
    turn = f", turned {turn_deg:+g}°" if turn_deg else ""
    return f"shifted {east_m:+g} m east, {north_m:+g} m north{turn}"


def _as_dict(path: Path, universal: MapFile, infos: list[SessionInfo]) -> dict[str, Any]:
    datum = universal.datum
    has_cells = any(info.active and info.accepted for info in infos)
    return {
        "map": str(path),
        "datum": {
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        },
        "cell_m": universal.cell_m,
        "transfer": universal.transfer.value,
        "root_sha256": universal.root_sha256,
        "bounds_m": universal.bounds._asdict() if has_cells else None,
        "sessions": [
            {
                "name": info.name,
                "created": info.created,
                "removed": info.removed,
                "source": info.source,
                "source_sha256": info.source_sha256,
                "first_time_ns": info.first_time_ns,
                "last_time_ns": info.last_time_ns,
                "heading_source": info.heading_source,
                "poses": info.config.get("poses"),
                "software_version": info.software_version,
                "frames_used": info.accepted,
                "frames_rejected": info.frames - info.accepted,
                "digest": info.digest,
                "transform": None if info.transform.is_identity else asdict(info.transform),
            }
            for info in infos
        ],
    }

"""`fieldgrid mount`: how the sensor is mounted, by the drive alone."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.drive_options import Drive
from fieldgrid.core import FieldgridError

if TYPE_CHECKING:
    from fieldgrid.pipeline import MountComparison, MountEstimate

_NAMES = {
    "camera_height_above_ground_m": ("height above ground", 3, "m"),
    "camera_tilt_down_deg": ("tilt, down", 2, "°"),
    "camera_roll_deg": ("roll, right side down", 2, "°"),
    "camera_yaw_deg": ("yaw, right of the course", 2, "°"),
    "camera_ahead_of_rear_axle_m": ("ahead of non-steering axle", 2, "m"),
}


def command(
    recording: Annotated[str, typer.Argument(metavar="RECORDING")],
    drive: Drive,
    write: Annotated[
        bool, typer.Option("--write", help="Write it to the recording's mounting.json.")
    ] = False,
    antenna: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="FORWARD LEFT UP",
            help="With --write: position of the GNSS antenna, metres from the camera (from the "
            "middle between a pair's cameras). It cannot be estimated from a drive.",
        ),
    ] = None,
    every: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Take every N-th frame [default: a metre apart]."),
    ] = None,
    figure: options.Figure = None,
    overwrite: options.Overwrite = False,
    jobs: options.Jobs = None,
    as_json: options.AsJson = False,
) -> None:
    """Estimate height, tilt, roll and yaw of the sensor from the drive alone.

    A mounting given in the recording is not used; it is compared with the estimate.

    Examples:

        fieldgrid mount june-03

        fieldgrid mount june-03 --write --antenna -0.45 0.12 0.35
    """
    options.check_figure(figure)
    options.check_outputs([figure], [], overwrite=overwrite)
    options.refuse(antenna is not None and not write, "--antenna", "it is for --write")
    from fieldgrid.pipeline import estimate_mount, write_estimate

    path = progress.fetched(recording)
    with progress.counting("frames") as show:
        estimate = estimate_mount(
            path, drive.options(), every=every, jobs=jobs or os.cpu_count(), progress=show
        )
    if figure is not None:
        from fieldgrid.export import figures
        from fieldgrid.pipeline import mount_figure

        figures.save(mount_figure(estimate), figure)
    written: Path | None = None
    problem: FieldgridError | None = None
    if write:
        try:
            written = write_estimate(estimate, path, antenna)
        except FieldgridError as error:
            problem = error
    if as_json:
        output.print_json(
            {
                **estimate.as_dict(),
                "mounting": None if written is None else str(written),
                "figure": None if figure is None else str(figure),
            }
        )
    else:
        _print(estimate, written, figure)
    if problem is not None:
        raise problem  # only now, since the estimate took its time and is worth seeing


def _print(estimate: MountEstimate, written: Path | None, figure: Path | None) -> None:
    compared = {one.key: one for one in estimate.compared()}
    rows = [
        _row(key, estimate, compared.get(key))
        for key, value in estimate.measured().items()
        if value is not None or key == "camera_yaw_deg"
    ]
    output.print_table(
        ("", "measured", "stated", "stated - measured"), rows, title=f"mount {estimate.name}"
    )
    output.print_table(("", ""), _facts(estimate))
    wrong = [one for one in compared.values() if one.disagrees]
    for one in wrong:
        name, digits, unit = _NAMES[one.key]
        output.print_line(
            f"disagrees: {name} is stated as {one.stated:.{digits}f} {unit}, which is "
            f"{abs(one.sigmas):.1f} sigma off"
        )
    if compared and not wrong:
        output.print_line("the stated mounting agrees with the drive")
    for note in estimate.notes:
        output.print_line(f"note: {note}")
    if written is not None:
        output.print_line(f"mounting {written}")
    if figure is not None:
        output.print_line(f"figure {figure}")


def _row(key: str, estimate: MountEstimate, compared: MountComparison | None) -> tuple[str, ...]:
    name, digits, unit = _NAMES[key]
    measured = estimate.measured()[key]
    said = "-" if measured is None else f"{measured.value:.{digits}f} ± {measured.sigma:.{digits}f}"
    cells = (name, said if measured is None else f"{said} {unit}")
    if compared is None:
        return (*cells, "-", "-")
    difference = compared.stated - compared.measured.value
    return (
        *cells,
        f"{compared.stated:.{digits}f} {unit}",
        f"{difference:+.{digits}f} {unit} ({compared.sigmas:+.1f} sigma)",
    )


def _facts(estimate: MountEstimate) -> list[tuple[str, str]]:
    used, gnss = len(estimate.mount_samples.frame), estimate.gnss
    driven_m = (estimate.forward_m, estimate.reverse_m, estimate.straight_m)
    rows = [
        ("measured on", estimate.method),
        ("frames used / looked at / all", f"{used} / {estimate.looked} / {estimate.frames}"),
        (
            "driven forward / reverse / nearly straight",
            " / ".join(f"{metres:.1f}" for metres in driven_m) + " m",
        ),
    ]
    if gnss is not None and (scale := gnss.scale) is not None:
        rows.append(("distance, camera / receiver", f"{scale.ratio:.4f} ± {scale.sigma:.4f}"))
    if gnss is not None and (course := gnss.course_off_deg) is not None:
        rows.append(
            ("course minus recorded heading", f"{course.value:+.2f} ± {course.sigma:.2f} °")
        )
    return rows

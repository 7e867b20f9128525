"""Poses of other programs in their place, and how sure that is."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import least_squares

from fieldgrid.core import (
    Bool,
    ConfigError,
    FieldgridError,
    Float64,
    GnssError,
    PoseSettings,
    Quality,
)
from fieldgrid.geometry import FixColumns, GivenPoses, LeverArm, Motion, Trajectory, wrap_deg
from fieldgrid.pipeline.inputs import Inputs, from_arrays, to_arrays
from fieldgrid.poses import GIVEN, ErrorBudget, Estimate, estimate_poses, write_track
from fieldgrid.poses.faults.unseen import UnseenFault
from fieldgrid.recordings import DriveOptions, PoseSource, open_drive
from tests.scenes import paper_rig
from tests.simulated import DATUM, K_TURN, START, Command, Drive, fixes_of, simulate, time_ns

ROWS = simulate([Command(40.0, 1.5), Command(6.3, 1.0, 0.5), Command(40.0, 1.5)] * 2, 20.0)
TURNED_DEG, SHIFT_M = -73.0, (400.0, -250.0)
EAST_UP = {"frame_origin": f"{DATUM.lat_deg},{DATUM.lon_deg},{DATUM.height_m}"}


def slam(
    drive: Drive,
    *,
    drift_deg: float = 0.0,
    scale: float = 1.0,
    noise_m: float = 0.0,
    turned_deg: float = TURNED_DEG,
    seed: int = 0,
) -> GivenPoses:
    """A drive in a frame of its own, turned clockwise; its heading wanders by so much in 100 m."""
    random = np.random.default_rng(seed)
    s = drive.every(0.1)
    n = len(s.time_s)
    ways = np.stack([np.diff(s.east_m), np.diff(s.north_m)]) * scale
    steps = random.normal(0.0, np.radians(drift_deg), n - 1) * np.sqrt(np.hypot(*ways) / 100.0)
    wander = np.concatenate([[0.0], np.cumsum(steps)]) + np.radians(turned_deg)
    sin, cos = np.sin(wander[:-1]), np.cos(wander[:-1])
    x = np.cumsum(np.concatenate([[SHIFT_M[0]], ways[0] * cos + ways[1] * sin]))
    y = np.cumsum(np.concatenate([[SHIFT_M[1]], -ways[0] * sin + ways[1] * cos]))
    x, y = (column + random.normal(0.0, noise_m, n) for column in (x, y))
    heading = np.asarray(wrap_deg(np.degrees(s.heading_rad + wander)))
    flat, unsaid = np.zeros(n), np.full(n, np.nan)
    return GivenPoses(time_ns(s.time_s), x, y, flat, heading, flat, flat, unsaid, unsaid)


def wandering(drive: Drive, sigma_m: float, white_m: float, seed: int = 0) -> FixColumns:
    """Fixes of a receiver whose slow error has a sigma, which it states."""
    random = np.random.default_rng(seed + 1000)
    fixes = fixes_of(drive, 0.2, white_m, seed=seed)
    fading = np.exp(-0.2 / 300.0)
    error = random.normal(0.0, sigma_m, (1, 2))
    rest = random.normal(0.0, sigma_m * np.sqrt(1.0 - fading**2), (len(fixes), 2))
    errors = [error[0]]
    for k in range(1, len(fixes)):
        errors.append(fading * errors[-1] + rest[k])
    off_m = np.array(errors)
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, height = DATUM.to_geodetic(east + off_m[:, 0], north + off_m[:, 1], up)
    return fixes.replace(
        lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=np.full(len(fixes), max(sigma_m, 0.01))
    )


def placed(
    poses: GivenPoses, fixes: FixColumns, budget: ErrorBudget | None = None, **settings: object
) -> Estimate:
    chosen = PoseSettings.model_validate(settings)
    return estimate_poses(fixes, None, DATUM, chosen, Motion(poses=poses), budget)


class Errors(NamedTuple):
    """Of the accepted poses: metres and degrees, and the same in sigmas (the larger axis)."""

    ok: Bool
    place_m: Float64
    heading_deg: Float64
    place_sigmas: Float64
    heading_sigmas: Float64


def errors(found: Trajectory, drive: Drive) -> Errors:
    ok = found.accepted
    truth = drive.at((found.time_ns[ok] - START) / 1e9)
    east, north = found.east_m[ok] - truth.east_m, found.north_m[ok] - truth.north_m
    heading = np.abs(wrap_deg(found.heading_deg[ok] - np.degrees(truth.heading_rad)))
    most = np.maximum(np.abs(east), np.abs(north))
    return Errors(
        ok,
        np.hypot(east, north),
        heading,
        most / found.position_sigma_m[ok],
        heading / found.heading_sigma_deg[ok],
    )


# --- by the fixes


def test_poses_lie_along_their_fixes() -> None:
    found = placed(slam(ROWS), fixes_of(ROWS, 0.2, 0.01))
    off = errors(found.trajectory, ROWS)
    assert off.ok.all()
    assert (off.place_m.max(), off.heading_deg.max()) == (
        pytest.approx(0.0, abs=0.03),
        pytest.approx(0.0, abs=0.4),
    )
    assert found.trajectory.heading_source == GIVEN
    frame = found.report.georeference
    assert frame is not None
    # Headings of the frame are larger by the turn, so its x axis heads as much less.
    assert frame.frame_heading_deg == pytest.approx(90.0 - TURNED_DEG, abs=0.1)
    assert frame.frame_heading_sigma_deg < 0.2
    assert frame.scale == pytest.approx(1.0, abs=0.001)
    assert set(found.trajectory.gear.tolist()) <= {0, 1}
    assert len(found.fix_row) == len(fixes_of(ROWS, 0.2))


def test_the_transform_is_that_of_a_general_solver() -> None:
    poses, fixes = slam(ROWS, noise_m=0.02), fixes_of(ROWS, 0.2, 0.03)
    frame = placed(poses, fixes).report.georeference
    assert frame is not None
    east, north, _ = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    x = np.interp(fixes.time_ns - START, poses.time_ns - START, poses.x_m)
    y = np.interp(fixes.time_ns - START, poses.time_ns - START, poses.y_m)

    def residual(unknown: Float64) -> Float64:
        turn, e, n = unknown
        off_e = e + x * np.cos(turn) + y * np.sin(turn) - east
        off_n = n - x * np.sin(turn) + y * np.cos(turn) - north
        return np.concatenate([off_e, off_n])

    solved = least_squares(residual, [1.2, 0.0, 0.0], loss="soft_l1", f_scale=0.1)
    assert frame.frame_heading_deg == pytest.approx(np.degrees(solved.x[0]) + 90.0, abs=0.01)
    origin = [frame.origin_east_m, frame.origin_north_m]
    assert origin == pytest.approx(solved.x[1:].tolist(), abs=0.05)


def test_outliers_do_not_move_it() -> None:
    fixes = fixes_of(ROWS, 0.2, 0.02)
    wrong = np.arange(len(fixes)) % 5 == 0
    off = fixes.replace(lat_deg=fixes.lat_deg + 8e-5 * wrong)  # 9 m north
    with_outliers = placed(slam(ROWS), off, gnss={"speed_margin_mps": 20.0, "sigmas": 20.0})
    assert errors(with_outliers.trajectory, ROWS).place_m.max() < 0.05


@pytest.mark.parametrize("sigma_m", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("drift_deg", [0.0, 0.5, 2.0])
def test_sigmas_hold(sigma_m: float, drift_deg: float) -> None:
    """Receivers of three kinds, poses that wander or do not, and a hole of a minute in the fixes:
    what is accepted lies within three sigmas."""
    near, nearly, accepted = [], [], []
    for seed in range(3):
        fixes = wandering(ROWS, sigma_m, 0.02, seed)
        seconds = (fixes.time_ns - START) / 1e9
        fixes = fixes[np.flatnonzero((seconds < 50.0) | (seconds > 110.0))]
        found = placed(slam(ROWS, drift_deg=drift_deg, noise_m=0.01, seed=seed), fixes)
        off = errors(found.trajectory, ROWS)
        near.append(off.place_sigmas < 3.0)
        nearly.append(off.heading_sigmas < 3.0)
        accepted.append(off.ok)
    assert np.concatenate(near).mean() >= 0.99
    assert np.concatenate(nearly).mean() >= 0.99
    if drift_deg == 0.0:
        assert np.concatenate(accepted).mean() >= 0.95


def test_poses_that_drift_are_led_by_their_fixes() -> None:
    found = placed(slam(ROWS, drift_deg=1.0), fixes_of(ROWS, 0.2, 0.01))
    off = errors(found.trajectory, ROWS)
    assert off.ok.all()
    assert (off.place_m.max(), np.median(off.heading_deg)) < (0.05, 0.2)
    frame = found.report.georeference
    assert frame is not None
    assert frame.residual_most_m > 0.3
    assert 0.3 < frame.drift_deg < 3.0


def test_far_from_fixes_poses_are_less_sure() -> None:
    fixes = fixes_of(ROWS, 0.2, 0.01)
    seconds = (fixes.time_ns - START) / 1e9
    found = placed(slam(ROWS), fixes[np.flatnonzero((seconds < 40.0) | (seconds > 120.0))])
    track = found.trajectory
    sigma_m = np.interp([20.0, 80.0], (track.time_ns - START) / 1e9, track.position_sigma_m)
    assert sigma_m[0] < 0.05 < 0.15 < sigma_m[1]
    # And a budget for cells refuses what is too far.
    cells = placed(slam(ROWS), fixes[seconds < 40.0], ErrorBudget(0.25, 10.0)).trajectory
    reasons = set(cells.reason) - {""}
    assert any("cell 10 m ahead would be off" in reason for reason in reasons)


@pytest.mark.parametrize("ahead_m", [0.0, 1.0])
def test_poses_lead_on_after_the_last_fix(ahead_m: float) -> None:
    """To the end of the poses, as unsure as these may drift; also where nobody says that what they
    are of sits ahead of the axle, and only they show it."""
    east, north = ROWS.point(0.0, ahead_m).T
    drive = ROWS._replace(east_m=east, north_m=north)
    fixes, poses = fixes_of(drive, 0.2, 0.01), slam(drive, drift_deg=0.5, noise_m=0.01)
    found = placed(poses, fixes[(fixes.time_ns - START) / 1e9 < 30.0])
    track = found.trajectory
    assert track.time_ns[-1] > poses.time_ns[-1] - 2_000_000_000
    off = errors(track, drive)
    assert track.time_ns[off.ok][-1] > START + 100 * 10**9
    assert (off.place_sigmas < 3.0).mean() > 0.99
    assert (off.heading_sigmas < 3.0).mean() > 0.99
    sigma_m = np.interp([20.0, 100.0], (track.time_ns - START) / 1e9, track.position_sigma_m)
    assert sigma_m[0] < 0.05 < 0.3 < sigma_m[1]


def test_drift_that_is_stated_counts() -> None:
    """Of poses that state that they drift by more than is usual, and of those whose error stays."""
    fixes, poses = fixes_of(ROWS, 0.2, 0.01), slam(ROWS)
    seconds = (fixes.time_ns - START) / 1e9
    near = fixes[np.flatnonzero((seconds < 40.0) | (seconds > 120.0))]
    lasted_s = (poses.time_ns - START) / 1e9
    sigmas = []
    for sigma_m in (poses.sigma_m, 0.1 + 0.0 * lasted_s, 0.3 * np.sqrt(1e-6 + lasted_s)):
        track = placed(poses._replace(sigma_m=sigma_m), near).trajectory
        at_s = (track.time_ns - START) / 1e9
        sigmas.append(float(np.interp(80.0, at_s, track.position_sigma_m)))
    assert sigmas[1] == pytest.approx(sigmas[0])
    assert sigmas[2] > 3.0 * sigmas[0]


# --- what fixes and poses contradict


@pytest.mark.parametrize(
    ("poses", "settings", "sentence"),
    [
        (slam(ROWS, scale=0.8), {}, r"1\.2\d\d ± 0\.00\d times as long .* not in metres"),
        (slam(ROWS)._replace(y_m=-slam(ROWS).y_m), {}, "mirror image .* --poses-axes frd"),
        (slam(ROWS)._replace(heading_deg=np.asarray(wrap_deg(slam(ROWS).heading_deg + 180.0))), {},
         "drives backwards for 100 % of its way"),
        (slam(ROWS)._replace(heading_deg=np.asarray(wrap_deg(slam(ROWS).heading_deg + 12.0))), {},
         r"moves -1[12]\.\d° ± 0\.\d° off the forward axis"),
        (slam(ROWS)._replace(time_ns=slam(ROWS).time_ns + 3600 * 10**9), {},
         r"do not overlap in time; add the seconds between their clocks with --poses-offset"),
        (slam(ROWS), {"frame_origin": "39.5,-1.1,700"}, "give --frame-heading DEG"),
        (slam(ROWS), {"heading": "course", "frame_heading_deg": 1.0}, "and none are used"),
    ],
)  # fmt: skip
def test_what_does_not_fit(poses: GivenPoses, settings: dict[str, object], sentence: str) -> None:
    with pytest.raises(FieldgridError, match=sentence) as error:
        placed(poses, fixes_of(ROWS, 0.2, 0.01), **settings)
    assert "\n" not in str(error.value)


def test_a_short_way_does_not_tell_the_turn() -> None:
    drive = simulate([Command(8.0, 0.5)], 20.0)
    fixes = wandering(drive, 1.0, 0.3)
    with pytest.raises(GnssError, match=r"do not tell how the frame .* --frame-heading DEG"):
        placed(slam(drive), fixes)
    found = placed(slam(drive), fixes, frame_heading_deg=90.0 - TURNED_DEG)
    off = errors(found.trajectory, drive)
    assert off.ok.all()
    assert off.heading_deg.max() < 0.1
    assert off.place_sigmas.max() < 3.0


def test_no_fix_and_no_declaration() -> None:
    none = FixColumns.of([])
    with pytest.raises(GnssError, match="declare the frame with --frame-origin"):
        estimate_poses(none, None, None, None, Motion(poses=slam(ROWS)))
    with pytest.raises(GnssError, match="declare"):
        placed(slam(ROWS), none)


def test_a_jump_is_said() -> None:
    poses = slam(ROWS)
    away = np.isin(np.arange(len(poses.time_ns)), np.arange(500, 504))
    found = placed(poses._replace(x_m=poses.x_m + 3.0 * away), fixes_of(ROWS, 0.2, 0.01))
    assert any("4 poses of another program jump" in note for note in found.report.notes)
    # It moves nothing.
    off = errors(found.trajectory, ROWS)
    assert off.ok.mean() > 0.98
    assert off.place_m.max() < 0.05


def test_reverse_is_told_by_the_poses() -> None:
    drive = simulate(K_TURN, 35.0)
    track = placed(slam(drive), fixes_of(drive, 0.2, 0.01)).trajectory
    truth = drive.at((track.time_ns - START) / 1e9)
    moving = np.abs(truth.speed_mps) > 0.3
    assert (np.sign(truth.speed_mps[moving]) == track.gear[moving]).all()
    assert np.abs(track.speed_mps - truth.speed_mps)[moving].max() < 0.3


# --- where it is declared


def test_a_declared_frame_needs_no_fix() -> None:
    settings = {"frame_heading_deg": 90.0 - TURNED_DEG, "accuracy_m": 0.05, **EAST_UP}
    none = FixColumns.of([])
    found = placed(slam(ROWS), none, **settings)
    track = found.trajectory
    assert len(found.fix_row) == len(track)  # rows of a track, where there is no fix
    # The frame's origin is at the datum, and the drive begins at SHIFT_M of the frame.
    turn = np.radians(-TURNED_DEG)
    start = SHIFT_M[0] * np.cos(turn) + SHIFT_M[1] * np.sin(turn)
    assert track.east_m[0] == pytest.approx(start, abs=1e-6)
    assert track.accepted.all()
    assert np.median(track.position_sigma_m) == pytest.approx(np.hypot(0.05, 0.02), abs=1e-6)
    truth = ROWS.at((track.time_ns - START) / 1e9)
    assert np.abs(wrap_deg(track.heading_deg - np.degrees(truth.heading_rad))).max() < 1e-6
    del settings["accuracy_m"]
    with pytest.raises(ConfigError, match="say it with --accuracy METRES"):
        placed(slam(ROWS), none, **settings)


def test_a_declared_frame_that_the_fixes_deny() -> None:
    settings = {"frame_heading_deg": 90.0 - TURNED_DEG, **EAST_UP}
    with pytest.raises(GnssError, match=r"they lie \d+\.\d\d m \(median\) from fixes that state"):
        placed(slam(ROWS), fixes_of(ROWS, 0.2, 0.01), **settings)


def test_a_track_read_back_is_the_same(tmp_path: Path) -> None:
    """What `track -o x.tum` writes, given as poses of a log: a drive with a hole, and of its own
    fixes or a declared frame."""
    drive = simulate(K_TURN, 35.0)
    fixes = fixes_of(drive, 0.2, 0.01)
    fixes = fixes[np.flatnonzero(np.abs(np.arange(len(fixes)) - 40) > 10)]
    first = estimate_poses(fixes, None, DATUM)
    write_track(first, tmp_path / "a.tum")
    log = tmp_path / "log.csv"
    rows = zip(fixes.time_ns.tolist(), fixes.lat_deg, fixes.lon_deg, fixes.height_m, strict=True)
    lines = [f"{t},{lat:.10f},{lon:.10f},{h:.4f},4" for t, lat, lon, h in rows]
    log.write_text("\n".join(["time_ns,lat_deg,lon_deg,height_m,quality", *lines]))
    with open_drive(log, DriveOptions(poses=PoseSource(tmp_path / "a.tum"))) as opened:
        motion, read = opened.motion(), opened.fixes()
    settings = PoseSettings.model_validate({"frame_heading_deg": 90.0, **EAST_UP})
    again = estimate_poses(read, None, DATUM, settings, motion)
    write_track(again, tmp_path / "b.tum")
    one, two = (np.loadtxt(tmp_path / name) for name in ("a.tum", "b.tum"))
    assert one.shape == two.shape
    assert np.abs(one - two)[:, 1:].max() < 1e-3
    assert np.array_equal(one[:, 0], two[:, 0])
    by_fixes = estimate_poses(read, None, DATUM, None, motion)
    write_track(by_fixes, tmp_path / "c.tum")
    three = np.loadtxt(tmp_path / "c.tum")
    same = np.isin(three[:, 0], one[:, 0])
    assert np.count_nonzero(same) == len(one)
    assert np.abs(one - three[same])[:, 1:4].max() < 0.02


def test_a_map_keeps_them() -> None:
    poses = slam(ROWS)
    kept = Inputs(fixes_of(ROWS), Motion(poses=poses), np.zeros(0, np.int64), np.zeros(0, np.bool_))
    read = from_arrays(to_arrays(kept)).motion.poses
    assert read is not None
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(read, poses, strict=True))


def test_other_headings_do_without_them() -> None:
    fixes = fixes_of(ROWS, 0.2, 0.01)
    found = placed(slam(ROWS), fixes, heading="course")
    assert found.trajectory.heading_source == "course"
    assert any("given poses were not used" in note for note in found.report.notes)


# --- what neither fixes nor poses show


def stating(sigma_m: float, quality: Quality, drive: Drive = ROWS) -> FixColumns:
    fixes = fixes_of(drive, 0.2, 0.01, quality=quality)
    return fixes.replace(sigma_m=np.full(len(fixes), sigma_m))


def test_poses_are_no_surer_than_the_receiver_that_they_lie_by() -> None:
    fixes = stating(0.06, Quality.DIFFERENTIAL)
    found = placed(slam(ROWS), fixes)
    assert np.median(found.trajectory.position_sigma_m) == pytest.approx(0.25, abs=0.01)
    assert any("state 0.06 m" in note and "--accuracy" in note for note in found.report.notes)
    for other, accuracy_m in ((stating(0.06, Quality.UNKNOWN), None), (fixes, 0.06)):
        found = placed(slam(ROWS), other, accuracy_m=accuracy_m)
        assert np.median(found.trajectory.position_sigma_m) < 0.1
        assert not any("--accuracy" in note for note in found.report.notes)


def test_fixes_weigh_by_what_they_state() -> None:
    """So that poses beside RTK fixes are as sure as these."""
    fixes = stating(0.06, Quality.DIFFERENTIAL)
    fixed = np.arange(len(fixes)) < len(fixes) // 2
    fixes = fixes.replace(
        quality=np.where(fixed, int(Quality.RTK_FIXED), fixes.quality),
        sigma_m=np.where(fixed, 0.01, 0.06),
    )
    track = placed(slam(ROWS), fixes).trajectory
    early = track.time_ns < fixes.time_ns[len(fixes) // 2]
    assert np.median(track.position_sigma_m[early]) < 0.08


def test_what_poses_would_not_show_is_named() -> None:
    """As of a camera's motion: what is the same in the vehicle shows where it turns."""
    lane = simulate([Command(40.0, 1.5)], 20.0)
    rig = paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)
    aside = (UnseenFault.ANTENNA_ASIDE, UnseenFault.ANTENNA_AHEAD, UnseenFault.LATE_STAMPS)
    for drive, vehicle, unseen in ((ROWS, rig, ()), (lane, rig, aside), (lane, None, ())):
        motion = Motion(poses=slam(drive))
        found = estimate_poses(fixes_of(drive, 0.2, 0.01), vehicle, DATUM, None, motion)
        assert set(found.report.unseen) - {UnseenFault.SLOW_DRIFT} == set(unseen)


def test_fixes_do_not_move_a_frame_that_is_declared() -> None:
    poses = slam(ROWS, turned_deg=0.0)
    start = ROWS.at(np.zeros(1))
    poses = poses._replace(
        x_m=poses.x_m - SHIFT_M[0] + start.east_m, y_m=poses.y_m - SHIFT_M[1] + start.north_m
    )
    settings = {**EAST_UP, "frame_heading_deg": 90.0}
    found = placed(poses, stating(0.06, Quality.DIFFERENTIAL), **settings)
    assert found.report.unseen == ()
    assert np.median(found.trajectory.position_sigma_m) < 0.1

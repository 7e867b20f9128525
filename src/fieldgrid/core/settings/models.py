"""Every setting of a build, with its default, range, flag and meaning.

Numbers are metres, degrees, seconds, pixels or metres a second, as their names say.
"""

from __future__ import annotations

from pydantic import Field, field_validator, model_validator

from fieldgrid.core.choices import GearName, MatcherKind, StopCode, Transfer
from fieldgrid.core.errors import ConfigError
from fieldgrid.core.quality import NOT_FROM_SATELLITES, Quality
from fieldgrid.core.settings.declare import Flag, Settings, setting

_GRID = Flag("--grid", "WxL", "x", "local grid in metres: across and ahead")
_SLICE = Flag("--slice", "BOTTOM:TOP", ":", "heights above the local ground that count, metres")


class GridSettings(Settings):
    """The vehicle-fixed local grid."""

    width_m: float = setting(10.0, "local grid: metres across, centred on the vehicle", flag=_GRID)
    length_m: float = setting(15.0, "local grid: metres ahead", flag=_GRID)
    cell_m: float = setting(0.05, "local cell, L_L", flag=Flag("--local-cell", "M"))


class MapSettings(Settings):
    """The universal grid of a new map. An existing map keeps its own."""

    cell_m: float | None = setting(
        None,
        "universal cell of a new map, L_U, at least L_L",
        usual="that of the local grid",
        flag=Flag("--cell", "M"),
        gt=0.0,
    )
    transfer: Transfer | None = setting(
        None,
        "transfer to universal cells of a new map: centre (the paper) or area (no holes)",
        usual="centre",
        flag=Flag("--transfer", "centre|area"),
    )
    layers: str = setting(
        "",
        "layers that the tiles of a new map hold beside the core, with commas: names, frames, "
        "terrain, standing, time or all; others are folded from the frames when they are read",
        flag=Flag("--layers", "NAMES"),
    )

    def kept_layers(self) -> tuple[str, ...]:
        """The names of `layers`."""
        return tuple(name.strip() for name in self.layers.split(",") if name.strip())


class StereoSettings(Settings):
    """How pairs are matched."""

    matcher: MatcherKind = setting(
        MatcherKind.SGBM_3WAY,
        "stereo matcher; sgbm is a little more precise, bm is fast and sparse",
        flag=Flag("--matcher", "sgbm3way|sgbm|bm"),
    )
    row_step: int = setting(
        1,
        "2 matches the means of two rows each: in half the time, less precise with noisy images",
        flag=Flag("--row-step", "1|2"),
        ge=1,
        le=2,
    )
    block_px: int | None = setting(
        None,
        "side of the compared blocks, odd",
        usual="9, of bm 15, with row_step 2 5",
        ge=3,
        le=51,
    )
    uniqueness_percent: int = setting(
        10, "margin of the best match over the second best", ge=0, le=50
    )
    left_right_px: int = setting(
        1, "largest left-right difference of a match; 0 switches the check off", ge=0, le=10
    )
    speckle_px: int = setting(100, "smaller blobs of disparity are dropped", ge=0, le=10_000)
    speckle_step_px: int = setting(2, "disparity step within a blob", ge=1, le=16)
    disparity_sigma_px: float = setting(0.25, "for the sigma of a range", gt=0.0, le=5.0)
    min_range_m: float = setting(
        3.0, "nearest point searched; sets the number of disparities", gt=0.1, le=50.0
    )

    @model_validator(mode="after")
    def _rows_fit_the_matcher(self) -> StereoSettings:
        if self.row_step > 1 and self.matcher is MatcherKind.BM:
            raise ValueError("row_step 2 loses the ground with bm; use sgbm3way or sgbm")
        return self

    def block(self) -> int:
        """The block size in pixels, the matcher's own when none is set."""
        usual = 15 if self.matcher is MatcherKind.BM else 9 if self.row_step == 1 else 5
        block = self.block_px or usual
        if block % 2 == 0 or (self.matcher is MatcherKind.BM and block < 5):
            raise ConfigError(
                f"A block of {block} px does not fit {self.matcher.value}; give an odd number, "
                "5 or more for bm."
            )
        return block


class DensitySettings(Settings):
    """What of the point cloud enters a local grid, and how counts become 3D density.

    3D density is the number of points in a cell's column of the slice per m³, compensated for
    range: d_c = d·(R/R0)^p. Times (R0/f)², the area that one pixel sees at R0, it is the
    facing surface in m² per m³, which does not depend on the camera; 255 stands for
    `saturation_m2_per_m3` of it, in every frame. A point of a lidar stands for the area that
    is its share of a steradian, so densities of all sensors compare.

    `min_points` guard against false matches. A lidar makes none, and takes few points where it is
    far, so one or two do (`points_needed`).
    """

    slice_bottom_m: float = setting(
        0.2, "lower end of the slice, above the local ground", flag=_SLICE, ge=0.02, le=5.0
    )
    slice_top_m: float = setting(
        2.2, "upper end of the slice, above the local ground", flag=_SLICE, gt=0.05, le=20.0
    )
    min_range_m: float = setting(
        1.0,
        "nearer depths and points belong to the vehicle; stereo pairs use stereo.min_range_m",
        ge=0.0,
        le=50.0,
    )
    max_range_m: float = setting(
        15.0,
        "farthest points used; less where the range sigma is too large",
        flag=Flag("--max-range", "M"),
        gt=1.0,
        le=200.0,
    )
    max_range_sigma_m: float = setting(
        0.2, "points with a larger range sigma are left out", gt=0.01, le=10.0
    )
    range_exponent: float = setting(
        2.0, "2 for facing surfaces, 3 for the ground and walls alongside", ge=0.0, le=4.0
    )
    reference_range_m: float = setting(8.0, "R0", gt=0.5, le=100.0)
    max_gain: float = setting(4.0, "cap of (R/R0)^p", ge=1.0, le=100.0)
    min_points: int = setting(
        5, "fewer points in a cell are no obstacle; a lidar needs at most 2", ge=1, le=1000
    )
    min_ground_points: int = setting(
        2, "fewer ground points do not make a cell free", ge=1, le=1000
    )
    saturation_m2_per_m3: float = setting(
        0.2, "the density that is stored as 255", gt=0.0, le=100.0
    )

    @model_validator(mode="after")
    def _slice_has_height(self) -> DensitySettings:
        if self.slice_top_m <= self.slice_bottom_m + 0.05:
            raise ValueError(
                f"the slice from {self.slice_bottom_m} to {self.slice_top_m} m has no height"
            )
        return self

    @property
    def slice_m(self) -> float:
        """Thickness of the slice, ΔZ = Z_max - Z_min."""
        return self.slice_top_m - self.slice_bottom_m


class GateLimits(Settings):
    """What a fix must satisfy.

    From fix to fix a vehicle may leave its even motion by `speed_margin_mps` and
    `max_acceleration_mps2`, along the track or across it; a stamp may be off by `timing_s`, for
    hosts buffer; and `sigmas` standard deviations of a displacement are noise. Where fixes are
    missing it drives at `max_speed_mps` at most.

    Fixes that agree with each other but not with those before or after them are a solution that
    has moved, and are followed, when they are `moved_fixes` over `moved_s` seconds; fewer are
    rejected, and so is an excursion of less than twice that from which the solution returns.
    Of fixes worse than most of the log up to four times as many are asked.
    """

    allowed_quality: frozenset[Quality] = setting(
        frozenset(Quality) - NOT_FROM_SATELLITES,
        "qualities that are used, by name or by GGA's codes",
        min_length=1,
    )
    min_satellites: int = setting(5, "fewer satellites reject a fix", ge=0, le=50)
    max_hdop: float = setting(4.0, "a larger HDOP rejects a fix", gt=0.0, le=100.0)
    # u-blox keeps a fixed solution for 60 s without corrections, NavCom for 15 s, and the error
    # then grows by a few cm a minute: after half a minute it is still that of RTK.
    max_age_s: float = setting(
        30.0, "largest age of a carrier-phase correction (RTK)", gt=0.0, le=3600.0
    )
    # PPP and SBAS send orbits and clocks every few minutes, and receivers use them for as long
    # (NovAtel 360 s): beside the decimetres that such a fix is good for, age says little.
    max_code_age_s: float = setting(
        300.0, "largest age of an SBAS, DGPS or PPP correction", gt=0.0, le=3600.0
    )
    speed_margin_mps: float = setting(
        1.0,
        "largest deviation of a fix from the steady motion of its neighbours, as a speed",
        ge=0.0,
        le=20.0,
    )
    max_acceleration_mps2: float = setting(4.0, "the same, as an acceleration", gt=0.0, le=50.0)
    max_speed_mps: float = setting(40.0, "largest speed where fixes are missing", gt=0.0, le=500.0)
    timing_s: float = setting(0.1, "largest delay of the time stamp of a fix", ge=0.0, le=5.0)
    sigmas: float = setting(4.0, "deviations up to so many sigma count as noise", gt=0.0, le=20.0)
    moved_fixes: int = setting(
        10, "a GNSS solution that has shifted is followed after so many fixes", ge=2, le=10_000
    )
    moved_s: float = setting(3.0, "and after this time", ge=0.0, le=600.0)

    @field_validator("allowed_quality", mode="before")
    @classmethod
    def _by_name(cls, given: object) -> object:
        if isinstance(given, (list, tuple, set, frozenset)):
            return [Quality.named(one) if isinstance(one, str) else one for one in given]
        return given


class GearSpan(Settings):
    """In which gear a vehicle drove from one instant to another, UTC nanoseconds."""

    start_ns: int
    stop_ns: int
    gear: GearName


class FrameOrigin(Settings):
    """Where the frame of given poses has its origin: degrees, and metres above the ellipsoid."""

    lat_deg: float = Field(ge=-90.0, le=90.0)
    lon_deg: float = Field(ge=-180.0, le=180.0)
    height_m: float = Field(ge=-1000.0, le=10_000.0)


class PoseSettings(Settings):
    """How poses are estimated and judged."""

    heading: str = setting(
        "smooth",
        "source of headings: smooth (all sensors), course (the paper), recorded, constant:DEG",
        flag=Flag("--heading", "smooth|course|recorded|constant:DEG"),
    )
    accuracy_m: float | None = setting(
        None,
        "1-sigma error of a fix along one axis, instead of what the receiver reports",
        usual="as the receiver reports, otherwise typical for the quality",
        flag=Flag("--accuracy", "M"),
        gt=0.0,
        le=100.0,
    )
    quality: Quality | None = setting(
        None,
        "quality of all fixes, instead of the logged one: rtk-fixed, rtk-float and so on",
        usual="what the log says",
        flag=Flag("--quality", "NAME"),
    )
    starts: GearName | None = setting(
        None,
        "gear at the start of a drive, if its positions leave it open",
        usual="the likelier one",
        flag=Flag("--starts", "forward|reverse"),
    )
    gear_spans: tuple[GearSpan, ...] = setting(
        (), "known gears: start_ns, stop_ns, gear (forward or reverse)", usual="none"
    )
    frame_origin: FrameOrigin | None = setting(
        None,
        "origin of the frame of --poses: latitude, longitude, height",
        usual="by the fixes",
        flag=Flag("--frame-origin", "LAT,LON,HEIGHT"),
    )
    frame_heading_deg: float | None = setting(
        None,
        "heading of the forward axis of that frame (x; with camera axes z): 90 if x points east",
        usual="by the fixes",
        flag=Flag("--frame-heading", "DEG"),
        ge=-360.0,
        le=360.0,
    )
    visual_odometry: bool = setting(
        True,
        "whether smooth uses visual odometry",
        flag=Flag("--visual-odometry/--no-visual-odometry", ""),
    )
    cell_budget_m: float | None = setting(
        None,
        "largest 1-sigma error of a cell at the far end of a grid, from heading and position; "
        "the receiver's slow error is not counted",
        usual="map.cell_m, at least 0.25",
        flag=Flag("--budget", "M"),
        gt=0.0,
        le=10.0,
    )
    max_heading_sigma_deg: float = setting(
        3.0, "poses with a larger sigma are rejected", gt=0.0, le=90.0
    )
    max_position_sigma_m: float = setting(
        2.0,
        "poses with a larger absolute sigma are rejected; the receiver's slow error is included",
        gt=0.0,
        le=100.0,
    )
    max_gear_doubt: float = setting(
        0.02, "poses with a larger probability of the other gear are rejected", gt=0.0, le=0.5
    )
    max_heading_offset_deg: float = setting(
        5.0,
        "a larger offset of the recorded heading from the estimated one is an error",
        gt=0.0,
        le=45.0,
    )
    baseline_m: float | None = setting(
        None, "distance over which course is fitted", usual="200 sigma, 4 to 12", gt=0.1, le=100.0
    )
    min_turn_radius_m: float = setting(
        1.0,
        "a heading change that needs a smaller radius is rejected (course, recorded)",
        gt=0.0,
        le=50.0,
    )
    gnss: GateLimits = GateLimits()

    @field_validator("frame_origin", mode="before")
    @classmethod
    def _by_numbers(cls, given: object) -> object:
        if not isinstance(given, str):
            return given
        parts = given.split(",")
        if len(parts) != len(FrameOrigin.model_fields):
            raise ValueError("give LAT,LON,HEIGHT, as in 41.65,-4.72,787.4")
        return dict(zip(FrameOrigin.model_fields, parts, strict=True))

    @field_validator("quality", mode="before")
    @classmethod
    def _by_name(cls, given: object) -> object:
        if not isinstance(given, str):
            return given
        try:
            return Quality.named(given)
        except ConfigError as error:
            raise ValueError(str(error).removesuffix(".")) from error

    @property
    def uses_camera(self) -> bool:
        """Whether poses want the motion that the camera saw."""
        return self.visual_odometry and self.heading == "smooth"


class CheckSettings(Settings):
    """What a build makes of what `inspect` calls an error."""

    accept: frozenset[StopCode] = setting(
        frozenset(),
        f"errors of inspect that do not stop a build: {', '.join(StopCode)}",
        usual="none",
        flag=Flag("--accept", "CODE"),
    )


class BuildSettings(Settings):
    """Everything that decides what a map says; the resolved values go into it with a session."""

    grid: GridSettings = GridSettings()
    stereo: StereoSettings = StereoSettings()
    density: DensitySettings = DensitySettings()
    pose: PoseSettings = PoseSettings()
    map: MapSettings = MapSettings()
    checks: CheckSettings = CheckSettings()

    @property
    def universal_cell_m(self) -> float:
        """L_U in metres."""
        return self.grid.cell_m if self.map.cell_m is None else self.map.cell_m

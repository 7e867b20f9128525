"""What the first release got wrong or did not have, and the tests that hold it now.

A test that is renamed or moved is renamed here, too; one that is removed needs another in its
place.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent

PROMISES: dict[str, tuple[str, ...]] = {
    "only files of the kind that is written are replaced, and never an input": (
        "cli/test_protection.py::test_no_input_is_replaced",
        "cli/test_protection.py::test_a_converted_drive_does_not_replace_itself",
        "export/test_every_format.py::test_what_others_have_written_is_never_replaced",
    ),
    "an error that inspect finds stops a build, unless it is accepted": (
        "cli/test_cli_inspect.py::test_a_drive_that_would_not_build",
        "pipeline/inspection/test_broken_drives.py::test_a_build_fails_where_the_inspection_says_so",
        "pipeline/drives/test_cameras.py::test_pairs_that_are_not_rectified_are_refused_unless_accepted",
        "pipeline/inspection/test_broken_drives.py::test_images_that_are_stamped_in_whole_seconds_stop_a_build",
    ),
    # 0.1.0 cut obstacles, poses and cells only. `export --bounds -10 40 10 60` of the example drive
    # kept the lines of GeoJSON, KMZ and guidance and the path of a bag as they were, up to north
    # 75.8 m, and outlines up to 76.5 m (footprints, the boundary of task data).
    "bounds cut all that an export writes": (
        "export/test_clipping.py::test_features_end_at_the_bounds",
        "export/test_clipping.py::test_lines_of_a_kmz_end_at_the_bounds",
        "export/test_clipping.py::test_paths_and_fixes_of_a_bag_end_at_the_bounds",
        "export/test_clipping.py::test_task_data_end_at_the_bounds",
        "export/test_clipping.py::test_features_of_other_formats_end_at_the_bounds",
    ),
    "what nobody saw is no free ground in arrays": (
        "export/test_arrays.py::test_what_nobody_saw_is_no_free_ground_to_rioxarray",
        "export/test_arrays.py::test_gdal_reads_a_netcdf_with_its_mask",
        "export/test_arrays.py::test_a_checker_of_the_conventions_has_nothing_to_say",
        "export/test_arrays.py::test_npz_is_the_truth_without_pickles",
    ),
    "a converted drive gives the map of the original": (
        "pipeline/convert/test_convert.py::test_a_converted_drive_gives_the_map_of_the_original",
    ),
    "a drive in another country is refused for that": (
        "pipeline/drives/test_sessions.py::test_a_drive_in_another_country_is_refused_for_that_and_nothing_else",
    ),
    "bad frames and failed recordings cost no others": (
        "pipeline/drives/test_drives.py::test_bad_frames_are_left_out_up_to_a_bound",
        "pipeline/drives/test_drives.py::test_more_bad_frames_than_the_bound_are_refused",
        "cli/test_cli_build.py::test_drives_that_fail_are_named_and_the_others_are_built",
    ),
    "no option is ignored": (
        "cli/test_protection.py::test_every_option_is_read",
        "cli/test_protection.py::test_an_option_that_cannot_count_is_refused",
        "cli/test_protection.py::test_an_option_without_the_one_that_it_is_for_is_refused",
        "cli/test_cli_export.py::test_every_option_of_every_format_counts_or_is_refused",
        "export/test_taskdata.py::test_task_data_in_one_file_are_those_of_the_folder",
    ),
    "the measured axle is written, negative places are no options, images have their folder": (
        "pipeline/mounting/test_writing.py::test_an_axle_that_was_measured_is_written",
        "cli/test_protection.py::test_numbers_below_zero_are_no_options",
        "pipeline/drives/test_cluster.py::test_a_cluster_gives_the_same_bits_also_when_a_worker_is_killed",
    ),
    "exports are read by others": (
        "export/test_tables.py::test_a_validator_of_geoparquet_has_nothing_to_say",
        "export/test_rosbag.py::test_odometry_and_tf_are_where_the_vehicle_was",
        "export/test_rosbag.py::test_a_bag_of_ros_1_is_one",
        "export/test_rosbag.py::test_readers_of_ros_bags_open_an_mcap",
        "export/test_taskdata.py::test_it_is_valid_by_the_schema",
        "export/test_mbtiles.py::test_gdal_reads_it_in_its_place",
        "export/test_vector.py::test_a_drawing_has_a_layer_for_each_kind",
        "export/test_points.py::test_each_obstacle_cell_is_a_point",
        "export/test_nav2.py::test_it_comes_back_through_the_rules_of_the_map_server",
        "export/test_squares.py::test_squares_at_the_bounds_stay_whole_and_are_left_out_where_nobody_asks",
        "maps/farm/test_catalogue.py::test_the_stac_catalogue_is_valid_and_others_read_it",
        "cli/test_output.py::test_a_time_in_json_has_its_text_beside_it",
    ),
    "recordings as others have them are read": (
        "recordings/test_packed_depth.py",
        "recordings/test_bag_moving.py::test_transforms_that_move_tell_what_odometry_tells",
        "recordings/test_bag_drive.py::test_cameras_whose_names_say_nothing_are_told_by_their_calibration",
        "recordings/test_motion_files.py::test_wheels_keep_their_sign",
        "pipeline/drives/test_sweeps.py::test_walls_are_where_they_are",
    ),
    "a plain survey is a truth, and a map gets another datum without images": (
        "cli/test_evaluate_survey.py::test_a_survey_on_the_command_line",
        "field/evaluation/test_survey.py::test_points_are_read_from_csv_and_geojson",
        "maps/file/test_merge.py::test_a_map_in_the_plane_of_another_datum",
    ),
    "the command line is that of a grown program": (
        "cli/test_command_line.py::test_completion_scripts",
        "cli/test_command_line.py::test_quiet_says_nothing_and_does_the_same",
        "cli/test_command_line.py::test_verbose_says_how_long_on_stderr",
        "cli/test_command_line.py::test_info_says_versions_extras_and_caches",
        "cli/test_command_line.py::test_every_command_reports_as_json_or_says_why_not",
        "cli/test_cli_lasting.py::test_a_session_gets_another_name",
        "cli/test_command_line.py::test_no_line_of_help_is_cut_or_too_long",
        "cli/test_command_line.py::test_colours_are_for_terminals_that_want_them",
    ),
}
"""Promises, and tests below this folder."""


@cache
def functions(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("promise", PROMISES)
def test_the_tests_of_a_promise_are_there(promise: str) -> None:
    for named in PROMISES[promise]:
        path, _, name = named.partition("::")
        assert (TESTS / path).is_file(), named
        assert not name or name in functions(TESTS / path), named

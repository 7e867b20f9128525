"""What a command does not need is not imported: it would be a fifth of the time of a short one."""

import json
import subprocess
import sys

LATE = (
    "apsw",
    "fieldgrid.field.align",
    "fieldgrid.export.cells",
    "fieldgrid.export.figures",
    "fieldgrid.recordings.ros.writers",
    "fieldgrid.view.app",
    "matplotlib",
    "numba",
    "rosbags.convert",
    "rosbags.rosbag2",
    "scipy",
    "xml.sax",
)
"""Packages and modules that neither a build of one drive nor a track has to have imported before
it begins."""

PROGRAM = """
import json, sys
import fieldgrid.cli.commands.build, fieldgrid.cli.commands.track
import fieldgrid.pipeline.drives, fieldgrid.pipeline.tracking
import fieldgrid.maps.file.store, fieldgrid.poses.track.table
print(json.dumps(sorted(sys.modules)))
"""


def test_what_comes_later_is_not_imported_at_the_start() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True)
    imported = json.loads(done.stdout)
    found = [
        late
        for late in LATE
        if any(name == late or name.startswith(f"{late}.") for name in imported)
    ]
    assert found == []

"""Kernels: kept machine code, and who is told that there is none."""

import os
import subprocess
import sys
from pathlib import Path

_MODULE = """
from fieldgrid.core import kernel

@kernel
def double(values):
    for k in range(len(values)):
        values[k] *= 2.0
"""

_RUN = """
import numpy as np
from fieldgrid.core import when_compiling
when_compiling(lambda: print("compiling"))
from loops import double
for kind in (np.float64, np.float32):
    double(np.ones(2, kind))
"""


_COLLECTOR = """
import gc
import numpy as np
from numba.core import event
from loops import double

class Passes(event.Listener):
    collects = set()
    def on_start(self, event):
        self.collects.add(gc.isenabled())
    def on_end(self, event):
        pass

event.register("numba:run_pass", Passes())
for before, kind in ((gc.enable, np.float64), (gc.disable, np.float32)):
    before()
    double(np.ones(2, kind))
    try:
        double("no array")
    except Exception as error:
        print(type(error).__name__)
    print(Passes.collects, gc.isenabled())
    Passes.collects.clear()
"""


def _run(folder: Path, program: str = _RUN) -> list[str]:
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "kept")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_that_a_kernel_is_compiled_is_told_once_and_not_where_its_code_is_kept(
    tmp_path: Path,
) -> None:
    module = tmp_path / "loops.py"
    module.write_text(_MODULE)
    assert _run(tmp_path) == ["compiling"]
    assert _run(tmp_path) == []
    # Another version of the module.
    module.write_text(_MODULE.replace("2.0", "3.0"))
    later_ns = 10_000_000_000 + module.stat().st_mtime_ns
    os.utime(module, ns=(later_ns, later_ns))
    assert _run(tmp_path) == ["compiling"]


def test_the_collector_rests_while_a_kernel_is_compiled_and_then_is_as_before(
    tmp_path: Path,
) -> None:
    (tmp_path / "loops.py").write_text(_MODULE)
    on, off = ["TypingError", "{False}", "True"], ["TypingError", "{False}", "False"]
    assert _run(tmp_path, _COLLECTOR) == on + off

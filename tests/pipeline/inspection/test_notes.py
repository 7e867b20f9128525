"""Which notes on the poses of a drive are warnings."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Quality, Severity
from fieldgrid.geometry import Carrier
from fieldgrid.pipeline.inspection.drive import told_of_poses
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, SLALOM, fixes_of, simulate


@pytest.mark.parametrize("quality", [Quality.DIFFERENTIAL, Quality.GPS])
def test_a_receiver_that_is_less_sure_than_it_states_is_no_warning(quality: Quality) -> None:
    """That is so of every receiver of its kind, and the drive is none the worse."""
    fixes = fixes_of(simulate(SLALOM, 35.0), 0.2, 0.01, quality=quality)
    fixes = fixes.replace(sigma_m=np.full(len(fixes), 0.1))
    findings = told_of_poses(estimate_poses(fixes, Carrier(0.0), DATUM))
    assert {finding.severity for finding in findings} == {Severity.INFO}
    (found,) = (finding for finding in findings if finding.code == "accuracy")
    assert found.message.endswith("m.")
    assert found.remedy.startswith("If yours is known")
    assert "--accuracy METRES" in found.remedy

"""The rig of a session, by the table of plain values that is kept with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fieldgrid.core import CalibrationError, MapError, quoted
from fieldgrid.geometry import Rig


def rig_from_config(config: Mapping[str, Any], session: str) -> Rig:
    """The rig of a session by its config; MapError when that does not describe one."""
    try:
        return Rig.from_dict(config)
    except CalibrationError as error:
        raise MapError(
            f"Session {quoted(session)} does not say what rig it was driven with ({error}); build "
            "it again from its recording."
        ) from error

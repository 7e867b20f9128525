"""The rig as it is kept with a session: a table of plain values, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from fieldgrid.errors import MapError
from fieldgrid.rig import DepthCamera, LeverArm, Lidar, Mount, Rig, Sensor, StereoCamera

# The key says which sensor it is; maps of stereo drives have always had "camera".
_KINDS: dict[str, type[StereoCamera] | type[DepthCamera] | type[Lidar]] = {
    "camera": StereoCamera,
    "depth_camera": DepthCamera,
    "lidar": Lidar,
}


def rig_to_config(rig: Rig) -> dict[str, Any]:
    """The fields of a rig; its sensor stands under a key that says which kind it is."""
    config = asdict(rig)
    (kind,) = (key for key, sensor in _KINDS.items() if isinstance(rig.sensor, sensor))
    return {kind: config.pop("sensor"), **config}


def rig_from_config(config: Mapping[str, Any], session: str) -> Rig:
    """The rig of a session by its config; MapError when that does not describe one."""
    try:
        rig = dict(config)
        (kind,) = rig.keys() & _KINDS.keys()
        sensor: Sensor = _KINDS[kind](**rig.pop(kind))
        return Rig(sensor, Mount(**rig.pop("mount")), LeverArm(**rig.pop("antenna")), **rig)
    except (KeyError, TypeError, ValueError) as error:
        raise MapError(
            f"Session {session!r} does not say what rig it was driven with ({error}); build "
            "it again from its recording."
        ) from error

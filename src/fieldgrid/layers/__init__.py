"""What a map says of its cells: channel groups, the layers made of them, and how they fold.

One module a built-in subject. A module of your own adds a layer with `register_group`, where it
needs channels that are not there, and `register_layer`; it is found when the entry points of its
package name it in the group `fieldgrid.layers`::

    register_layer(Layer("dense", "uint8", "", "1 above 200", ("density",), ..., None, colours))

Maps written from then on hold its channels at every zoom level; `MapFile.repair` adds them to
older maps, and until then a read folds them from the frames.
"""

from fieldgrid.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Fold,
    Layer,
    OverviewChannel,
    Surroundings,
    has_any,
    is_nothing,
    nothing,
)
from fieldgrid.layers.frame import FrameCells, FrameInPlace
from fieldgrid.layers.registry import (
    GROUPS,
    LAYERS,
    RETIRED_GROUPS,
    channel_names,
    check_layers,
    groups_of,
    register_group,
    register_layer,
    stored_groups,
    unregister,
)
from fieldgrid.layers.traversability import Mobility, traversability

__all__ = [
    "GROUPS",
    "LAYERS",
    "RETIRED_GROUPS",
    "Cells",
    "Channel",
    "ChannelGroup",
    "Colours",
    "Combine",
    "Fold",
    "FrameCells",
    "FrameInPlace",
    "Layer",
    "Mobility",
    "OverviewChannel",
    "Surroundings",
    "channel_names",
    "check_layers",
    "groups_of",
    "has_any",
    "is_nothing",
    "nothing",
    "register_group",
    "register_layer",
    "stored_groups",
    "traversability",
    "unregister",
]

"""Which channel groups and layers there are: the built-in ones, and those of other modules."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain

from fieldgrid.core import ConfigError, Group, PluginRegistry, quoted
from fieldgrid.maps.layers.built_in import (
    count,
    density,
    drop,
    ground,
    height,
    highest,
    lasting,
    moved,
    occupancy,
    relief,
    sessions,
    standing,
    traversability,
    variance,
)
from fieldgrid.maps.layers.declaration import ChannelGroup, Layer

_GROUPS: dict[str, ChannelGroup] = {}
_LAYERS: dict[str, Layer] = {}

CORE_GROUPS = ("density", "count", "sessions", "terrain", "drop", "moved")
"""The channel groups that the tiles of every map hold: what planners decide by, and the ground."""

GROUPS: Mapping[str, ChannelGroup] = PluginRegistry(_GROUPS, Group.LAYERS)
"""The channel groups by name; a group may use those before it, and all may use the density."""

LAYERS: Mapping[str, Layer] = PluginRegistry(_LAYERS, Group.LAYERS)
"""The layers by name."""

_SUBJECTS = {
    "frames": ("What the frames saw", "density peak max variance count seen_share sure_share"),
    "terrain": (
        "The ground",
        "ground ground_sigma height slope aspect roughness step drop traversability",
    ),
    "standing": ("What stands on it", "occupancy max_height clearance"),
    "time": (
        "Over time",
        "sessions persistence static seasonal passing lasting moved",
    ),
}
"""What layers tell: its title, and their names."""

ALL_LAYERS = "all"


def register_group(group: ChannelGroup) -> None:
    """Make a channel group known. Its layers are folded from the frames, unless a map keeps them.

    Raises ConfigError when its name, or that of a channel, is taken, and when what it declares does
    not go together.
    """
    taken = {name for other in _GROUPS.values() for name in channel_names(other)}
    twice = taken.intersection(channel_names(group))
    if group.name in _GROUPS or twice:
        what = f"channel {quoted(min(twice))}" if twice else f"channel group {quoted(group.name)}"
        raise ConfigError(f"There is a {what} already; give it another name.")
    sources = (group.fold is not None) + (group.of_session is not None)
    if not group.name.isidentifier() or sources != (0 if group.derived else 1):
        raise ConfigError(
            f"The channel group {quoted(group.name)} needs a plain name, and either a fold over "
            "frames or a function of a session's cells; neither, if it has no channels."
        )
    if group.blocks and group.expected is not None:
        raise ConfigError(
            f"The channel group {quoted(group.name)} has values for blocks of cells, so that they "
            "cannot be expected from the weight and the sum of a cell; leave `expected` out."
        )
    missing = [name for name in group.follows_from if name not in _GROUPS]
    if missing or bool(group.follows_from) != group.derived:
        raise ConfigError(
            f"The channel group {quoted(group.name)} must say, if and only if it has no channels, "
            f"from which groups it follows, and these must be there{': ' * bool(missing)}"
            f"{', '.join(missing)}."
        )
    _GROUPS[group.name] = group


def register_layer(layer: Layer) -> None:
    """Make a layer known; ConfigError for a name that is taken, or a group that is not there."""
    if layer.name in _LAYERS or layer.name == "observed":
        raise ConfigError(f"There is a layer {quoted(layer.name)} already; give it another name.")
    for name in layer.groups:
        if name not in _GROUPS:
            raise ConfigError(
                f"The layer {quoted(layer.name)} reads the channel group {quoted(name)}, which is "
                "not there; register the group first."
            )
    _LAYERS[layer.name] = layer


def unregister(name: str) -> None:
    """Forget the layer and the channel group of a name, as far as there are such."""
    _LAYERS.pop(name, None)
    _GROUPS.pop(name, None)


def check_layers(names: Iterable[str]) -> tuple[str, ...]:
    """The names, once it is sure that there are such layers."""
    wanted = tuple(names)
    for name in wanted:
        if name not in LAYERS:
            raise ConfigError(f"There is no layer {quoted(name)}; there are {', '.join(LAYERS)}.")
    return wanted


def layers_by_subject() -> dict[str, list[str]]:
    """The names of all layers by what they tell; those of other packages come last."""
    found = {title: names.split() for title, names in _SUBJECTS.values()}
    placed = {name for names in found.values() for name in names}
    others = [name for name in LAYERS if name not in placed]
    return found | {"Of other packages": others} if others else found


def kept_groups(layers: Iterable[str] = ()) -> tuple[str, ...]:
    """The channel groups that tiles hold: the core, and those of some layers, which are named, or
    their subjects (`frames`, `terrain`, `standing`, `time`), or `all`. All other layers are folded
    from the frames when they are read. ConfigError for a name that is none of these."""
    subjects = {subject: names.split() for subject, (_, names) in _SUBJECTS.items()}
    subjects[ALL_LAYERS] = list(LAYERS)
    wanted = set(CORE_GROUPS)
    for layer in chain.from_iterable(subjects.get(name, [name]) for name in layers):
        if layer not in LAYERS:
            raise ConfigError(
                f"There is no layer {quoted(layer)} to keep; give {', '.join(subjects)}, or one of "
                f"{', '.join(LAYERS)}."
            )
        wanted.update(LAYERS[layer].groups)
    return tuple(name for name, group in GROUPS.items() if name in wanted and not group.derived)


def groups_of(layers: Iterable[str]) -> tuple[str, ...]:
    """The channel groups that layers are made of, in the order of their registration."""
    wanted = {name for layer in layers for name in LAYERS[layer].groups} | {density.GROUP.name}
    return tuple(name for name in GROUPS if name in wanted)


def channel_names(group: ChannelGroup) -> tuple[str, ...]:
    """All channels of a group, those of overviews included."""
    return (*(own.name for own in group.channels), *(extra.name for extra in group.overview))


for _group in (
    density.GROUP,
    variance.GROUP,
    count.GROUP,
    highest.GROUP,
    sessions.GROUP,
    lasting.GROUP,
    height.GROUP,
    ground.GROUP,
    relief.GROUP,
    occupancy.GROUP,
    drop.GROUP,
    standing.GROUP,
    moved.GROUP,
):
    register_group(_group)

for _layer in (
    density.DENSITY,
    count.COUNT,
    variance.VARIANCE,
    highest.MAX,
    sessions.SESSIONS,
    sessions.PERSISTENCE,
    lasting.STATIC,
    lasting.SEASONAL,
    lasting.PASSING,
    lasting.LASTING,
    moved.MOVED,
    height.HEIGHT,
    ground.GROUND,
    ground.SIGMA,
    ground.SLOPE,
    ground.ASPECT,
    relief.ROUGHNESS,
    relief.STEP,
    drop.DROP,
    standing.MAX_HEIGHT,
    standing.CLEARANCE,
    traversability.TRAVERSABILITY,
    occupancy.OCCUPANCY,
    density.PEAK,
    density.SEEN_SHARE,
    drop.SURE_SHARE,
):
    register_layer(_layer)

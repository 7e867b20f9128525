from __future__ import annotations

from dataclasses import replace

import pytest

from fieldgrid.core import ConfigError
from fieldgrid.maps import (
    GROUPS,
    LAYERS,
    Channel,
    channel_names,
    check_layers,
    groups_of,
    register_group,
    register_layer,
    unregister,
)


def test_every_built_in_layer_says_what_it_is() -> None:
    assert next(iter(LAYERS)) == "density"
    for name, layer in LAYERS.items():
        assert layer.name == name
        assert layer.meaning
        assert len(layer.colours.stops) >= 2
        assert set(layer.groups) <= set(GROUPS)
        assert layer.dtype in ("uint8", "uint16", "uint32", "float32")
    names = [name for group in GROUPS.values() for name in channel_names(group)]
    assert len(names) == len(set(names))


def test_what_is_taken_or_missing_is_refused() -> None:
    group, layer = GROUPS["variance"], LAYERS["variance"]
    with pytest.raises(ConfigError, match="channel 'squares' already"):
        register_group(replace(group, name="again"))
    with pytest.raises(ConfigError, match="channel group 'variance' already"):
        register_group(replace(group, channels=(Channel("other"),)))
    with pytest.raises(ConfigError, match="needs a plain name, and either"):
        register_group(replace(group, name="x", channels=(Channel("x"),), fold=None))
    with pytest.raises(ConfigError, match="'guessed' has values for blocks"):
        register_group(replace(group, name="guessed", channels=(Channel("x"),), blocks=True))
    assert "guessed" not in GROUPS
    with pytest.raises(ConfigError, match="layer 'variance' already"):
        register_layer(layer)
    with pytest.raises(ConfigError, match="channel group 'soil', which is not there"):
        register_layer(replace(layer, name="soil", groups=("soil",)))
    with pytest.raises(ConfigError, match="no layer 'soil'; there are density"):
        check_layers(["soil"])
    assert "soil" not in LAYERS


def test_a_layer_that_is_forgotten_can_be_registered_again() -> None:
    layer = replace(LAYERS["variance"], name="spread")
    register_layer(layer)
    try:
        assert groups_of(["spread"]) == ("density", "variance")
    finally:
        unregister("spread")
    assert "spread" not in LAYERS

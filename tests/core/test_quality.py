"""Qualities and their names."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from fieldgrid.core import ConfigError, GateLimits, Quality


@pytest.mark.parametrize("quality", Quality)
def test_a_name_and_a_code_lead_back_to_the_quality(quality: Quality) -> None:
    assert Quality.named(quality.label) is Quality.named(str(quality)) is quality
    if quality is not Quality.UNKNOWN:
        assert Quality.named(f" {int(quality)} ") is quality


def test_a_name_that_is_none_is_told_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match=r"'rtk'.*rtk-fixed, rtk-float"):
        Quality.named("rtk")


def test_settings_take_names_and_codes() -> None:
    limits = GateLimits.model_validate({"allowed_quality": ["rtk-fixed", "RTK float", 2]})
    assert limits.allowed_quality == {4, 5, 2}
    assert Quality.UNKNOWN in GateLimits().allowed_quality
    assert Quality.ESTIMATED not in GateLimits().allowed_quality
    for wrong in (["splendid"], [12], []):
        with pytest.raises((ValidationError, ConfigError)):
            GateLimits.model_validate({"allowed_quality": wrong})

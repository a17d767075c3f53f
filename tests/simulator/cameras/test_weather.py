"""Weather: its names and what each draws."""

import pytest

from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway.weather import WEATHERS, weather_named


def test_every_name_has_a_weather():
    assert WEATHERS[0] == "clear_noon"
    for name in WEATHERS:
        weather = weather_named(name)
        assert weather.name == name
        assert sum(part * part for part in weather.sun) == pytest.approx(1.0, abs=1e-3)


def test_unknown_weather_is_refused_with_the_nearest_name():
    with pytest.raises(UserError, match="did you mean 'cloudy'"):
        weather_named("clowdy")


def test_a_scene_is_at_clear_noon_unless_told(street, scene_of):
    assert scene_of(street, []).weather is weather_named("clear_noon")

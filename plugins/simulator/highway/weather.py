"""Weather and light: what the cameras need to know of the sky. Truth does not depend on it."""

from __future__ import annotations

from dataclasses import dataclass

from me3bev_cli.errors import unknown_name

WEATHERS: tuple[str, ...] = ("clear_noon", "cloudy", "dusk", "night", "rain", "fog")
"""Names of all kinds, the default one first."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Weather:
    """A kind of weather and light. Colours are r, g, b in 0..255; light is per channel, 1 shows a colour as it is."""

    name: str
    sun: Triple
    """Unit vector towards the sun in the world frame."""
    ambient: Triple
    """Light from everywhere."""
    direct: Triple
    """Light of the sun on a face turned to it."""
    zenith: Triple
    horizon: Triple
    haze: Triple
    """What things fade into."""
    haze_distance: float
    """Metres after which 37 % of a thing's contrast is left."""
    shadow: float
    """Light on the ground in the shade, as a share of that beside it; 1: no shadows."""
    cast: bool
    """Whether shadows fall to the side away from the sun; else they lie under things only."""
    wetness: float = 0.0
    """0..1; wet asphalt is darker and shines."""
    lamps: bool = False
    """Whether vehicles' and street lamps are lit."""
    headlights: float = 0.0
    """Strength of the ego's own beam on what it hits."""
    lit_windows: float = 0.0
    """Share of windows with light behind them."""
    glare: float = 0.0
    """Strength of the glare around lamps."""
    streaks: int = 0
    """Streaks of rain in a camera's picture of 128 x 352 pixels."""


_KINDS = (
    Weather(
        "clear_noon",
        sun=(0.35, 0.55, 0.7583),
        ambient=(0.62, 0.64, 0.68),
        direct=(0.52, 0.5, 0.46),
        zenith=(86.0, 134.0, 200.0),
        horizon=(202.0, 214.0, 226.0),
        haze=(198.0, 208.0, 219.0),
        haze_distance=420.0,
        shadow=0.56,
        cast=True,
    ),
    Weather(
        "cloudy",
        sun=(0.2, 0.3, 0.9327),
        ambient=(0.72, 0.73, 0.75),
        direct=(0.16, 0.16, 0.16),
        zenith=(150.0, 156.0, 164.0),
        horizon=(190.0, 194.0, 198.0),
        haze=(184.0, 188.0, 193.0),
        haze_distance=260.0,
        shadow=0.72,
        cast=False,
    ),
    Weather(
        "dusk",
        sun=(-0.83, 0.5, 0.2473),
        ambient=(0.42, 0.41, 0.5),
        direct=(0.72, 0.42, 0.2),
        zenith=(58.0, 74.0, 122.0),
        horizon=(244.0, 158.0, 96.0),
        haze=(190.0, 142.0, 118.0),
        haze_distance=300.0,
        shadow=0.68,
        cast=True,
        lamps=True,
        headlights=0.12,
        lit_windows=0.25,
        glare=0.5,
    ),
    Weather(
        "night",
        sun=(0.3, 0.2, 0.9327),
        ambient=(0.17, 0.18, 0.24),
        direct=(0.03, 0.03, 0.05),
        zenith=(6.0, 9.0, 20.0),
        horizon=(30.0, 32.0, 46.0),
        haze=(22.0, 24.0, 34.0),
        haze_distance=260.0,
        shadow=0.75,
        cast=False,
        lamps=True,
        headlights=1.0,
        lit_windows=0.35,
        glare=0.9,
    ),
    Weather(
        "rain",
        sun=(0.2, 0.3, 0.9327),
        ambient=(0.55, 0.57, 0.6),
        direct=(0.08, 0.08, 0.08),
        zenith=(104.0, 110.0, 118.0),
        horizon=(150.0, 155.0, 160.0),
        haze=(146.0, 151.0, 156.0),
        haze_distance=130.0,
        shadow=0.7,
        cast=False,
        wetness=1.0,
        lamps=True,
        headlights=0.1,
        lit_windows=0.15,
        glare=0.45,
        streaks=110,
    ),
    Weather(
        "fog",
        sun=(0.2, 0.3, 0.9327),
        ambient=(0.7, 0.71, 0.72),
        direct=(0.06, 0.06, 0.06),
        zenith=(186.0, 189.0, 192.0),
        horizon=(194.0, 197.0, 199.0),
        haze=(194.0, 197.0, 199.0),
        haze_distance=50.0,
        shadow=0.8,
        cast=False,
        wetness=0.25,
        lamps=True,
        lit_windows=0.1,
        glare=0.5,
    ),
)
_BY_NAME = {kind.name: kind for kind in _KINDS}
CLEAR_NOON = _KINDS[0]


def weather_named(name: str) -> Weather:
    """The kind of that name.

    Raises:
        UserError: for a name that is not in `WEATHERS`.
    """
    if name not in _BY_NAME:
        raise unknown_name("weather", name, WEATHERS, where="weather")
    return _BY_NAME[name]

"""Colours of a picture's ground, such as a map's, and of characters on it, for dark and light terminals."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable

_DARK = 128
"""Brightness of a background, below which it is dark."""
_GROUND = 0.16
"""Part of the foreground in the ground that stands out: little, as thin dots have to be read on it."""
_WALL = 0.42
"""The same of a wall behind dots, between ground and foreground."""
_COST_ON_DARK, _COST_ON_LIGHT = 0.5, 0.3
"""Part of a cost's own colour: on these, dots in the colours of the themes have a contrast of 3 to 1 at least."""
_FAINT = 70.0
"""Difference of brightness, of 255, between a colour and the background, below which it is hard to see."""
_LETHAL = "#ff0000"
_SCAN = "#af005f", "#ff87ff"
"""On light and on dark: these stand out from ground, walls, costs and the colours of the themes."""

Rgb = tuple[int, int, int]


class Paper(NamedTuple):
    """A terminal's colours, with which tints are mixed."""

    background: Rgb
    foreground: Rgb

    @classmethod
    def of(cls, background: str, foreground: str) -> Paper:
        """Return the paper of two colours as ``#rrggbb``."""
        return cls(_rgb(background), _rgb(foreground))

    @property
    def is_dark(self) -> bool:
        return sum(self.background) < 3 * _DARK

    @property
    def own(self) -> str:
        """The background as ``#rrggbb``."""
        return _hex(self.background)

    def ink(self, style: str) -> str:
        """Return the colour of a character as ``#rrggbb``, or an empty string if the theme has one for the style."""
        if style == "scan":
            return _SCAN[self.is_dark]
        if not style.startswith("#"):
            return ""
        # A node may colour its markers white, which cannot be read on white.
        faint = abs(_brightness(_rgb(style)) - _brightness(self.background)) < _FAINT
        return self._mixed(_rgb(style), 0.5, self.foreground) if faint else style

    def colour(self, tint: str) -> str:
        """Return the colour of a tint as ``#rrggbb``, or an empty string if it is the terminal's own background.

        Args:
            tint: a style of `rsb_extras.pictures.picture.STYLES`, or a colour.
        """
        if tint.startswith("#"):
            return self._mixed(_rgb(tint), _COST_ON_DARK if self.is_dark else _COST_ON_LIGHT)
        if tint == "lethal":
            return self._mixed(_rgb(_LETHAL), _WALL)
        # Free ground is the lighter one of the two, as on paper maps.
        part = {"occupied": _WALL, "free": _GROUND * self.is_dark, "unknown": _GROUND * (not self.is_dark)}.get(tint, 0)
        return self._mixed(self.foreground, part) if part else ""

    def _mixed(self, colour: Rgb, part: float, base: Rgb | None = None) -> str:
        both = zip(self.background if base is None else base, colour, strict=True)
        return _hex(round(own + (other - own) * part) for own, other in both)


def _brightness(colour: Rgb) -> float:
    red, green, blue = colour
    return 0.21 * red + 0.72 * green + 0.07 * blue  # Rec. 709


def _hex(colour: Iterable[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _rgb(colour: str) -> Rgb:
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue

"""What an operator's keys change in the wish for a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import msgspec

from rsb_extras.pictures.picture import MOST_RATE, Series

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_extras.pictures.picture import Cells, Pixels, Wish

    _Change: TypeAlias = Callable[[Wish, Cells | Pixels | Series | None, float], Wish]
    """Returns another wish, by the picture in sight and the key's own number."""

_RATES = (0.2, 0.5, 1.0, 2.0, 5.0, MOST_RATE)
_WAYS = ("", "plot", "tree")
_SPANS = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
"""s of a plot's time axis."""


def _way(wish: Wish, _: object, __: float) -> Wish:
    how = _WAYS[(_WAYS.index(wish.how) + 1) % len(_WAYS)] if wish.how in _WAYS else ""
    return msgspec.structs.replace(wish, how=how)


def _zoom(wish: Wish, content: Cells | Pixels | Series | None, factor: float) -> Wish:
    if not isinstance(content, Series):
        return msgspec.structs.replace(wish, zoom=max(0.05, min(200.0, wish.zoom * factor)))
    longer = [each for each in _SPANS if each > wish.seconds]
    shorter = [each for each in _SPANS if each < wish.seconds]
    seconds = (shorter or _SPANS[:1])[-1] if factor > 1 else (longer or _SPANS[-1:])[0]
    return msgspec.structs.replace(wish, seconds=seconds)


def _tilt(wish: Wish, _: object, degrees: float) -> Wish:
    return msgspec.structs.replace(wish, tilt=max(0.0, min(90.0, wish.tilt + degrees)))


def _colour(wish: Wish, _: object, __: float) -> Wish:
    return msgspec.structs.replace(wish, colour="intensity" if wish.colour == "height" else "height")


def _reset(wish: Wish, _: object, __: float) -> Wish:
    return msgspec.structs.replace(wish, zoom=1.0, x=0.0, y=0.0, tilt=0.0)


def _rate(wish: Wish, _: object, step: float) -> Wish:
    at = _RATES.index(wish.rate) + int(step)
    return msgspec.structs.replace(wish, rate=_RATES[max(0, min(len(_RATES) - 1, at))])


CHANGES: Mapping[str, _Change] = {
    "way": _way,  # another kind of picture
    "zoom": _zoom,  # less, larger; of a plot, a shorter time
    "tilt": _tilt,
    "colour": _colour,
    "reset": _reset,  # the whole picture from above
    "rate": _rate,
}

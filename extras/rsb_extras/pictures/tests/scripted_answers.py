"""Answers to the questions for pictures that documents show."""

from __future__ import annotations

from typing import Any

from tests.console.scripted import NOW

from rsb_extras.pictures.look_requests import LookAtTopics
from rsb_extras.pictures.picture import Cells, Curve, Picture, Pixels, Series, Viewed

_IMAGE, _MAP = Pixels(1, 2, b"\xff\0\0\0\xff\0"), Cells(("▲",))
_CURVES = Series(NOW, 0.1, (Curve("x", (1.0, None), (2.0, None), 2.0, 1.5),))


def _looked(command: LookAtTopics) -> Viewed:
    content: Pixels | Cells | Series = _CURVES if "plot" in command.wish.how or command.wish.fields else _MAP
    return Viewed(Picture(content=_IMAGE if "image" in command.topics[0] else content))


ANSWERS: dict[Any, Any] = {LookAtTopics: _looked}

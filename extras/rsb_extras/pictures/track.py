"""The track of sensor_msgs/msg/NavSatFix, in metres around its newest position, north up."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, number

if TYPE_CHECKING:
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

POSITIONS = 5000
"""Positions that are remembered; when there are more, every second one is forgotten. A round figure."""
_EARTH = 6_378_137.0
"""m, equatorial radius (WGS 84)."""
_LEAST_SPAN = 2.0  # m; a round figure
_STATUS = {-1: "no fix", 0: "fix", 1: "satellite-based fix", 2: "ground-based fix"}


class TrackProblem(Wording):
    """The reason why there is no track."""

    NO_FIX = "no valid position so far"


class TrackView(View):
    """Draws the way since the view began."""

    def __init__(self) -> None:
        self._positions: list[tuple[float, float]] = []
        self._note = ""

    def receive(self, received: TakenMessage) -> None:
        latitude, longitude = number(received.message, "latitude"), number(received.message, "longitude")
        status = number(received.message, "status.status")
        self._note = _STATUS.get(int(status), "") if math.isfinite(status) else ""
        if abs(latitude) <= 90 and abs(longitude) <= 360 and status != -1:  # false for NaN, too
            self._positions.append((latitude, longitude))
            self._note += f", {latitude:.6f}, {longitude:.6f}"
        if len(self._positions) > POSITIONS:
            # From the end: the newest one, around which all is drawn, stays.
            del self._positions[-2::-2]

    def draw(self, wish: Wish) -> Drawn:
        if not self._positions:
            raise UndrawableError(TrackProblem.NO_FIX())
        latitude, longitude = self._positions[-1]
        narrow = math.cos(math.radians(latitude))
        metres = math.radians(1) * _EARTH
        points = [
            ((east - longitude) * metres * narrow, (north - latitude) * metres) for north, east in self._positions
        ]
        span = max(_LEAST_SPAN, *(max(abs(x), abs(y)) for x, y in points))
        canvas = Canvas(wish.width, wish.height)
        dot = span * 2.1 / min(wish.width * Canvas.ACROSS, wish.height * Canvas.DOWN) / wish.zoom
        middle_x = round(wish.width * Canvas.ACROSS * (0.5 - wish.x))
        middle_y = round(wish.height * Canvas.DOWN * (0.5 + wish.y))
        dots = [(middle_x + round(x / dot), middle_y - round(y / dot)) for x, y in points]
        for start, end in itertools.pairwise(dots):
            canvas.line(*start, *end, "path")
        canvas.write(middle_x // Canvas.ACROSS, middle_y // Canvas.DOWN, "◆", "robot")
        canvas.scale_bar(dot * Canvas.ACROSS)
        canvas.write(canvas.width - 2, 0, "N", "axis")
        return Drawn(canvas.cells(), (self._note,))

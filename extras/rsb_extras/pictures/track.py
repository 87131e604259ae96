"""The track of sensor_msgs/msg/NavSatFix, in metres around its newest position, north up."""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, floats, number

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

POSITIONS = 5000
"""Positions that are remembered; when there are more, every second one is forgotten. A round figure."""
_EARTH = 6_378_137.0
"""m, equatorial radius (WGS 84)."""
_LATELY, _LEAST_SECONDS = 20, 0.5
"""Positions and s over which the speed is computed: round figures."""
_LEAST_SPAN = 2.0  # m; a round figure
_STATUS = {-1: "no fix", 0: "fix", 1: "satellite-based fix", 2: "ground-based fix"}


class TrackProblem(Wording):
    """The reason why there is no track."""

    NO_FIX = "no valid position so far"


class TrackView(View):
    """Draws the way since the view began."""

    def __init__(self) -> None:
        self._positions: list[tuple[float, float]] = []
        self._lately: deque[tuple[float, tuple[float, float]]] = deque(maxlen=_LATELY)
        """The newest positions with their times, for the speed."""
        self._deviation = 0.0
        """m, of the newest position to the east or north, whichever is larger; or 0 if unknown."""
        self._note = ""

    def receive(self, received: TakenMessage) -> None:
        latitude, longitude = number(received.message, "latitude"), number(received.message, "longitude")
        status = number(received.message, "status.status")
        self._note = _STATUS.get(int(status), "") if math.isfinite(status) else ""
        if abs(latitude) <= 90 and abs(longitude) <= 360 and status != -1:  # false for NaN, too
            self._positions.append((latitude, longitude))
            self._lately.append((received.time, (latitude, longitude)))
            self._note += f", {latitude:.6f}, {longitude:.6f}"
            self._deviation = _deviation(received.message)
        if len(self._positions) > POSITIONS:
            # From the end: the newest one, around which all is drawn, stays.
            del self._positions[-2::-2]

    def draw(self, wish: Wish) -> Drawn:
        if not self._positions:
            raise UndrawableError(TrackProblem.NO_FIX())
        points = [_metres(self._positions[-1], each) for each in self._positions]
        span = max(_LEAST_SPAN, *(max(abs(x), abs(y)) for x, y in points))
        canvas = Canvas.of(wish)
        width, height = canvas.width * Canvas.ACROSS, canvas.height * Canvas.DOWN
        dot = span * 2.1 / min(width, height) / wish.zoom
        middle_x = round(width * (0.5 - wish.x))
        middle_y = round(height * (0.5 + wish.y))
        dots = [(middle_x + round(x / dot), middle_y - round(y / dot)) for x, y in points]
        for start, end in itertools.pairwise(dots):
            canvas.line(*start, *end, "path")
        if self._deviation:
            _circle(canvas, middle_x, middle_y, self._deviation / dot)
        half = canvas.fine // 2
        canvas.write(middle_x // Canvas.ACROSS - half, middle_y // Canvas.DOWN - half, "◆", "robot")
        canvas.scale_bar(dot * Canvas.ACROSS)
        canvas.write(canvas.width - 2 * canvas.fine, 0, "N", "axis")
        about = [self._note, f"± {self._deviation:.2g} m" if self._deviation else "", self._speed()]
        return Drawn(canvas.cells(), tuple(filter(None, about)))

    def _speed(self) -> str:
        """Return the speed over the last positions, or an empty string."""
        if len(self._lately) < 2:
            return ""
        (before, first), (now, last) = self._lately[0], self._lately[-1]
        return f"{math.hypot(*_metres(first, last)) / (now - before):.1f} m/s" if now - before > _LEAST_SECONDS else ""


def _metres(origin: tuple[float, float], place: tuple[float, float]) -> tuple[float, float]:
    """Return how far a place lies to the east and north of another, both in degrees of latitude and longitude."""
    metres = math.radians(1) * _EARTH
    narrow = math.cos(math.radians(origin[0]))
    return (place[1] - origin[1]) * metres * narrow, (place[0] - origin[0]) * metres


def _deviation(message: Message) -> float:
    covariance = floats(message, "position_covariance", 9)
    variances = [each for each in (covariance[0::4][:2] if len(covariance) == 9 else []) if 0 < each < _EARTH]
    return math.sqrt(max(variances)) if variances and number(message, "position_covariance_type") > 0 else 0.0


def _circle(canvas: Canvas, x: int, y: int, radius: float) -> None:
    count = int(min(720, max(16, radius * 4)))
    for at in range(count):
        angle = math.tau * at / count
        across, down = round(x + radius * math.cos(angle)), round(y - radius * math.sin(angle))
        if canvas.is_free(across, down):
            canvas.dot(across, down, "dim")

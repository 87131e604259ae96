"""Messages by hand for the screens: published with tickets, and the fields of goals and velocities."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.api import EngineError
from rsb_bridge.config.yaml_text import inline
from rsb_bridge.model.by_hand import OLD_AFTER
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.by_hand import Published
    from rsb_bridge.model.pictures import Scale

POSE, TWIST, TWIST_STAMPED = (f"geometry_msgs/msg/{name}" for name in ("PoseStamped", "Twist", "TwistStamped"))
TRIES = 3
"""Tickets for one message: a slow way to the bridge may make one too old."""
_FAR = 1e4
"""Cells, beyond any picture."""


class ByHandText(Wording):
    """Texts about messages by hand."""

    NO_SESSION = "no session runs"
    TOO_SLOW = "not published on {topic}: the bridge answers too slowly, or this console stood still"


async def publish(engine: EngineApi | None, topic: str, fields: str, type_name: str = "", ticket: int = 0) -> Published:
    """Publish a message, with a new ticket if the one before has become too old.

    Raises:
        EngineError: the engine refuses it.
    """
    if engine is None:
        raise EngineError(ByHandText.NO_SESSION())
    began = Clock.steady()
    for _ in range(TRIES):
        published = await asyncio.wrap_future(engine.publish(topic, fields, type_name, ticket=ticket))
        if published.is_done:
            return published
        # A console that stood still would get a new ticket for an old command, and a ticket would prove nothing.
        if Clock.steady() - began > OLD_AFTER:
            break
        ticket = published.ticket
    raise EngineError(ByHandText.TOO_SLOW(topic=topic))


class Goal(NamedTuple):
    """A pose on a map.

    Attributes:
        heading: rad, counterclockwise from the x axis.
    """

    frame: str
    x: float
    y: float
    heading: float = 0.0

    @classmethod
    def at(cls, scale: Scale, column: float, row: float) -> Goal:
        """Return the pose at a place on a map, in cells from its upper left corner."""
        return cls(scale.frame, scale.left + column * scale.column, scale.top - row * scale.row)

    def cell(self, scale: Scale) -> tuple[int, int]:
        """Return the column and the row of its cell on a map, which may lie outside."""
        cells = (self.x - scale.left) / scale.column, (scale.top - self.y) / scale.row
        # A peer may send a map whose cells have hardly any size, and `floor` refuses infinity.
        column, row = (math.floor(max(-_FAR, min(_FAR, each))) for each in cells)
        return column, row

    def moved(self, scale: Scale, columns: int, rows: int) -> Goal:
        """Return it some cells further to the right and down."""
        return self._replace(x=self.x + columns * scale.column, y=self.y - rows * scale.row)

    def turned(self, degrees: float) -> Goal:
        """Return it turned counterclockwise."""
        return self._replace(heading=math.remainder(self.heading + math.radians(degrees), math.tau))

    @property
    def arrow(self) -> str:
        """The character that points to its heading."""
        return "→↗↑↖←↙↓↘"[round(self.heading / math.tau * 8) % 8]

    def fields(self) -> str:
        """Return it as the fields of a ``geometry_msgs/msg/PoseStamped``, in YAML."""
        frame = inline(self.frame, '"')
        z, w = math.sin(self.heading / 2), math.cos(self.heading / 2)
        return (
            f"header: {{stamp: now, frame_id: {frame}}}\n"
            f"pose:\n  position: {{x: {self.x:.3f}, y: {self.y:.3f}}}\n"
            f"  orientation: {{z: {z:.6f}, w: {w:.6f}}}\n"
        )


def velocity(type_name: str, forward: float, turn: float) -> str:
    """Return a velocity as the fields of a Twist or a TwistStamped, in YAML.

    Args:
        turn: rad/s, counterclockwise.
    """
    twist = f"linear: {{x: {forward:.3f}}}, angular: {{z: {turn:.3f}}}"
    return f"{{header: auto, twist: {{{twist}}}}}" if type_name == TWIST_STAMPED else f"{{{twist}}}"

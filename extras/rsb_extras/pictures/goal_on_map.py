"""A goal on a map, which the operator moves and turns, and its fields as a message."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.config.yaml_text import inline

if TYPE_CHECKING:
    from rsb_extras.pictures.picture import Scale

POSE = "geometry_msgs/msg/PoseStamped"
_FAR = 1e4
"""Cells, beyond any picture."""


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

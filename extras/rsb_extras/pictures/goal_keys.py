"""The goal that an operator sets on a map with keys and clicks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_extras.pictures.cell_image import Marked
from rsb_extras.pictures.goal_on_map import Goal
from rsb_extras.pictures.picture_rows import Part, with_mark

if TYPE_CHECKING:
    from rsb_extras.pictures.picture import Scale
    from rsb_extras.pictures.picture_rows import Row

_TURN = 15.0
"""Degrees by which a key turns a goal."""


class GoalText(Wording):
    PLACE = "GOAL at {x:.2f}, {y:.2f} m in {frame}: arrows move it, enter turns it, esc leaves"
    HEADING = "GOAL at {x:.2f}, {y:.2f} m, heading {degrees:.0f}°: arrows turn it, enter publishes, esc leaves"


class GoalKeys:
    """The goal of one map, first its place and then its heading.

    Attributes:
        goal: or None as long as the operator sets none.
    """

    def __init__(self) -> None:
        self.goal: Goal | None = None
        self._turns = False

    def begin(self, scale: Scale, width: float, height: float) -> None:
        """Begin in the middle of a map of so many cells."""
        self.goal, self._turns = Goal.at(scale, width / 2, height / 2), False

    def put(self, scale: Scale, column: int, row: int) -> None:
        """Put it into a cell, unless it only turns now."""
        if self.goal is not None and not self._turns:
            self.goal = Goal.at(scale, column + 0.5, row + 0.5)

    def move(self, scale: Scale, columns: int, rows: int) -> None:
        """Move it by cells, or turn it."""
        if self.goal is not None:
            turned = self.goal.turned(-columns * _TURN)
            self.goal = turned if self._turns else self.goal.moved(scale, columns, rows)

    def go_on(self) -> str:
        """Go on to its heading; after that, end and return the fields of its message, else an empty string."""
        if self.goal is None or not self._turns:
            self._turns = True
            return ""
        fields, self.goal = self.goal.fields(), None
        return fields

    def mark(self, scale: Scale | None) -> Marked | None:
        """Return its sign on a map; on a map of another frame it ends, as its coordinates mean another place there."""
        if scale is None or self.goal is None:
            return None
        if self.goal.frame != scale.frame:
            self.goal = None
            return None
        return Marked(*self.goal.cell(scale), self.goal.arrow)

    def marked(self, rows: list[Row], scale: Scale | None, width: int) -> list[Row]:
        """Return a map in characters with its sign."""
        if (mark := self.mark(scale)) is None:
            return rows
        return with_mark(rows, mark.column, mark.row, Part(mark.sign, "goal"), width)

    def text(self) -> str:
        """Return where it is, and what the keys do, or an empty string."""
        if (goal := self.goal) is None:
            return ""
        text = GoalText.HEADING if self._turns else GoalText.PLACE
        return text(x=goal.x, y=goal.y, frame=goal.frame, degrees=math.degrees(goal.heading))

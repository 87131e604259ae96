"""Whether messages may cross a route: what `Route.crossing` and `Arming.crossing` answer to all who ask."""

from __future__ import annotations

from enum import Enum, auto


class Crossing(Enum):
    """Whether messages may cross a route now, or the reason why not; of several reasons, the first in this order."""

    LOOP = auto()
    """They would come back to where they are from."""
    DISARMING = auto()
    """It is not armed any more, and the other side may still publish earlier messages."""
    PAUSED = auto()
    """An operator of either side has paused it."""
    DISARMED = auto()
    """It has to be armed, and is not, or no longer."""
    ASKED = auto()
    """An operator of this side has armed it, and the other side has not agreed yet."""
    BEGINS = auto()
    """Both sides have agreed that it is armed, and have not answered each other in time yet."""
    NOT_OPEN = auto()
    """Only the other side's consent or a channel is missing."""
    RESTING = auto()
    """It is lazy, and nobody on the receiving side wants its messages (`rsb_bridge.route.lazy`)."""
    UNHEARD = auto()
    """It is armed and set up, and nothing passes for now: the two sides have not heard each other for a second."""
    YES = auto()

    flows: bool
    """Whether messages are due. That the sides do not hear each other for a moment concerns the gates alone."""

    @property
    def is_held_back(self) -> bool:
        """Whether it is the will of operators, or a loop, or nobody's wish, that nothing crosses."""
        return not self.flows and self is not Crossing.NOT_OPEN

    @property
    def is_unarmed(self) -> bool:
        """Whether it has to be armed and is not; an arming that only begins counts as none."""
        return self in _UNARMED


for _each in Crossing:  # a property would be asked ten times for a route's verdict
    _each.flows = _each in (Crossing.YES, Crossing.UNHEARD)
_UNARMED = (Crossing.DISARMING, Crossing.DISARMED, Crossing.ASKED, Crossing.BEGINS)

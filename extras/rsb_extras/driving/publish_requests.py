"""Commands that publish by hand: a message to begin with, and a message to publish; their results."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import Command, Effect, Right
from rsb_bridge.model.audience import NOBODY, Audience
from rsb_bridge.model.by_hand import TICKET_LIFE

REST_AFTER, LONGEST_REST = 0.5, 2.0
"""s, as usual and at most, after which an engine publishes by itself the message that ends a motion.

Not measured. A robot goes on for so long without its console; less, and each stall of a Wi-Fi stops it for a moment.
"""


class Draft(msgspec.Struct, frozen=True, omit_defaults=True):
    """A message to begin with.

    Attributes:
        fields: of the message, as YAML.
        is_last: whether they are from a message that has just passed, and not the type's defaults.
    """

    type_name: str
    fields: str
    is_last: bool = False


class Published(msgspec.Struct, frozen=True, omit_defaults=True):
    """The result of publishing a message by hand.

    Attributes:
        is_done: whether the message was published. If not, the command had no valid ticket: repeat it with this one.
        ticket: for the next message.
        audience: the subscriptions in this domain.
        links: names of the links that take it to the other side.
    """

    is_done: bool
    ticket: int = 0
    type_name: str = ""
    audience: Audience = NOBODY
    links: tuple[str, ...] = ()


class DraftMessage(Command[Draft], frozen=True, tag="draft"):
    """Make a message for an operator to change: one that passes soon, or the type's defaults."""

    right = Right.LOOK
    refreshes = False
    cancellable = True
    topic: str  # its name on this side
    type_name: str = ""  # its type, or an empty string if the topic has one already


class Publish(Command[Published], frozen=True, tag="publish"):
    """Publish a message in this side's domain, as a node would; routes take it to the other side.

    A topic that has to be armed takes it only while it is armed, and with a ticket that is younger than
    `rsb_bridge.model.by_hand.TICKET_LIFE`: so nothing is published that waited in a frozen process or a tunnel. Each
    answer brings a ticket.
    """

    always = Effect.MOVES
    refreshes = False
    cancellable = True
    topic: str  # its name on this side
    fields: str  # of the message, as YAML; missing ones have their defaults
    type_name: str = ""  # its type, or an empty string if the topic has one already
    ticket: int = 0  # from the answer before, or 0
    rest: str = ""
    """Fields of a message that is published unless the next one comes in time, or an empty string for none: a robot
    that is driven stops if its operator's console is gone. Only for topics that have to be armed and limit the age of
    messages."""
    rest_after: Annotated[float, Meta(gt=0, le=LONGEST_REST)] = REST_AFTER  # s in which the next message is due
    reduce: bool = False
    """Whether a velocity beyond the topic's limits is reduced to them, and not refused: for one who drives by keys, and
    sees what is reduced."""

    @property
    def life(self) -> float:
        """Seconds for which it may be on its way: a velocity is not wanted after a moment."""
        return TICKET_LIFE if self.rest else super().life

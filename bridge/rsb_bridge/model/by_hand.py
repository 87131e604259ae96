"""Messages that operators publish by hand."""

from __future__ import annotations

import msgspec

TICKET_LIFE = 1.0
"""s for which a ticket is valid: a command for a topic that has to be armed is not older than this, and neither are its
messages (`demands.ARMED`)."""
OLD_AFTER = 5.0
"""s after which a command that moves a robot is given up: what stood still for so long is no longer wanted."""
REST_AFTER, LONGEST_REST = 0.5, 2.0
"""s, as usual and at most, after which an engine publishes by itself the message that ends a motion.

Not measured. A robot goes on for so long without its console; less, and each stall of a Wi-Fi stops it for a moment.
"""
ASKED_FOR = 10.0
"""s in which the holder of an arming answers whether another operator may hold it instead; then it goes over.

Not measured: a holder has to read a line and press a key, and the other operator has to wait for so long.
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
        nodes: subscriptions of other nodes in this domain that it reached.
        links: names of the links that take it to the other side.
    """

    is_done: bool
    ticket: int = 0
    type_name: str = ""
    nodes: int = 0
    links: tuple[str, ...] = ()


class Held(msgspec.Struct, frozen=True, omit_defaults=True):
    """The topics and services that a console holds.

    Attributes:
        keys: of the routes that it has armed.
    """

    keys: tuple[str, ...] = ()

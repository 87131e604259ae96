"""The fate of a route when something under it is lost: one table for all that read it (docs/outages.md).

| lost            | a datagram  | a data stream | the connection | the association |
|-----------------|-------------|---------------|----------------|-----------------|
| reliable        | sends again | sends again   | sends again    | closes          |
| best effort     | loses it    | waits         | waits          | closes          |
| has to be armed | loses it    | closes        | closes         | closes          |

Calls are reliable: services, parameters, and actions with their goals. A topic is what its QoS is, latched or not,
reliable while its QoS is unknown, and with `keep` over streams in any case. A route also closes with its data stream if
the peer has broken the format on it, or if new ones have delivered nothing for as long as the association would wait.
It is proposed again; a latched topic then sends what the other side lacks.
"""

from __future__ import annotations

from enum import Enum
from typing import TypeAlias


class Lost(Enum):
    """Something that carries a route. A connection is lost with its streams, and an association with both."""

    DATAGRAM = "a datagram"
    STREAM = "a data stream"
    CONNECTION = "the connection"
    ASSOCIATION = "the association"


class Fate(Enum):
    """The effect of a loss on a route.

    Attributes:
        SENDS_AGAIN: the route stays open, and sends again what was in transit.
        WAITS: it stays open until it is carried again; what was in transit is lost.
        CLOSES: it closes, and loses what was in transit or waited.
        LOSES: nothing waits for the message that is lost.
    """

    SENDS_AGAIN = "sends again"
    WAITS = "waits"
    CLOSES = "closes"
    LOSES = "loses it"


Fates: TypeAlias = "dict[Lost, Fate]"
"""A row of the table: one kind of route."""


def _row(*fates: Fate) -> Fates:
    return dict(zip(Lost, fates, strict=True))


RELIABLE = _row(Fate.SENDS_AGAIN, Fate.SENDS_AGAIN, Fate.SENDS_AGAIN, Fate.CLOSES)
BEST_EFFORT = _row(Fate.LOSES, Fate.WAITS, Fate.WAITS, Fate.CLOSES)
ARM_REQUIRED = _row(Fate.LOSES, Fate.CLOSES, Fate.CLOSES, Fate.CLOSES)

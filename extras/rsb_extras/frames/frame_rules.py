"""Rules on the keys of frames and stamps, and what `check` says of them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Range, Wording, one_line
from rsb_extras.frames import LINK_PREFIX, LINK_RESTAMP, PREFIX, RESTAMP, RESTAMP_WITHIN

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Client, Session, Topic

WITHIN = Range(0.001, 10)
"""s: no link measures a clock better than to a millisecond; beyond ten, a stamp says nothing."""
_PREFIX = re.compile(r"[A-Za-z0-9][A-Za-z0-9_./-]{0,62}[/_-]")


class FrameRulesText(Wording):
    PREFIX = "{value} is no prefix of frames: begin with a letter or a digit, and end with /, _ or - (robot1/)"
    WITHIN = "{value:g} s is out of range: {range}"
    SENT = "this side sends {topic}: set it in the session of the side that receives, there for the link or the topic"
    PREFIXES = "frames of {peer} get the prefix {prefix} here"
    RESTAMPS = "stamps of {peer} are shifted to this machine's clock, if that is known to {within:g} s"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    yield from _prefix_problems(LINK_PREFIX.of(session), LINK_PREFIX.name)
    for at, client in enumerate(session.listed_clients):
        yield from _prefix_problems(LINK_PREFIX.of(client), f"clients[{at}].{LINK_PREFIX.name}")
        yield from _sent(client.topics, "receive", f"clients[{at}].topics")
    if session.role == "client":
        yield from _sent(session.topics, "transmit", "topics")
    if (within := RESTAMP_WITHIN.of(session)) not in WITHIN:
        yield RESTAMP_WITHIN.name, FrameRulesText.WITHIN(value=within, range=WITHIN)


def topic_problems(topic: Topic) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.topic_problems`."""
    yield from _prefix_problems(PREFIX.of(topic) or "", PREFIX.name)


def is_prefix(text: str) -> bool:
    return _PREFIX.fullmatch(text) is not None


def _prefix_problems(prefix: str, place: str) -> Iterator[tuple[str, str]]:
    if prefix and not is_prefix(prefix):
        yield place, FrameRulesText.PREFIX(value=one_line(prefix))


def _sent(topics: tuple[Topic, ...], direction: str, place: str) -> Iterator[tuple[str, str]]:
    """Yield the keys of entries that this side sends, where they would do nothing."""
    for at, topic in enumerate(topics):
        if topic.direction == direction:
            for key in (PREFIX, RESTAMP):
                if key.of(topic):
                    yield f"{place}[{at}].{key.name}", FrameRulesText.SENT(topic=topic.topic)


def effects(session: Session) -> Iterator[str]:
    """Yield what the links' keys do."""
    holders: list[tuple[str, Session | Client]] = [("the server", session)]
    if session.role == "server":
        holders = [(client.name, client) for client in session.accepted_clients]
    for peer, holder in holders:
        if prefix := LINK_PREFIX.of(holder):
            yield FrameRulesText.PREFIXES(peer=peer, prefix=prefix)
        if LINK_RESTAMP.of(holder):
            yield FrameRulesText.RESTAMPS(peer=peer, within=RESTAMP_WITHIN.of(session))

"""A topic while an operator writes it: the form's texts, what they make, and what both graphs offer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from rich.cells import cell_len

from rsb_bridge.config.session_file import SessionError, validate, validate_topic
from rsb_bridge.config.yaml_text import read_yaml
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import Session, Topic
from rsb_console.glyphs import IN, OUT
from rsb_console.widgets.lines import Line, fit_middle
from rsb_console.widgets.picker import Offer

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot, TopicInfo

NUMBERS = ("port", "max_rate", "expected_rate", "stale_after")
_NAME_WIDTH, _WHERE_WIDTH, _TYPE_WIDTH = 32, 21, 24  # cells; the name has what is left, but no less than this


@dataclass(frozen=True, slots=True)
class Ends:
    """Who is who on the link that a topic is for.

    Attributes:
        is_server: whether this side is the server.
        client: the client's name.
        use_name: whether the server's names of its topics have the client's before them.
    """

    is_server: bool
    client: str
    use_name: bool

    @classmethod
    def of(cls, now: Snapshot, client: str) -> Ends:
        """Those of a running engine and one of its links, by the client's name."""
        return cls(now.role == "server", client, any(link.use_name for link in now.links if link.name == client))

    def client_topic(self, topic: str, *, on_server: bool) -> str | None:
        """A topic's name on the client; None: a topic of the server's that this client's names cannot mean."""
        return client_topic(topic, self.client) if on_server and self.use_name else topic


def plain(key: str, text: str) -> Any:
    """What a field's text would be in a session file. A text that is no number stays one, for the rules to refuse."""
    if key == "qos":
        return _plain_qos(text)
    if key not in NUMBERS:
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _plain_qos(text: str) -> Any:
    if text.isdecimal():
        return int(text)
    if text.startswith("{"):
        try:
            return read_yaml(text, Path("qos")).data
        except SessionError:
            return text
    return text


def topic_of(values: Mapping[str, str]) -> Topic:
    """The topic that a form's texts make. It may be wrong in every way that `problems_of` knows."""
    given = {key: plain(key, text) for key, text in values.items() if text}
    if "paused" in given:
        given["paused"] = True
    return Topic(**({"topic": "", "direction": "transmit"} | given))


def values_of(topic: Topic) -> dict[str, str]:
    """A topic as a form's texts; what is at its default is empty."""
    return {key: _text(value) for key, value in msgspec.to_builtins(topic).items()}


def _text(value: object) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_text(each)}' for key, each in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def problems_of(topic: Topic, session: Session, replaced: Topic | None) -> dict[str, str]:
    """What is wrong with a topic, and with having it beside the session's others.

    Args:
        topic: as the client sees it.
        session: what it is for. A server's has no topics to get in its way: the client answers for those.
        replaced: one of the session's that it takes the place of.

    Returns:
        Words by the key of the field.
    """
    if session.role == "server":
        found = validate_topic(topic, session)
    else:
        others = tuple(each for each in session.topics if each != replaced)
        here = f"topics[{len(others)}]"
        problems = validate(msgspec.structs.replace(session, topics=(*others, topic)))
        found = [
            replace(problem, location=problem.location.removeprefix(here).lstrip("."))
            for problem in problems
            if problem.location.startswith(here)
        ]
    words: dict[str, str] = {}
    for problem in found:
        words.setdefault(problem.location.partition(".")[0] or "topic", problem.message)
    return words


def offers_of(
    ends: Ends, here: Iterable[TopicInfo], there: Iterable[TopicInfo], bridged: Sequence[RouteSnapshot]
) -> list[Offer]:
    """What both graphs have that is not bridged yet, by name.

    A publisher makes a topic flow away from its side; where there are only subscriptions it is to flow towards them.
    What has both, one on each side, is told by its publisher.

    Args:
        ends: of the link.
        here: this side's graph.
        there: the other side's.
        bridged: the link's routes; neither end of one is offered the same way again.
    """
    taken = {(route.spec.topic, route.spec.direction) for route in bridged}
    crossing = {
        (is_here, route.topic if is_here else route.remote_topic, route.outgoing)
        for route in bridged
        for is_here in (True, False)
    }
    infos = [(info, is_here) for graph, is_here in ((here, True), (there, False)) for info in graph]
    offers: dict[str, Offer] = {}
    for info, is_here in sorted(infos, key=lambda each: not each[0].publishers):
        offer = _offer(ends, info, is_here)
        if (
            offer is not None
            and (is_here, info.topic, is_here == bool(info.publishers)) not in crossing
            and (offer.value, offer.fills["direction"]) not in taken
        ):
            offers.setdefault(offer.key, offer)
    return sorted(offers.values(), key=lambda offer: offer.value)


def _offer(ends: Ends, info: TopicInfo, is_here: bool) -> Offer | None:
    """What the client would call it; None: it is not the client's to bridge."""
    on_server = is_here == ends.is_server
    name = ends.client_topic(info.topic, on_server=on_server)
    if name is None:
        return None
    fills = {
        "direction": "receive" if on_server == bool(info.publishers) else "transmit",
        "type": info.type_name or AUTO,
    }
    return Offer(f"{fills['direction']} {name}", name, partial(_line, info, is_here), fills)


def _line(info: TopicInfo, is_here: bool, width: int) -> Line:
    name_width = max(_NAME_WIDTH, width - 2 - _WHERE_WIDTH - _TYPE_WIDTH)
    count, what = (info.publishers, "publisher") if info.publishers else (info.subscriptions, "subscriber")
    return (
        (f"{OUT if is_here == bool(info.publishers) else IN} ", ""),
        *_column(info.topic, name_width, "strong"),
        *_column(f"{count} {what}{'s' if count > 1 else ''} {'here' if is_here else 'there'}", _WHERE_WIDTH, "dim"),
        (info.type_name.replace("/msg/", "/") or "several types", ""),
    )


def _column(text: str, width: int, look: str) -> Line:
    cut = fit_middle(text, width - 1)
    return (cut, look), (" " * (width - cell_len(cut)), "")

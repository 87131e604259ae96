"""A robot of a fleet in a few figures, made from a server's snapshot for each client, or by an engine for itself.

All figures are seen from the robot: it sends `from_robot` and receives `to_robot`.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.model.faults import (
    is_wrong,
    needs_attention,
    state_counts,
)
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first, plural, sanitize_text
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot

WHY_LENGTH = 200  # characters of a reason: a line of a screen. The robot's own screen has the rest
SUMMARY_BYTES = 4096  # of a summary that comes from elsewhere
LOSS_SPAN = 60.0  # the most s that a loss is computed over
_MARK_EVERY = 1.0  # s from one mark of a route's counts to the next, however often snapshots come
_CLIENT_NAMES = 1500  # characters for all names in `wrong_clients`, so that a summary stays within `SUMMARY_BYTES`
_NAMED = 3
_COUNT, _FIGURE = 1 << 31, 1e15  # beyond any real one; another program's figures are cut to these


class SummaryText(Wording):
    ROUTE = "{topic} {state}: {reason}"
    MORE_FAULTS = " (and {count} more {faults})"


class RobotState(StrEnum):
    """The state of a robot, the worst first."""

    MISSING = "missing"
    """It was there, and is not any more."""
    FAULT = "fault"
    """A topic or a service carries nothing, though it should; or of an engine itself, a link is down."""
    WARN = "warn"
    """Too little crosses, or not to everybody; or a link has a warning."""
    ACKNOWLEDGED = "acknowledged"
    """Operators have acknowledged all its faults."""
    WAITING = "waiting"
    """It has not been there yet."""
    OK = "ok"

    @property
    def rank(self) -> int:
        """0 for the worst."""
        return _RANKS[self]

    @property
    def is_wrong(self) -> bool:
        """Whether somebody should look."""
        return self.rank <= _RANKS[RobotState.WARN]

    @classmethod
    def _missing_(cls, value: object) -> RobotState | None:
        """A state that only a newer version has: somebody should look."""
        return cls.WARN


_RANKS = {state: rank for rank, state in enumerate(RobotState)}


class Battery(NamedTuple):
    """A battery, as its robot published it last."""

    charge: float  # 0 to 1
    time: float  # s since the epoch, when it was published here


class LostMessages(NamedTuple):
    """Messages that did not arrive."""

    share: float  # lost messages of all that were delivered or lost, 0 to 1, in both directions together
    span: float  # the last s, which this share is computed over


class RobotSummary(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The figures of one robot."""

    name: str
    group: str = ""
    role: str = ""  # of its session: ``client``, ``server``, or empty if unknown
    state: RobotState = RobotState.WAITING
    why: str = ""  # the worst verdict in words and the number of the others, or empty
    since: float = 0.0  # s since the epoch, when the fault in `why` began, or without a fault, when the state began
    seen: float | None = None  # s since the epoch, when it was last connected, or None if it never was
    host: str = ""  # the address of its link, or its machine's name
    version: str = ""  # of its rsb-console, or empty if unknown
    links_up: int = 0
    links: int = 0
    flowing: int = 0  # number of routes that carry messages or calls
    routes: int = 0
    states: dict[str, int] = {}  # number of routes in each state; the robot's own console shows the same figures
    wrong_clients: tuple[str, ...] = ()  # of a server, names of clients with a fault, as many as fit
    clients_wrong: int = 0  # number of clients with a fault
    acknowledged: int = 0  # number of acknowledged faults
    messages_from_robot: float = 0.0  # Hz, of all topics that it sends
    messages_to_robot: float = 0.0  # Hz, of all topics that it receives
    bytes_from_robot: float = 0.0  # bytes/s that it sends over its links
    bytes_to_robot: float = 0.0  # bytes/s that it receives over its links
    loss: LostMessages | None = None  # of its messages, or None before the first message was delivered or lost
    battery: Battery | None = None  # its battery, or None if no topic reports it


class _Mark(NamedTuple):
    time: float
    lost: int
    settled: int


class LossWindow:
    """How many messages were lost lately, over each link, as the ledgers of successive snapshots tell."""

    def __init__(self) -> None:
        self._marks: dict[str, deque[_Mark]] = {}

    def add(self, snapshot: Snapshot) -> dict[str, LostMessages]:
        """Take a snapshot, newer than the one before; gives the loss of each link that has a figure."""
        now = snapshot.time
        lost, settled, since = Counter[str](), Counter[str](), dict[str, float]()
        marks, self._marks = self._marks, {}
        for route in snapshot.routes:
            if route.calls is None:
                self._marks[route.key] = marks.get(route.key) or deque()
                first = self._first_mark(route, now)
                total = route.ledger.lost
                lost[route.link] += max(0, total - first.lost)
                settled[route.link] += total + route.ledger.delivered - first.settled
                since[route.link] = min(first.time, since.get(route.link, now))
        return {link: LostMessages(lost[link] / count, now - since[link]) for link, count in settled.items() if count}

    def _first_mark(self, route: RouteSnapshot, now: float) -> _Mark:
        """Return the counts of a route at the beginning of the window."""
        marks, lost = self._marks[route.key], route.ledger.lost
        settled = lost + route.ledger.delivered
        if marks and (settled < marks[-1].settled or now < marks[-1].time):
            marks.clear()  # the counts have begun again
        if not marks or now - marks[-1].time >= _MARK_EVERY:
            marks.append(_Mark(now, lost, settled))
        while len(marks) > 1 and now - marks[1].time >= LOSS_SPAN:
            marks.popleft()
        return marks[0]


def of_clients(
    snapshot: Snapshot, session: Session, losses: Mapping[str, LostMessages], batteries: Mapping[str, Battery]
) -> list[RobotSummary]:
    """Summarize the clients of a server, one for each link.

    Args:
        session: of the server, with the groups of its clients.
        losses: of each link by its name, as `LossWindow.add` returns them.
        batteries: of each link by its name.
    """
    groups = {client.name: client.group or "" for client in session.accepted_clients}
    routes: dict[str, list[RouteSnapshot]] = {link.name: [] for link in snapshot.links}
    for route in snapshot.routes:
        routes.get(route.link, []).append(route)
    return [
        msgspec.structs.replace(
            _summary(link.name, snapshot, [link], routes[link.name], lambda r: r.spec.topic, from_robot_is_sent=False),
            group=groups.get(link.name, ""),
            role="client",
            seen=_seen(link, snapshot.time),
            host=sanitize_text(link.peer, TEXT_LENGTH),
            version=sanitize_text(link.peer_version, TEXT_LENGTH),
            loss=losses.get(link.name),
            battery=batteries.get(link.name),
        )
        for link in snapshot.links
    ]


def of_engine(
    snapshot: Snapshot,
    session: Session,
    *,
    host: str,
    version: str,
    losses: Mapping[str, LostMessages],
    battery: Battery | None,
) -> RobotSummary:
    """Summarize an engine for its own announcement.

    Args:
        losses: of each link by its name; the greatest counts.
    """
    summary = _summary(
        snapshot.name, snapshot, snapshot.links, snapshot.routes, lambda route: route.topic, from_robot_is_sent=True
    )
    if session.role == "server" and snapshot.running:
        summary = _with_faults_of_clients(summary, snapshot, session)
    if summary.state is RobotState.MISSING and snapshot.running:  # this bridge answers; its peer does not
        summary = msgspec.structs.replace(summary, state=RobotState.FAULT)
    return msgspec.structs.replace(
        summary,
        group=session.group or "",
        role=session.role,
        seen=snapshot.time,
        host=sanitize_text(host, TEXT_LENGTH),
        version=version,
        loss=max(losses.values(), default=None),
        battery=battery,
    )


def _with_faults_of_clients(summary: RobotSummary, snapshot: Snapshot, session: Session) -> RobotSummary:
    """Name a server's clients with faults, unless the fault is the server's own, so that no link can come up."""
    if any(link.cause == LinkCause.UNREACHABLE for link in snapshot.links):
        return summary
    wrong = [client for client in of_clients(snapshot, session, {}, {}) if client.state.is_wrong]
    if not wrong:
        return summary
    worst = min(wrong, key=lambda client: client.state.rank)
    names: list[str] = []
    for client in wrong:
        if sum(map(len, names)) + len(client.name) <= _CLIENT_NAMES:
            names.append(client.name)
    return msgspec.structs.replace(
        summary,
        state=worst.state,
        why=sanitize_text(_and_more(f"{worst.name}: {worst.why}", len(wrong)), WHY_LENGTH),
        since=worst.since,
        wrong_clients=tuple(names),
        clients_wrong=len(wrong),
    )


def drop_repeated_faults(summaries: Sequence[RobotSummary]) -> list[RobotSummary]:
    """Drop from each server's row the faults that its clients' rows show, so that each fault is listed once."""
    wrong = {summary.name for summary in summaries if summary.state.is_wrong and summary.role != "server"}
    rows = []
    for row in summaries:
        left = [name for name in row.wrong_clients if name not in wrong]
        others = row.clients_wrong - len(row.wrong_clients)
        if row.role != "server" or len(left) == len(row.wrong_clients):  # none of its faults is shown elsewhere
            rows.append(row)
        elif not left and others <= 0:
            rows.append(msgspec.structs.replace(row, state=RobotState.OK, why=""))
        else:
            names = join_first(left, _NAMED) if left else f"{others} more {plural(others, 'client')}"
            why = sanitize_text(f"something is wrong with {names}", WHY_LENGTH)
            rows.append(msgspec.structs.replace(row, why=why))
    return rows


def _summary(
    name: str,
    snapshot: Snapshot,
    links: Sequence[LinkSnapshot],
    routes: Sequence[RouteSnapshot],
    called: Callable[[RouteSnapshot], str],
    *,
    from_robot_is_sent: bool,
) -> RobotSummary:
    """Make the part of a summary that both kinds have in common.

    Args:
        called: returns the robot's name for the topic of a route.
        from_robot_is_sent: whether the engine that made the snapshot is the robot's own.
    """
    state, why, since = _state(snapshot, links, routes, called)
    up = {link.name for link in links if link.state is State.OK}
    # A topic that has stopped, and calls, count as no messages.
    carrying = [route for route in routes if route.link in up and route.state.flows]
    sent, received = (
        sum((route.rate for route in carrying if route.calls is None and route.outgoing is outgoing), 0.0)
        for outgoing in (True, False)
    )
    tx = sum(link.tx_bytes_per_second for link in links if link.name in up)
    rx = sum(link.rx_bytes_per_second for link in links if link.name in up)
    if not from_robot_is_sent:
        sent, received, tx, rx = received, sent, rx, tx
    return RobotSummary(
        name=name,
        state=state,
        why=sanitize_text(why, WHY_LENGTH),
        since=since,
        links_up=len(up),
        links=len(links),
        flowing=len(carrying),
        routes=len(routes),
        states={state.value: count for state, count in state_counts(routes).items()},
        acknowledged=sum(1 for _ in _acknowledged_faults(links, routes, called)),
        messages_from_robot=sent,
        messages_to_robot=received,
        bytes_from_robot=tx,
        bytes_to_robot=rx,
    )


def _state(
    snapshot: Snapshot,
    links: Sequence[LinkSnapshot],
    routes: Sequence[RouteSnapshot],
    called: Callable[[RouteSnapshot], str],
) -> tuple[RobotState, str, float]:
    # A bridge that is out of reach is shown as not running, too, with links that say why (`control.states`).
    if not snapshot.running and not any(link.state is State.DOWN for link in links):
        return RobotState.MISSING, "the bridge is stopped", snapshot.time
    if down := [link for link in links if link.state is State.DOWN and link.acknowledged is None]:
        first = min(down, key=lambda link: link.since)
        return RobotState.MISSING, _and_more(first.reason, len(down)), first.since
    wrong = [route for route in routes if needs_attention(route)]
    if stopped := [route for route in wrong if not route.state.flows]:
        return RobotState.FAULT, *_worst(stopped, len(wrong), called)
    if warned := [link for link in links if needs_attention(link)]:
        return RobotState.WARN, _and_more(warned[0].warning, len(warned) + len(wrong)), warned[0].fault_since
    if wrong:
        return RobotState.WARN, *_worst(wrong, len(wrong), called)
    if partial := [(pattern, link) for link in links for pattern in link.patterns if needs_attention(pattern)]:
        pattern, link = partial[0]
        return RobotState.WARN, _and_more(f"{pattern.spec.topic}: {pattern.reason}", len(partial)), link.since
    if acknowledged := list(_acknowledged_faults(links, routes, called)):
        why, since = acknowledged[0]
        return RobotState.ACKNOWLEDGED, _and_more(why, len(acknowledged)), since
    if links and all(link.state is State.WAITING for link in links):
        return RobotState.WAITING, links[0].reason, links[0].since
    unheard = [route for route in routes if route.state is State.UNHEARD]
    why = f"{len(unheard)} unheard: {unheard[0].reason}" if unheard else ""
    return RobotState.OK, why, max((link.since for link in links if link.state is State.OK), default=snapshot.time)


def _acknowledged_faults(
    links: Sequence[LinkSnapshot], routes: Sequence[RouteSnapshot], called: Callable[[RouteSnapshot], str]
) -> Iterator[tuple[str, float]]:
    """Yield the acknowledged faults, each with its beginning: of links first, then of the worst routes."""
    for link in links:
        if link.acknowledged is not None and is_wrong(link):
            yield link.reason or link.warning, link.fault_since
        for pattern in link.patterns:
            if pattern.acknowledged is not None and is_wrong(pattern):
                yield f"{pattern.spec.topic}: {pattern.reason}", link.since
    for route in sorted(routes, key=lambda route: (route.state.rank, called(route))):
        if route.acknowledged is not None and route.cause != Cause.LINK_DOWN and is_wrong(route):
            yield SummaryText.ROUTE(topic=called(route), state=route.state.upper(), reason=route.reason), route.since


def _worst(routes: Iterable[RouteSnapshot], count: int, called: Callable[[RouteSnapshot], str]) -> tuple[str, float]:
    """Return the worst of some routes in words, and since when; of equals, the first by name."""
    worst = min(routes, key=lambda route: (route.state.rank, called(route)))
    text = SummaryText.ROUTE(topic=called(worst), state=worst.state.upper(), reason=worst.reason)
    return _and_more(text, count), worst.since


def _and_more(text: str, count: int) -> str:
    """Return a text, cut so that the number of others fits behind it."""
    if count < 2:
        return text
    more = SummaryText.MORE_FAULTS(count=count - 1, faults=plural(count - 1, "fault"))
    return text[: WHY_LENGTH - len(more)] + more


def _seen(link: LinkSnapshot, now: float) -> float | None:
    if link.state is State.OK:
        return now
    # Only a connection tells the domain of the peer.
    return link.since if link.state is State.DOWN and link.peer_domain is not None else None


# --- summaries from elsewhere


class InvalidSummary(Wording):
    TOO_LONG = "a summary of {length:,} bytes; at most {limit:,} are allowed"
    UNREADABLE = "no summary of a robot: {error}"
    NAMELESS = "a summary without a name"


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(RobotSummary)


def encode(summary: RobotSummary) -> bytes:
    """Return a summary as bytes, for `decode` of this version or another."""
    return _encoder.encode(summary)


def decode(data: bytes) -> RobotSummary:
    """Return another program's summary, with its texts made printable and its figures within their ranges.

    Raises:
        ValueError: it is none, or too long.
    """
    if len(data) > SUMMARY_BYTES:
        raise ValueError(InvalidSummary.TOO_LONG(length=len(data), limit=SUMMARY_BYTES))
    try:
        summary = _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(InvalidSummary.UNREADABLE(error=error)) from None
    if not summary.name.strip():
        raise ValueError(InvalidSummary.NAMELESS())
    loss, battery = summary.loss, summary.battery
    return msgspec.structs.replace(
        summary,
        name=sanitize_text(summary.name, TEXT_LENGTH),
        group=sanitize_text(summary.group, TEXT_LENGTH),
        role=summary.role if summary.role in ("client", "server") else "",
        why=sanitize_text(summary.why, WHY_LENGTH),
        host=sanitize_text(summary.host, TEXT_LENGTH),
        version=sanitize_text(summary.version, TEXT_LENGTH),
        since=_within(summary.since),
        seen=None if summary.seen is None else _within(summary.seen),
        links_up=int(_within(summary.links_up, _COUNT)),
        links=int(_within(summary.links, _COUNT)),
        flowing=int(_within(summary.flowing, _COUNT)),
        routes=int(_within(summary.routes, _COUNT)),
        states={
            state.value: int(_within(summary.states.get(state, 0), _COUNT))
            for state in State
            if state in summary.states
        },
        wrong_clients=tuple(sanitize_text(each, TEXT_LENGTH) for each in summary.wrong_clients),
        clients_wrong=int(_within(summary.clients_wrong, _COUNT)),
        acknowledged=int(_within(summary.acknowledged, _COUNT)),
        messages_from_robot=_within(summary.messages_from_robot),
        messages_to_robot=_within(summary.messages_to_robot),
        bytes_from_robot=_within(summary.bytes_from_robot),
        bytes_to_robot=_within(summary.bytes_to_robot),
        loss=None if loss is None else LostMessages(_within(loss.share, 1.0), _within(loss.span)),
        battery=None if battery is None else Battery(_within(battery.charge, 1.0), _within(battery.time)),
    )


def _within(figure: float, most: float = _FIGURE) -> float:
    return max(0.0, min(figure, most)) if math.isfinite(figure) else 0.0

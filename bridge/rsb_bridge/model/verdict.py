"""Verdicts on routes: a state, its cause, and a sentence for operators with the remedy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import floor

from rsb_bridge.model.snapshot import State

LASTING = "{lasting}"
"""Placeholder in a verdict's text for the duration, so that the text itself stays the same."""


class Cause(StrEnum):
    """The cause of a route's state. Programs and tests may rely on it; texts are for people and may change."""

    NONE = ""
    LINK_DOWN = "link_down"
    REFUSED = "refused"
    LISTED_DIFFERENTLY = "listed_differently"
    """Both sessions list it, with values that differ."""
    LOOP = "loop"
    PAUSED = "paused"
    DISARMED = "disarmed"
    """It requires arming by an operator before anything crosses."""
    DISARMING = "disarming"
    """The topic was disarmed, and the other side may act on earlier messages for up to 1 s."""
    RESTING = "resting"
    """Nobody on the receiving side wants the messages of a lazy topic, so that the sending side does not subscribe."""
    NO_PATH = "no_path"
    """Its transport does not get through, though the link is up."""
    AWAITS_LINK = "awaits_link"
    """Its link is silent, or opens its data connection again after that broke."""
    SUBSCRIBE_FAILED = "subscribe_failed"
    QOS_INCOMPATIBLE = "qos_incompatible"
    """A publisher offers less than is asked for."""
    TYPE_CONFLICT = "type_conflict"
    """The nodes on the topic do not have one type."""
    TYPE_UNKNOWN = "type_unknown"
    UNMATCHED = "unmatched"
    """DDS does not match an endpoint with the bridge's, for something else than the type's name or a policy of ROS."""
    NO_PUBLISHER = "no_publisher"
    SIMILAR_NAME = "similar_name"
    """It has no publisher, and a topic with a similar name, or of the same type, has one: which may be meant."""
    PUBLISHED_THERE = "published_there"
    """It has no publisher on the sending side, and one on the receiving side: its direction may be wrong."""
    PUBLISHER_GONE = "publisher_gone"
    """It had publishers, and has none any more."""
    PUBLISHER_SILENT = "publisher_silent"
    """There are publishers, but no messages."""
    PUBLISHER_UNHEARD = "publisher_unheard"
    """As `PUBLISHER_SILENT`, but DDS may have lost the messages, which are large and best effort."""
    LATE = "late"
    """Messages take longer than `late_after`."""
    LINK_SLOW = "link_slow"
    """Messages are older than `max_age` when the link has carried them, or before it takes them, and are dropped."""
    CLOCK_UNKNOWN = "clock_unknown"
    """Messages are dropped because their age is not known well enough for `max_age`."""
    PUBLISHER_STAMPS_OLD = "publisher_stamps_old"
    """Messages are older than `max_age` by their publisher's stamps when they are taken, and are dropped."""
    SLOW = "slow"
    LOSSY = "lossy"
    """Messages are lost on the way, or late because packets are."""
    QUEUE_FULL = "queue_full"
    """More is published than the link carries."""
    TOO_LARGE = "too_large"
    NOT_PUBLISHED = "not_published"
    """Messages arrive, and the receiving side cannot publish them."""
    NO_SUBSCRIBER = "no_subscriber"
    SEVERAL_CLOCKS = "several_clocks"
    """Several sources publish one clock, so that its time jumps back and forth."""
    SEVERAL_PUBLISHERS = "several_publishers"
    """Several drivers publish what moves a robot, which follows all of them. A note, and no fault."""
    SILENT = "silent"
    """Nothing comes from the other side, and this side does not know why."""
    NO_MESSAGE = "no_message"
    """As `SILENT`, while no message is due."""
    CATCHING_UP = "catching_up"
    """The link is back, and messages that waited for it still cross."""
    THROTTLED = "throttled"
    """As many messages cross as an operator allows."""
    OFFER_FAILED = "offer_failed"
    """ROS refuses its server on the callers' side, or its client on the providing one."""
    NO_SERVER = "no_server"
    """Nobody provides the service on the providing side, and nobody has since the link is up."""
    SERVER_GONE = "server_gone"
    """Somebody did."""
    NO_PARAMETERS = "no_parameters"
    """The node is there, and serves no parameters, or only a part of what they take."""
    SEVERAL_SERVERS = "several_servers"
    """Several nodes provide it, each of which gets every call."""
    SERVED_HERE = "served_here"
    """A node on the callers' side provides it, too, so that it is not offered there."""
    NO_CALL = "no_call"
    """It can be called, and has not been yet."""
    UNANSWERED = "unanswered"
    """Calls have no answer in time."""
    CALLS_WAIT = "calls_wait"
    """More calls come than their node takes, so that some expire before it gets them."""
    CALLS_REFUSED = "calls_refused"
    """More is called than the link or an operator allows, or calls are malformed."""


class LinkCause(StrEnum):
    """The cause of a link's fault."""

    NONE = ""
    NOT_YET = "not_yet"
    """It has not been connected yet."""
    LOST = "lost"
    SILENT = "silent"
    """It was up, and nothing came from the other side for too long."""
    CLOSED = "closed"
    """One of the sides ended it on purpose."""
    UNREACHABLE = "unreachable"
    TIMED_OUT = "timed_out"
    """No packet comes back from the server's address."""
    ROUTER_LOST = "router_lost"
    """The router that connects the two sides is lost."""
    NO_ANSWER = "no_answer"
    """The server's port accepts the connection, and nothing answers."""
    NOT_A_BRIDGE = "not_a_bridge"
    """Another program answers at the server's port, or connects to it."""
    REFUSED = "refused"
    WRONG_KEY = "wrong_key"
    WRONG_VERSION = "wrong_version"
    UNKNOWN_NAME = "unknown_name"
    NAME_TAKEN = "name_taken"
    """Two machines have its name."""
    FULL = "full"
    """It is up and carries less than its topics ask for."""
    LOSSY = "lossy"
    """It is up and loses packets."""
    LARGE_PACKETS = "large_packets"
    """It is up and loses large packets, while small ones arrive."""
    CLOCKS_DIFFER = "clocks_differ"
    """It is up, and the clocks of the two sides differ by seconds."""
    UNPROVEN_SERVERS = "unproven_servers"
    """It is up, and other servers are announced in its network that did not prove the key."""
    SHUT_DOWN = "shut_down"
    """An operator has shut it down on the server, which refuses the client until the link is restarted there."""


def about(seconds: float) -> str:
    """Return a duration in one unit, which changes seldom: ``5 s``, ``40 s``, ``3 min``, ``2 h``, ``5 d``."""
    if seconds < 10:
        return f"{max(1, int(seconds))} s"
    if seconds < 60:
        return f"{int(seconds / 10) * 10} s"
    if seconds >= 2 * 86400:
        return f"{int(seconds / 86400)} d"
    return f"{int(seconds / 60)} min" if seconds < 3600 else f"{int(seconds / 3600)} h"


def duration(seconds: float) -> str:
    """Return a duration as exactly as a screen shows an age: ``5 s``, ``77 s``, ``3 min``, ``2 h``, ``5 d``."""
    if seconds < 100:
        return f"{max(1, int(seconds))} s"
    for size, unit in ((86400, "d"), (3600, "h")):
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds / 60:.0f} min"


_CLOCKS_DIFFER = 5.0
"""s. NTP leaves milliseconds, and transforms (tf) fail far below; a robot without NTP is off by more."""


def clocks_differ(peer: str, offset: float | None, uncertainty: float | None) -> str:
    """Return the warning that the clocks of two sides differ, or an empty string.

    Args:
        peer: the other side, for an operator.
        offset: s, its clock minus this machine's, or None if it is unknown.
        uncertainty: s, of the offset.
    """
    if offset is None or uncertainty is None or abs(offset) - uncertainty < _CLOCKS_DIFFER:
        return ""
    way = "ahead of" if offset > 0 else "behind"
    return (
        f"the clock of {peer} is {about(round(abs(offset)))} {way} this machine's: "
        "set both by NTP (timedatectl set-ntp true)"
    )


_DETAILS_UNKNOWN = frozenset({Cause.SILENT, Cause.NO_MESSAGE, Cause.NO_CALL})
"""Causes that give way to what the other side knows."""
_NOTES = frozenset({Cause.NONE, Cause.THROTTLED, Cause.SEVERAL_PUBLISHERS})
"""Causes that explain no silence."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One side's judgement of a route.

    Attributes:
        cause: of the state, a `Cause`, one of a feature, or one of a newer peer.
        text: for an operator, with the remedy, and perhaps with `LASTING`; or empty.
        since: s, when it began, or None if the verdict does not say.
        here: whether it is for this side only.
    """

    state: State
    cause: str = Cause.NONE
    text: str = ""
    since: float | None = None
    here: bool = False

    @property
    def lasting(self) -> bool:
        """Whether its text tells for how long it has lasted."""
        return LASTING in self.text

    def said(self, now: float, wall: float | None = None) -> str:
        """Return the text at `now` (s).

        Seconds begin at the same moment for all topics, so that the figures of several lines change together.

        Args:
            wall: s since the epoch, by which screens count the age of a message, or None for `now`.
        """
        if LASTING not in self.text:
            return self.text
        wall = now if wall is None else wall
        lasting = 0.0 if self.since is None else now - self.since
        return self.text.replace(LASTING, duration(floor(wall) - floor(wall - lasting)))


FINE = Verdict(State.OK)


EXPIRES = frozenset({Cause.LINK_SLOW, Cause.CLOCK_UNKNOWN, Cause.PUBLISHER_STAMPS_OLD})
"""Causes of topics of whose messages many are older than `max_age`."""


def worse(sender: Verdict, receiver: Verdict) -> tuple[Verdict, bool]:
    """Return the verdict that counts.

    The worse state counts. If one side knows only that nothing comes, the other side's cause explains it, and a stopped
    topic is not stale as well. If both are equally bad, the sending side's cause counts, as messages start there.

    Returns:
        The verdict, and whether it is the sending side's.
    """
    if sender.state is State.OK and receiver.state is State.OK:
        from_sender = bool(sender.text) or not receiver.text
    else:
        from_sender = sender.state.rank <= receiver.state.rank
    chosen, other = (sender, receiver) if from_sender else (receiver, sender)
    if chosen.cause in _DETAILS_UNKNOWN and other.cause not in (*_DETAILS_UNKNOWN, *_NOTES):
        explained = (chosen.state, other.state) == (State.STALE, State.STOPPED)
        state = other.state if explained else chosen.state
        return replace(other, state=state), not from_sender
    return chosen, from_sender

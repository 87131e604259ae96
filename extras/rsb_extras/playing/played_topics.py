"""Which topics of a recording are played, as what, and why the others are not."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import hash_of_text, text_of
from rsb_bridge.feature_api import RosError, TopicSpec, Wording, sanitize_text
from rsb_bridge.model.motion import may_move
from rsb_bridge.model.names import OWN_NAMES, is_topic_name
from rsb_extras.recording.reading.defined_types import DefinitionError, defined_type, rosidl_description
from rsb_extras.recording.reading.recorded_qos import played_qos

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.feature_api import Publisher
    from rsb_bridge.model.patterns import Pattern
    from rsb_bridge.ros.node import RosNode
    from rsb_extras.recording.reading.stored_message import StoredChannel

_PUBLISHERS = 1000  # A round figure: every node of the domain learns of each
CLOCK = "/clock"


class PlayText(Wording):
    """What an operator reads of a recording that is played."""

    RECORDING = "{path}: {messages:,} messages of {topics} topics, {seconds:.1f} s"
    CUT = "{path}: {reason}; it is played as far as it goes"
    PLAYS = "plays {topics} topics in domain {domain}"
    MOTION = "not played, as it may move a robot: {topic} ({type}): --arm plays it, after a question"
    OWN = "it is of a bridge, and would mislead others"
    NAME = "{name!r} is no topic's name"
    ENCODING = "its messages are {encoding}, not CDR"
    OWN_CLOCK = "--clock publishes the recording's time there"
    LEFT_OUT = "not played: {topic}: {reason}"
    TOO_MANY = "it has more than {limit:,} publishers: name some topics with --topics"
    NOTHING = "no topic is left to play: see above, and --topics"
    NO_TOPIC = "--topics {pattern}: the recording has no such topic"
    BESIDE = "{topic} has a publisher in domain {domain} already ({nodes}): who listens gets both"
    ASK = (
        "--arm: {topics} may move a robot. A player has no link, lease or limits: all that listens in domain {domain} "
        "moves at once, by what is recorded. Play it there?"
    )
    FAILED = "{count:,} messages of {topic} were not published: {reason}"
    NO_ROOM = (
        "{count:,} messages of {topic} were left out: the latched topics have more than the {limit} MiB that a player "
        "keeps for late joiners; name fewer with --topics"
    )
    DAMAGED = "{path}: {reason}; it was played up to there"
    PLAYED = "played {messages:,} messages in {seconds:.1f} s; late by {p50:.2f} ms (p50), {p99:.2f} ms (p99)"


class PlayedTopic:
    """A publisher in place of recorded ones.

    Attributes:
        kept: messages that late joiners get, or 0.

    Raises:
        RosError: the domain takes no such publisher.
    """

    def __init__(self, node: RosNode, spec: TopicSpec) -> None:
        self._node, self._spec = node, spec
        self.kept = spec.qos.depth if spec.qos.latched else 0
        self.publisher: Publisher = node.advertise(spec, "play")

    def renew(self) -> None:
        """Publish by a new publisher, so that DDS frees what it keeps; raises RosError."""
        self.publisher.close()
        self.publisher = self._node.advertise(self._spec, "play")


class PlayedChoice(NamedTuple):
    """The channels that are played, and lines about those that are not."""

    channels: list[StoredChannel]
    moving: list[StoredChannel]
    left_out: list[str]


def choose(channels: Iterable[StoredChannel], patterns: Sequence[Pattern], *, has_clock: bool) -> PlayedChoice:
    """Choose what to play.

    Args:
        patterns: topics to play, or none for all.
        has_clock: whether the player publishes the time itself.
    """
    found = PlayedChoice([], [], [])
    for channel in channels:
        topic = channel.topic
        if patterns and not any(pattern.match(topic) is not None for pattern in patterns):
            continue
        reason = ""
        if not is_topic_name(topic):
            reason = PlayText.NAME(name=sanitize_text(topic))
        elif topic.startswith(OWN_NAMES):
            reason = PlayText.OWN()
        elif channel.encoding != "cdr":
            reason = PlayText.ENCODING(encoding=sanitize_text(channel.encoding) or "of no known kind")
        elif has_clock and topic == CLOCK:
            reason = PlayText.OWN_CLOCK()
        if reason:
            found.left_out.append(PlayText.LEFT_OUT(topic=sanitize_text(topic), reason=reason))
        elif may_move(channel.type_name, topic):
            found.moving.append(channel)
        else:
            found.channels.append(channel)
    return found


class PlayedPublishers:
    """The publishers of a player: one for each recorded publisher that the recording tells apart.

    Attributes:
        left_out: lines about channels whose types cannot be used here.
        latched: names of topics whose late joiners get earlier messages.
    """

    def __init__(self, node: RosNode, channels: Iterable[StoredChannel]) -> None:
        self.left_out: list[str] = []
        self.latched: set[str] = set()
        self.topics: set[str] = set()
        self._by_channel: dict[StoredChannel, PlayedTopic] = {}
        self._by_id: dict[int, tuple[StoredChannel, PlayedTopic | None]] = {}  # as the hash of a channel takes long
        made: dict[tuple[str, str, str], PlayedTopic] = {}
        for channel in channels:
            key = channel.topic, channel.type_name, channel.publisher
            if (played := made.get(key)) is None:
                qos = played_qos(channel.profiles)
                spec = TopicSpec(channel.topic, channel.type_name, _hash_of(node, channel), qos)
                try:
                    played = made[key] = PlayedTopic(node, spec)
                except RosError as error:
                    self.left_out.append(PlayText.LEFT_OUT(topic=channel.topic, reason=sanitize_text(str(error))))
                    continue
                if qos.latched:
                    self.latched.add(channel.topic)
            self.topics.add(channel.topic)
            self._by_channel[channel] = played
        self.all = [*made.values()]

    def of(self, channel: StoredChannel) -> PlayedTopic | None:
        """Return a channel's publisher, or None if it is not played."""
        found = self._by_id.get(id(channel))
        if found is None:
            found = self._by_id[id(channel)] = channel, self._by_channel.get(channel)
        return found[1]


def check_number(channels: Sequence[StoredChannel]) -> None:
    """Refuse more publishers than a domain should learn of.

    Raises:
        RosError: they are too many.
    """
    if len(channels) > _PUBLISHERS:
        raise RosError(PlayText.TOO_MANY(limit=_PUBLISHERS))


def _hash_of(node: RosNode, channel: StoredChannel) -> str:
    """Return the hash of a channel's type, as it is recorded or by its definition; or empty if it is installed."""
    if channel.type_hash:
        return channel.type_hash
    if node.installed_hash(channel.type_name) is not None or channel.definition[0] != "ros2msg":
        return ""
    try:
        described = defined_type(channel.type_name, channel.definition[1].decode())
    except (DefinitionError, UnicodeDecodeError):
        return ""
    return hash_of_text(text_of(rosidl_description(described)))

"""The rules of one topic, service, action or node's parameters, also by pattern, and of values that a session has.

Four functions check a whole entry: `topic_problems` one of a session file, `entry_problems` one of a form, a program or
a peer's proposal, `problems_here` such a proposal under this side's name for it, `internal_problems` an internal route.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import msgspec

from rsb_bridge.config.decoding import Hint, ValueMistake, did_you_mean, holds_key, join, read, show
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.config.file_form import LISTS, foreign, key_of
from rsb_bridge.config.keys import conceal
from rsb_bridge.config.name_rules import KIND_NOUNS, topic_name_problems
from rsb_bridge.installed_features import added
from rsb_bridge.model import transports
from rsb_bridge.model.by_hand import (
    END_CANCEL,
    END_NONE,
    END_ZERO,
    LONGEST_END,
    TWISTS,
    VelocityLimits,
    end_text,
    is_end_message,
)
from rsb_bridge.model.calls import LANES, FieldError
from rsb_bridge.model.demands import full_type
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.limits import CHANNEL, NO_PORT, TEXT_LENGTH
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.qos import AUTO, PROFILES, Qos, parse_qos
from rsb_bridge.model.session import Kind, Problem, Session, Topic
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.topic_keys import ADDED_KEYS, TOPIC_KEYS, ForeignKey, TopicKey
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.transport_traits import TransportTraits

A_KIND: Final[dict[Kind, str]] = {
    "topic": "a topic",
    "service": "a service",
    "action": "an action",
    "parameters": "a node's parameters",
}
"""Each kind, in a sentence."""
_OF_TOPICS = {
    "kind": "topic",
    "arm": False,
    "deadman": None,
    "on_end": None,
    "limits": None,
    "max_age": None,
    "keep": None,
    "beat": None,
    "timeout": None,
}
"""The keys that an internal route does not have, and their defaults."""
_FOLDERS: dict[Kind, str] = {"service": "srv", "action": "action"}
_TEXTS = {"topic": "/unnamed", "type": AUTO, "qos": AUTO, "remote_topic": None, "on_end": None, "beat": None}
"""Free texts, and the stand-in that other rules see if one holds a key."""
_PART = r"[A-Za-z][A-Za-z0-9_]*"


class TopicMistake(Wording):
    """A mistake in an entry for a topic, a service, an action or a node's parameters."""

    INVALID_PORT = "{port} is not a valid {kind}: {range}"
    DEADMAN_WITHOUT_ARM = "only {kind} with arm: true has a deadman: set arm: true, or leave it out"
    ON_END_WITHOUT_ARM = "only {kind} with arm: true has it: set arm: true, or leave it out"
    ON_END_TOO_LONG = "the message has {length} characters, and at most {limit} are allowed: leave out what is 0"
    LIMITS_OF_TYPE = "only Twist and TwistStamped have a velocity, and the type is {name}: leave limits out"
    NOT_FOR_PEER = "the other side cannot get {value}: write at most {limit} printable characters, or leave it out"
    KEEP_OF_ARMED = "nothing of a topic that has to be armed may arrive late: leave keep or arm out"
    KEEP_BEYOND_AGE = "{seconds:g} s are kept, and what is older than {key} is dropped: keep at most {age:g} s"
    KEEP_OF_DATAGRAMS = "{protocol} sends nothing of best effort again: leave protocol out, or set qos: reliable"
    OUT_OF_RANGE = "{value} is out of range: {range}"
    CALL_NEEDS_RELIABLE = "{protocol} may lose messages, and calls must not be lost: leave protocol out"
    NOT_CROSSING = (
        "{protocol} needs a link over {needed} ({chosen_by}), and this one is over {medium}: give {crossing}, or leave "
        "protocol out"
    )
    NEEDS_ADAPTER = (
        "bluetooth needs the MAC of the server's adapter: as server_ip for the whole link, or as bluetooth_address for "
        "such topics"
    )
    NEEDS_CHANNEL = "missing: a bluetooth {noun} of an IP link needs a channel, {range}; several topics may share one"
    PORT_OF_PATTERN = "each name that matches would need its own {kind}: leave port out, so that they share the link's"
    TYPE_OF_OTHER_KIND = "{name} is the type of {kind}: list this entry under {list}"
    NOT_A_TYPE = "{name} is no type of {kind}: write package/{folder}/Name, or leave it out{hint}"
    CALLED_TYPE_TOO_LONG = "{name} is too long for a type name: {length} characters"
    OTHER_NAME = "{name} does not name a route for {purpose}: both sides have to call it {purpose}/NAME"


def range_problems(holder: msgspec.Struct) -> Iterator[Problem]:
    """Yield the numbers outside of their ranges, of a topic or anything else with fields of these names."""
    for name in holder.__struct_fields__:
        key, value = TOPIC_KEYS.get(name), getattr(holder, name)
        if value is not None and key is not None and key.range_text and not key.allows(value):
            yield _out_of_range(key, value)


def _out_of_range(key: TopicKey, value: Any) -> Problem:
    assert key.range_text is not None
    return Problem(key.name, TopicMistake.OUT_OF_RANGE(value=value, range=key.range_text(range=key.limits)))


def _feature_problems(topic: Topic) -> Iterator[Problem]:
    """Yield the mistakes in the values of features' keys."""
    value: Any
    for name, value in topic.features.items():
        if name not in ADDED_KEYS:
            continue
        if value is not None and not TOPIC_KEYS[name].allows(value):
            yield _out_of_range(TOPIC_KEYS[name], value)
        if ADDED_KEYS[name].of_peer and isinstance(value, str) and value != sanitize_text(value, TEXT_LENGTH):
            yield Problem(name, TopicMistake.NOT_FOR_PEER(value=show(value), limit=TEXT_LENGTH))
    yield from (Problem(name, text) for name, text in added("topic_problems", topic))


def port_problems(port: int, key: str, transport: type[TransportTraits]) -> Iterator[Problem]:
    if port and transport.ports is NO_PORT:
        yield Problem(key, f"a link over {transport.medium} has no ports: leave it out")
    elif port not in transport.ports:
        yield Problem(key, TopicMistake.INVALID_PORT(port=port, kind=transport.port_kind, range=transport.ports))


def transport_of(topic: Topic, session: Session | None) -> type[TransportTraits]:
    """Return a topic's transport: its own, or the link's for its QoS. Without a session, the link is an IP link."""
    if topic.protocol is not None:
        return transports.named(topic.protocol)
    link = transports.of_link(session.host if session is not None else "")
    if not link.best_effort or topic.kind != "topic" or topic.keep is not None:
        return link
    try:
        qos = topic.parsed_qos()
    except ValueError:  # a problem of its own
        return link
    return transports.named(link.best_effort) if qos is not None and qos.reliability == "best_effort" else link


# --- entries: of a session file, a proposal, and an internal route


def entry_problems(topic: Topic, session: Session | None = None, *, client: str | None = None) -> list[Problem]:
    """Return all problems of a topic by itself whose values are of the right kinds, as in a peer's proposal.

    Args:
        session: the topic's session, or None if it is not known yet. It tells what the link can carry.
        client: the client's name where it is the prefix of the topic's name on the server.

    Returns:
        The problems; the location of each is the key in a session file: ``protocol``.
    """
    problems = [Problem(field, remedy) for field, remedy in foreign(topic).items()]
    # Texts that are an encryption key by mistake: a topic's name is shown to others.
    harmless = {field: value for field, value in _TEXTS.items() if holds_key(getattr(topic, field))}
    secrets = [Problem(key_of(topic.kind, field), ValueMistake.IS_A_KEY()) for field in harmless]
    for at, name in enumerate(topic.excepts):
        if holds_key(name):
            secrets.append(Problem(join("except", at), ValueMistake.IS_A_KEY()))
    if secrets := unreported(secrets, problems):
        problems += secrets
        kept = tuple(name for name in topic.excepts if not holds_key(name))
        topic = msgspec.structs.replace(topic, **harmless, excepts=kept)
    return problems + unreported(topic_problems(topic, session, client), problems)


def unreported(found: Iterable[Problem], reported: Sequence[Problem]) -> list[Problem]:
    """Leave out consequences of a reported problem: the default in place of its value may break another rule."""

    def within(location: str, outer: str) -> bool:
        return not outer or location == outer or location.startswith((f"{outer}.", f"{outer}["))

    if not reported:
        return [*found]
    locations = [problem.location for problem in reported]
    return [
        new for new in found if not any(within(new.location, old) or within(old, new.location) for old in locations)
    ]


def topic_problems(topic: Topic, session: Session | None, client: str | None) -> Iterator[Problem]:
    """Yield the mistakes in a topic whose fields are all of its kind and hold no key; `entry_problems` finds these.

    Args:
        session: as in `entry_problems`.
        client: as in `entry_problems`.
    """
    yield from topic_name_problems(topic, client)
    yield from _type_problems(topic)
    yield from _transport_problems(topic, session)
    yield from _qos_problems(topic.qos)
    useless_deadman = topic.deadman is not None and not topic.arm
    # A number that has to go has no range to keep: one mistake, one remedy.
    yield from range_problems(msgspec.structs.replace(topic, deadman=None) if useless_deadman else topic)
    if topic.features:
        yield from _feature_problems(topic)
    if useless_deadman:
        yield Problem("deadman", TopicMistake.DEADMAN_WITHOUT_ARM(kind=A_KIND[topic.kind]))
    if topic.on_end is not None and not topic.arm:
        yield Problem("on_end", TopicMistake.ON_END_WITHOUT_ARM(kind=A_KIND[topic.kind]))
    else:
        yield from on_end_problems(end_text(topic.on_end), topic.kind)
    if topic.kind == "topic":  # else it is a key of another kind
        yield from limits_problems(topic.limits, "topic", topic.type, topic.topic)
        yield from _keep_problems(topic, session)
        if topic.beat is not None and topic.beat != (sanitize_text(topic.beat, TEXT_LENGTH) or None):
            message = f"{show(topic.beat)} is no name: write 1 to {TEXT_LENGTH} printable characters, or leave it out"
            yield Problem("beat", message)


def problems_here(topic: Topic, session: Session, *, renamed: bool) -> Iterator[Problem]:
    """Yield the mistakes that a peer's topic has only under this side's name for it, or on this side's link.

    Args:
        renamed: whether this side's name is another one than the peer's, which has been checked.
    """
    if renamed:
        yield from topic_name_problems(topic, None)
    yield from _transport_problems(topic, session)


def internal_problems(entry: Topic, purpose: Purpose, session: Session | None) -> Iterator[Problem]:
    """Yield the mistakes in an internal route, which has the form of a topic's entry, and is in no session.

    Args:
        session: of this side, which tells what the link can carry.
    """
    if not purpose.has_name(entry.topic) or entry.remote_topic not in (None, entry.topic):
        yield Problem("topic", TopicMistake.OTHER_NAME(name=show(entry.topic), purpose=purpose.name))
    if entry.type != purpose.type_name:
        yield Problem("type", f"a route for {purpose.name} carries {purpose.type_name} only")
    for key, default in _OF_TOPICS.items():
        if getattr(entry, key) != default:
            yield Problem(key, f"a route for {purpose.name} has nothing else here: leave it out")
    yield from _transport_problems(entry, session)
    yield from _qos_problems(entry.qos)
    yield from range_problems(entry)


# --- values of an entry


def _keep_problems(topic: Topic, session: Session | None) -> Iterator[Problem]:
    """Yield the mistake in what is kept for a link that is away, of a topic."""
    keep = topic.kept
    if keep is None:
        return
    for key, value, allowed, unit in keep.out_of_range:
        place = join("keep", key) if isinstance(topic.keep, Keep) else "keep"
        yield Problem(place, f"{show(value)} is out of range: {allowed} {unit}, or leave it out")
        return
    if topic.arm:
        yield Problem("keep", TopicMistake.KEEP_OF_ARMED())
        return
    try:
        qos = topic.parsed_qos()
    except ValueError:  # a problem of its own
        qos = None
    ages = {"max_age": topic.max_age or 0.0, "the lifespan in qos": qos.lifespan if qos is not None else 0.0}
    for key, age in ages.items():
        if 0 < age < keep.seconds:
            yield Problem("keep", TopicMistake.KEEP_BEYOND_AGE(seconds=keep.seconds, key=key, age=age))
            return
    if qos is not None and qos.reliability == "best_effort" and not transport_of(topic, session).reliable:
        yield Problem("keep", TopicMistake.KEEP_OF_DATAGRAMS(protocol=topic.protocol))


def _type_problems(topic: Topic) -> Iterator[Problem]:
    """Yield the mistake in the type of an entry; ROS has the types of parameters."""
    name = topic.type
    if topic.kind == "parameters" or name == AUTO:
        return
    if topic.kind == "topic":
        try:
            full = expand_type_name(name)
        except ValueError as error:
            yield Problem("type", str(error))
            return
        if len(full) > TEXT_LENGTH:
            yield Problem("type", f"{show(full)} has {len(full)} characters, and at most {TEXT_LENGTH} are allowed")
        return
    folder = _FOLDERS[topic.kind]
    other: Kind = "action" if topic.kind == "service" else "service"
    if re.fullmatch(rf"{_PART}/{_FOLDERS[other]}/{_PART}", name):
        message = TopicMistake.TYPE_OF_OTHER_KIND(name=show(name), kind=A_KIND[other], list=LISTS[other])
        yield Problem("type", message)
    elif not re.fullmatch(rf"{_PART}/{folder}/{_PART}", name):
        parts = [part for part in name.split("/") if re.fullmatch(_PART, part)]
        hint = Hint.DID_YOU_MEAN(name=f"{parts[0]}/{folder}/{parts[-1]}") if len(parts) > 1 else ""
        message = TopicMistake.NOT_A_TYPE(name=show(name), kind=A_KIND[topic.kind], folder=folder, hint=hint)
        yield Problem("type", message)
    elif len(name) > TEXT_LENGTH - max(len(lane.type_suffix) for lane in LANES[topic.kind]):
        yield Problem("type", TopicMistake.CALLED_TYPE_TOO_LONG(name=show(name), length=len(name)))


def _transport_problems(topic: Topic, session: Session | None) -> Iterator[Problem]:
    protocol = topic.protocol
    if protocol is not None and not transports.named(protocol).reliable and topic.kind != "topic":
        yield Problem("protocol", TopicMistake.CALL_NEEDS_RELIABLE(protocol=protocol))
    elif protocol is not None and session is not None and protocol not in session.crossing:
        link, own = transports.of_link(session.host), transports.named(protocol)
        crossing = [each for each in session.crossing if topic.kind == "topic" or transports.named(each).reliable]
        if protocol == "bluetooth" and link.ip_ports:
            yield Problem("protocol", TopicMistake.NEEDS_ADAPTER())
        else:
            message = TopicMistake.NOT_CROSSING(
                protocol=protocol,
                needed=own.medium,
                chosen_by=own.chosen_by,
                medium=link.medium,
                crossing=" or ".join(crossing),
            )
            yield Problem("protocol", message)
    elif protocol == "bluetooth" and session is not None and not session.is_bluetooth and topic.port is None:
        yield Problem("port", TopicMistake.NEEDS_CHANNEL(noun=KIND_NOUNS[topic.kind], range=CHANNEL))
    if topic.port is not None:
        transport = transport_of(topic, session)
        if topic.is_pattern and not transport.multiplexed:
            yield Problem("port", TopicMistake.PORT_OF_PATTERN(kind=transport.port_kind))
        yield from port_problems(topic.port, "port", transport)


def _qos_problems(value: str | int | dict[str, Any]) -> Iterator[Problem]:
    try:
        parse_qos(value)
    except ValueError as error:
        if isinstance(value, dict):
            problems: list[Problem] = []
            read({key: policy for key, policy in value.items() if key != "profile"}, Qos, problems, "qos")
            yield from problems
            if problems:  # they name the policy, and the remedy
                return
        name = value.get("profile") if isinstance(value, dict) else value
        options = list(PROFILES) if isinstance(value, dict) else [AUTO, *PROFILES]
        hint = did_you_mean(name, options) if isinstance(name, str) else ""
        yield Problem("qos", conceal(f"{error}{hint}"))


def on_end_problems(text: str, kind: Kind | None) -> Iterator[Problem]:
    """Yield the mistake in what a robot gets once an arming ends, as far as it shows without the type.

    Args:
        text: of the line, or empty.
        kind: of the line, or None for a line of every kind.
    """
    if text in ("", END_NONE) or (kind is None and text == END_CANCEL):
        return
    if kind == "action":
        if text != END_CANCEL:
            yield Problem("on_end", f"{show(text)} is neither cancel nor none")
        return
    if kind not in (None, "topic"):
        yield Problem("on_end", "only topics and actions have it: leave it out")
        return
    if text == END_ZERO:
        return
    if len(text) > LONGEST_END:  # before it is read as YAML
        yield Problem("on_end", TopicMistake.ON_END_TOO_LONG(length=len(text), limit=LONGEST_END))
        return
    try:
        fields = read_fields(text) if is_end_message(text) and text.isprintable() else None
    except FieldError as error:
        yield Problem("on_end", conceal(str(error)))
        return
    if not isinstance(fields, dict):
        yield Problem("on_end", f"{show(text)} is neither zero, none nor a message: {{linear: {{x: 0.1}}}}")


def limits_problems(limits: VelocityLimits | None, kind: Kind | None, type_name: str, name: str) -> Iterator[Problem]:
    """Yield the mistakes in what a hand may ask.

    Args:
        kind: of the line, or None for a line of every kind.
        type_name: of the line, or ``auto``.
        name: a name or a pattern.
    """
    if limits is None:
        return
    if kind not in (None, "topic"):
        yield Problem("limits", ForeignKey.OF_TOPICS_ONLY())
        return
    if limits == VelocityLimits():
        yield Problem("limits", "has no number: give linear (m/s), angular (rad/s) or both")
    for key, value, allowed, unit in limits.out_of_range:
        yield Problem(join("limits", key), f"{show(value)} is out of range: {allowed} {unit}, or leave it out")
    if type_name == AUTO:
        if is_pattern(name):
            yield Problem("limits", "a pattern with limits needs type: Twist or type: TwistStamped")
    elif full_type(type_name) not in TWISTS:
        yield Problem("limits", TopicMistake.LIMITS_OF_TYPE(name=show(type_name)))

"""The stages and the verdict of a topic's half: rules over its facts, without a clock or an effect."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.qos import clashes, incompatible
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first, sanitize_text
from rsb_bridge.model.verdict import LASTING, Cause, Verdict
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.age import expired_verdict
from rsb_bridge.route.blocking_rules import ACCEPTED, as_known, first_missing, link_and_acceptance, stage, worst
from rsb_bridge.route.combined_verdict import NODE_LENGTH, NODES, node_names
from rsb_bridge.route.lateness import late_verdict
from rsb_bridge.telemetry.watches import FAST_ABOVE, LATELY

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import Stage
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.age import Expired
    from rsb_bridge.route.blocking_rules import RouteStatus, Rules
    from rsb_bridge.route.lateness import Late
    from rsb_bridge.telemetry.watches import Loss

USE_TCP = "use protocol: tcp"
"""The remedy for messages that are lost on the way."""
STOPPED_PUBLISHING = ("has stopped publishing, or died", "have stopped publishing, or died")
PUBLISHED_NOTHING = ("has published nothing yet", "have published nothing yet")
NOTHING_SINCE_OPENED = (
    "has published nothing since it was reopened",
    "have published nothing since it was reopened",
)
LEFT_OUT_LATCHED = (
    "latches its messages, but this topic is volatile: use qos: auto",
    "latch their messages, but this topic is volatile: use qos: auto",
)
NOT_MATCHED = (
    "does not match the bridge: its partition, ownership or key differs",
    "do not match the bridge: their partition, ownership or key differs",
)
"""Verbs for one silent publisher, and for several."""
_NAMED = 3
"""Nodes that a sentence names."""
_REASON_LENGTH = 200
"""Characters for which a node is deaf: a report to the other side has room for hundreds of routes."""

_SILENCE = frozenset({Cause.PUBLISHER_SILENT, Cause.NO_MESSAGE})
_NO_TYPE = frozenset({Cause.TYPE_UNKNOWN, Cause.TYPE_CONFLICT})
_EXPLAINS_SILENCE = frozenset({Cause.QOS_INCOMPATIBLE, Cause.TYPE_CONFLICT})
"""Where a publisher's messages are not taken, it is not silent."""
_LOSSES: dict[str, tuple[Cause, str]] = {
    "queue full": (
        Cause.QUEUE_FULL,
        "more is published than the link carries: set max_rate, compression: zstd or priority",
    ),
    "too large": (
        Cause.TOO_LARGE,
        "they are larger than its transport carries",
    ),
    "publish failed": (Cause.NOT_PUBLISHED, "the receiving side cannot publish them; its log says why"),
    "latched full": (Cause.NOT_PUBLISHED, "the receiving side keeps no more latched messages for this link"),
    "slow subscriber": (Cause.NOT_PUBLISHED, "a subscriber there does not take its messages: restart it"),
    "malformed": (Cause.NOT_PUBLISHED, "they are malformed: see what publishes them"),
    "too complex": (Cause.NOT_PUBLISHED, "they have more strings and sequences than are checked there: send less"),
    "expands too much": (Cause.NOT_PUBLISHED, "they expand too much there: send less, or without compression"),
}
LOSS_CAUSES = frozenset({Cause.LOSSY, *(cause for cause, _ in _LOSSES.values())})


class TopicProgress(NamedTuple):
    """The progress of a topic's messages, as one half knows it.

    Attributes:
        endpoints: the topic's publishers on the sending side, its subscriptions on the receiving side.
        publishers: number of publishers on the sending side, or None if it is unknown.
        loop_note: the publishers that are left out because their messages would loop, as the end of a sentence.
        similar: a published topic of the sending side with a similar name, which may be meant, or empty.
        described: whether the sender has described its messages in this opening, so that `type_name` and `qos` hold.
        type_name: of its messages, as last known, or empty.
        qos: of its subscription and publishers, as last known, or None.
        unresolved: on the sending side, the cause why type or QoS is unknown, or None.
        why_unresolved: the same in words, or the other side's reason.
        clash: on the receiving side, the reason why a subscription does not match `qos`, or empty.
        subscribe_failed: the reason why its subscription failed, or empty.
        unmatched: whether DDS matches none of the endpoints with this half.
        sent: messages of this opening.
        received: messages of this opening.
        published: messages of this opening.
        kept: whether the receiving side keeps messages of a latched topic.
        undelivered: the reason why the newest message was too large to be sent, on the receiving side why none was
            received, or empty.
        subscribers: subscriptions on the receiving side that DDS has matched, which may be known before their nodes
            are, or None if their number is unknown.
        deaf: some of the subscribers that do not match.
        others: on the receiving side, other publishers of the topic, if a subscription does not match.
        clocks: on the receiving side, if it is a clock, the nodes and links that publish it besides this link.
    """

    endpoints: Collection[Endpoint] = ()
    publishers: int | None = None
    loop_note: str = ""
    similar: str = ""
    described: bool = False
    type_name: str = ""
    qos: Qos | None = None
    unresolved: Cause | None = None
    why_unresolved: str = ""
    clash: str = ""
    subscribed: bool = False
    subscribe_failed: str = ""
    unmatched: bool = False
    sent: int = 0
    received: int = 0
    published: int = 0
    kept: bool = False
    undelivered: str = ""
    subscribers: int | None = None
    deaf: Collection[object] = ()
    others: Collection[Endpoint] = ()
    clocks: Collection[str] = ()


class Facts(NamedTuple):
    """One half's knowledge of its topic.

    Attributes:
        status: the part that does not depend on what the route carries.
        left_out: the publishers with another type, which are not bridged, or empty.
        stale_since: s, of the last message if silence counts and has lasted `stale_after`, or None.
        stopped_since: s, of the last message if its publishers have stopped, or None.
        new: ids of the publishers that have come since the last message.
        slow_since: s, when it became slow, or None.
        rate: Hz, of the messages that are sent.
        expected_rate: Hz, to judge the rate by, or None.
        lost_in_dds: messages that DDS lost in the last `LATELY` s before they could be taken.
        loss: between the two sides, or None if it is negligible.
        datagrams: about how many a message takes, or 0 if its transport has none.
        remedy_for_size: what to do about messages that are too large.
        armed: whether it has to be armed: then TCP would lose more of it, since late messages are dropped.
        expired: the messages that were dropped lately because they were too old, or None if they are few.
        full: the rates of the link if it is full, or None.
        malformed: the field of the last malformed message, and what is wrong with it, or empty.
        loss_unexplained: whether it is not known yet if `loss` is due to a full link.
        loss_of_full_link: whether the link was full since `loss` began, and has room now.
        shown_cause: the cause that was shown last, or empty.
    """

    status: RouteStatus
    progress: TopicProgress = TopicProgress()
    left_out: str = ""
    stale_since: float | None = None
    stopped_since: float | None = None
    new: Collection[bytes] = ()
    slow_since: float | None = None
    rate: float = 0.0
    expected_rate: float | None = None
    lost_in_dds: int = 0
    loss: Loss | None = None
    datagrams: int = 0
    remedy_for_size: str = ""
    armed: bool = False
    late: Late | None = None
    expired: Expired | None = None
    full: Fullness | None = None
    malformed: str = ""
    loss_unexplained: bool = False
    loss_of_full_link: bool = False
    shown_cause: str = ""


class DeafText(Wording):
    """Reasons why DDS does not match a subscription with a publisher."""

    TYPE = "its type is {asked}, not {offered}: correct it"
    QOS = "it asks for {asked}, offered is {offered}: change its QoS"
    UNMATCHED = "DDS does not match it: check its other policies, partition and security"


class Mismatch(NamedTuple):
    """A reason why a subscription does not hear a publisher.

    Attributes:
        cause: `Cause.TYPE_CONFLICT` or `Cause.QOS_INCOMPATIBLE`.
        offered: the publisher's type, or its policies that do not suffice.
        asked: the subscription's, in the same order.
    """

    cause: Cause
    offered: tuple[str, ...]
    asked: tuple[str, ...]


def mismatch(type_name: str, offered: Qos, subscription: Endpoint) -> Mismatch | None:
    """Return what keeps a subscription from hearing a publisher of a type and a QoS, or None if DDS matches them."""
    if subscription.type_name != type_name:
        return Mismatch(Cause.TYPE_CONFLICT, (type_name,), (subscription.type_name,))
    found = clashes(offered, subscription.qos)
    return Mismatch(Cause.QOS_INCOMPATIBLE, *zip(*found, strict=True)) if found else None


def audience(type_name: str, offered: Qos, subscriptions: Iterable[Endpoint], count: int) -> Audience:
    """Return who hears a publisher of a type and a QoS.

    Args:
        count: subscriptions that DDS has matched with it. DDS does not say which.
    """
    hearing: list[Endpoint] = []
    deaf: set[tuple[str, str, str]] = set()
    for each in subscriptions:
        node = sanitize_text(each.node, NODE_LENGTH)
        if (why := mismatch(type_name, offered, each)) is not None:
            text = DeafText.TYPE if why.cause is Cause.TYPE_CONFLICT else DeafText.QOS
            reason = text(asked=", ".join(why.asked), offered=", ".join(why.offered))
            deaf.add((node, why.cause.value, sanitize_text(reason, _REASON_LENGTH)))
        elif not count:
            deaf.add((node, Cause.NONE.value, DeafText.UNMATCHED()))
        else:
            hearing.append(each)
    return Audience(count, node_names(hearing), tuple(Deaf(*each) for each in sorted(deaf)[:NODES]))


def judge(facts: Facts) -> Verdict:
    """Return the verdict that counts; of silence, its explanation."""
    verdict, found = worst(facts.status, _OF_SENDER if facts.status.sends else _OF_RECEIVER, facts)
    if verdict.cause in _SILENCE:
        explained = next((each for each in found if each.cause in _EXPLAINS_SILENCE), None)
        return verdict if explained is None else replace(explained, state=verdict.state)
    return verdict


def no_publisher(topic: str, domain_id: int, similar: str = "", *, gone: bool = False) -> str:
    """Says that nobody publishes a topic, or no longer."""
    hint = f"; did you mean {similar}?" if similar else ""
    return f"no publisher of {topic} in domain {domain_id}{' any more' if gone else ''}{hint}"


def no_subscriber(topic: str, where: str, present: Collection[object] = ()) -> str:
    """Says that nobody hears a topic, whether somebody subscribes to it or not."""
    return (
        f"nothing from the bridge reaches the subscribers of {topic} {where}"
        if present
        else f"nobody subscribes to {topic} {where}"
    )


def topic_stages(status: RouteStatus, progress: TopicProgress) -> tuple[Stage, ...]:
    """Return the stages from the publisher to the subscriber, in order."""
    known = progress.described if status.sends else bool(progress.type_name)
    clash = _qos_clash(progress) if status.sends else progress.clash
    failure = status.loop or progress.subscribe_failed
    stages = (
        stage(
            "publisher seen",
            bool(progress.publishers),
            _why_none_seen(status, progress),
            failed=progress.publishers == 0,
            note=f"{progress.publishers}{progress.loop_note}" if status.sends else "",
        ),
        stage(
            "type known",
            known,
            progress.why_unresolved,
            failed=not known and progress.unresolved in _NO_TYPE,
            note=progress.type_name,
        ),
        stage("QoS compatible", known and not clash, clash, failed=known and bool(clash)),
        stage("subscribed", progress.subscribed, failure, failed=bool(failure)),
        *link_and_acceptance(status),
        stage("sent", progress.sent > 0 or progress.kept, progress.undelivered if status.sends else ""),
        stage("received", progress.received > 0 or progress.kept, progress.undelivered, note=progress.undelivered),
        stage("published", progress.published > 0 or progress.kept),
        stage("subscriber seen", bool(progress.subscribers), _why_none_hears(status, progress)),
    )
    return as_known(status, stages)


def waits_for(status: RouteStatus, progress: TopicProgress) -> str:
    """Return the stage that has to pass before anything can cross, or its reason."""
    stages = topic_stages(status, progress)
    if not status.sends and progress.publishers is None and all(each.done is not False for each in stages):
        # Only the sending side knows the first stages, and has not reported on this opening yet.
        return "the other side's report" if status.accepted else ACCEPTED
    return first_missing(stages)


def _why_none_seen(status: RouteStatus, progress: TopicProgress) -> str:
    if status.sends:
        return no_publisher(status.topic, status.domain_id, progress.similar)
    return "" if progress.publishers is None else f"no publisher of {status.far_topic} on the other side"


def _why_none_hears(status: RouteStatus, progress: TopicProgress) -> str:
    if progress.subscribers is None:
        return ""
    topic, where = (status.far_topic, "there") if status.sends else (status.topic, f"in domain {status.domain_id}")
    return no_subscriber(topic, where, progress.deaf)


def _qos_clash(progress: TopicProgress) -> str:
    """Return the reason why a subscription on the sending side misses messages of the type, or an empty string."""
    if progress.qos is None:
        return ""
    clashing = (
        incompatible(each.qos, progress.qos) for each in progress.endpoints if each.type_name == progress.type_name
    )
    return next(filter(None, clashing), "")


def named(nodes: Iterable[str]) -> str:
    """``/a``, ``/a and /b``, ``/a, /b, /c and 2 more``."""
    return join_first(sorted({node or "a node that is not known yet" for node in nodes}), _NAMED) or "nobody"


def nodes_by(endpoints: Iterable[Endpoint], what: Callable[[Endpoint], str]) -> dict[str, set[str]]:
    """Group endpoints' nodes by a property of the endpoint. Endpoints without it are left out."""
    nodes: dict[str, set[str]] = {}
    for each in endpoints:
        if key := what(each):
            nodes.setdefault(key, set()).add(each.node)
    return dict(sorted(nodes.items()))


def types_and_nodes(endpoints: Iterable[Endpoint]) -> str:
    """``/a has pkg/msg/A and /b has pkg/msg/B``."""
    nodes: dict[str, list[str]] = {}
    for endpoint in endpoints:
        nodes.setdefault(endpoint.type_name, []).append(endpoint.node)
    return join_first([f"{named(who)} has {type_name}" for type_name, who in sorted(nodes.items())], _NAMED)


# --- either side


def _stale(facts: Facts) -> Verdict | None:
    # STOPPED says the same, and the expected rate.
    if (since := facts.stale_since) is None or _stopped(facts) is not None:
        return None
    text = f"nothing for {LASTING}"
    if not facts.status.sends:
        return Verdict(State.STALE, Cause.SILENT, text, since)
    cause, why = _why_silent(facts)
    return Verdict(State.STALE, cause, f"{text}: {why}", since)


def _why_silent(facts: Facts) -> tuple[Cause, str]:
    """Explain the silence. DDS lists a publisher for up to 40 s after its death, so it may not run any more."""
    ever = facts.status.came or facts.status.came_before
    if facts.progress.endpoints and facts.progress.unmatched:
        return Cause.PUBLISHER_SILENT, _plural(facts.progress.endpoints, *NOT_MATCHED)
    if facts.progress.endpoints:
        # A publisher that has just come has had no time for its first message.
        stopped = [each for each in facts.progress.endpoints if each.gid not in facts.new] if ever else []
        who, silent = (stopped, STOPPED_PUBLISHING) if stopped else (facts.progress.endpoints, PUBLISHED_NOTHING)
        return Cause.PUBLISHER_SILENT, _plural(who, *silent)
    if ever:
        return Cause.PUBLISHER_GONE, _publisher_gone(facts)
    return _nobody(facts), no_publisher(facts.status.topic, facts.status.domain_id, facts.progress.similar)


def _publisher_gone(facts: Facts) -> str:
    return no_publisher(facts.status.topic, facts.status.domain_id, facts.progress.similar, gone=True)


def _nobody(facts: Facts) -> Cause:
    return Cause.SIMILAR_NAME if facts.progress.similar else Cause.NO_PUBLISHER


def _waiting(facts: Facts) -> Verdict | None:
    flows = facts.status.crossing.flows
    if facts.status.came and flows:
        return None
    if facts.status.sends and flows and not facts.progress.endpoints:
        text = no_publisher(facts.status.topic, facts.status.domain_id, facts.progress.similar)
        return Verdict(State.WAITING, _nobody(facts), text)
    if facts.status.sends and flows:
        verbs = NOTHING_SINCE_OPENED if facts.status.came_before else PUBLISHED_NOTHING
        if (
            facts.progress.qos
            and not facts.progress.qos.latched
            and all(p.qos.latched for p in facts.progress.endpoints)
        ):
            verbs = LEFT_OUT_LATCHED  # they may well have published, before the subscription
        elif facts.progress.unmatched:
            verbs = NOT_MATCHED
        text = _plural(facts.progress.endpoints, *verbs)
        return Verdict(State.WAITING, Cause.PUBLISHER_SILENT, text)
    missing = "" if flows else waits_for(facts.status, facts.progress)
    text = f"waiting: {missing}" if missing else "no message yet"
    return Verdict(State.WAITING, Cause.NO_MESSAGE, text)


def _late(facts: Facts) -> Verdict | None:
    return late_verdict(facts.late) if facts.late is not None else None


def _expired(facts: Facts) -> Verdict | None:
    return expired_verdict(facts.expired) if facts.expired is not None else None


# --- the sending side


def _subscription(facts: Facts) -> Verdict | None:
    failure = facts.progress.subscribe_failed
    if not failure:
        return None
    return Verdict(State.DOWN, Cause.SUBSCRIBE_FAILED, failure)


def _publishers_qos(facts: Facts) -> Verdict | None:
    qos = facts.progress.qos
    if qos is None or not facts.progress.described:
        return None
    ours = [each for each in facts.progress.endpoints if each.type_name == facts.progress.type_name]
    others = [each for each in ours if clashes(each.qos, qos)]
    if not others:
        return None
    offer, asked = zip(*clashes(others[0].qos, qos), strict=True)
    whose = "its" if len({each.node for each in others}) == 1 else "their"
    text = (
        f"{_plural(others, 'offers', 'offer')} {', '.join(offer)}, but this topic asks for {', '.join(asked)}: "
        f"{whose} messages are not received; set qos: auto for this topic"
    )
    # If some publishers are heard, the topic is not down.
    all_of_them = len(others) == len(ours)
    return Verdict(State.DOWN if all_of_them else State.UNHEARD, Cause.QOS_INCOMPATIBLE, text)


def _publishers_types(facts: Facts) -> Verdict | None:
    return Verdict(State.UNHEARD, Cause.TYPE_CONFLICT, facts.left_out) if facts.left_out else None


def _unresolved(facts: Facts) -> Verdict | None:
    cause = facts.progress.unresolved
    if cause is None or facts.status.crossing.flows or not facts.status.accepted:
        return None
    if cause is Cause.NO_PUBLISHER:
        cause = _nobody(facts)
    return Verdict(State.DOWN if cause is Cause.TYPE_CONFLICT else State.WAITING, cause, facts.progress.why_unresolved)


def _stopped(facts: Facts) -> Verdict | None:
    since = facts.stopped_since
    if since is None or facts.expected_rate is None:
        return None
    cause, why = _why_silent(facts)
    text = f"nothing for {LASTING}, {facts.expected_rate:.3g} Hz expected: {why}"
    return Verdict(State.STOPPED, cause, text, since)


def _departed(facts: Facts) -> Verdict | None:
    """Judge a topic whose publisher has left while no message was due."""
    if not facts.status.came or facts.progress.endpoints or not facts.status.crossing.flows:
        return None
    return Verdict(State.OK, Cause.PUBLISHER_GONE, _publisher_gone(facts))


def _steady_figure(rate: float) -> str:
    """Format a rate that changes each second with as many digits as before: ``2.00``, ``20.3``."""
    return f"{rate:#.3g}".rstrip(".")


def _slow(facts: Facts) -> Verdict | None:
    if facts.slow_since is None or facts.expected_rate is None:
        return None
    rates = f"{_steady_figure(facts.rate)} Hz of {facts.expected_rate:.3g} expected"
    if facts.rate >= FAST_ABOVE * facts.expected_rate:  # the watch waits before it ends the fault
        if facts.shown_cause != Cause.SLOW:
            return None  # a fault that nobody was shown needs no end
        return Verdict(State.SLOW, Cause.SLOW, f"recovering after {LASTING}: {rates}", facts.slow_since)
    text = f"{rates}, for {LASTING}"
    if facts.lost_in_dds > (facts.expected_rate - facts.rate) * LATELY / 2:  # DDS lost most of the missing messages
        reason = f"DDS lost {facts.lost_in_dds:,} messages before they could be taken"
    else:
        reason = f"that is all that {_plural(facts.progress.endpoints, 'publishes', 'publish')}"
    return Verdict(State.SLOW, Cause.SLOW, f"{text}: {reason}", facts.slow_since)


def _remedy_for_loss(facts: Facts) -> str:
    """Return what to do about lost datagrams, or nothing while the link may be full: then both remedies do harm."""
    if facts.loss_unexplained or (facts.armed and facts.datagrams == 1):
        return ""
    if facts.datagrams > 1:
        return f"; each takes {facts.datagrams} datagrams, and is lost if one of them is: {USE_TCP} or smaller messages"
    return f"; {USE_TCP}"


def _lossy(facts: Facts) -> Verdict | None:
    loss = facts.loss
    if loss is None or (facts.expired is not None and facts.expired.lost > loss.lost):
        return None  # most of what did not come was too old, which `_expired` tells
    cause, why = _LOSSES.get(loss.cause, (Cause.LOSSY, f"lost on the way{_remedy_for_loss(facts)}"))
    if loss.cause == "malformed" and facts.malformed:
        why = f"they are malformed ({facts.malformed}): see what publishes them"
    # The cause stays that of the ledger: a full link loses datagrams on the way, where this side has no queue.
    if facts.full is not None and cause in (Cause.LOSSY, Cause.QUEUE_FULL):
        why = f"the link is full ({facts.full.share}): set max_rate, compression: zstd or priority"
    elif facts.loss_of_full_link and cause is Cause.LOSSY:
        why = "the link was full"
    elif cause is Cause.TOO_LARGE:
        why += f": {facts.remedy_for_size}"
    # The figures still contain the losses before the recovery.
    if loss.recovering:
        if facts.shown_cause not in LOSS_CAUSES:
            return None  # a fault that nobody was shown needs no end
        return Verdict(State.SLOW, cause, f"recovering after {LASTING}: most messages arrive again", loss.since)
    if loss.lost >= loss.of:
        text = f"none of the last {loss.of:,} messages arrived"
        return Verdict(State.DOWN, cause, f"{text}, for {LASTING}: {why}", loss.since)
    text = f"{loss.lost:,} of the last {loss.of:,} messages ({loss.share:.0%}) did not arrive"
    return Verdict(State.SLOW, cause, f"{text}, for {LASTING}: {why}", loss.since)


def _too_large(facts: Facts) -> Verdict | None:
    """Judge what `_lossy` cannot: the newest message of a latched topic, or one before any was sent."""
    progress = facts.progress
    if not progress.undelivered or not facts.status.crossing.flows:
        return None
    some = progress.sent > 0 or progress.kept
    if some and not (progress.qos is not None and progress.qos.latched):
        return None
    return Verdict(State.SLOW if some else State.DOWN, Cause.TOO_LARGE, progress.undelivered)


# --- the receiving side


def _subscribers(facts: Facts) -> Verdict | None:
    progress, qos = facts.progress, facts.progress.qos
    if qos is None or not (progress.described and progress.type_name):
        return None
    deaf = {each: why for each in progress.endpoints if (why := mismatch(progress.type_name, qos, each)) is not None}
    if others := [each for each, why in deaf.items() if why.cause is Cause.TYPE_CONFLICT]:
        carries = f"{facts.status.topic} carries {progress.type_name}"
        text = f"{types_and_nodes(others)}, but {carries}: correct the subscription"
        return Verdict(State.UNHEARD, Cause.TYPE_CONFLICT, text)
    if deaf:
        first = next(iter(deaf.values()))
        alike = [each for each, why in deaf.items() if why == first]
        who = _plural(alike, "asks", "ask", "subscriptions")
        text = (
            f"{who} for {', '.join(first.asked)}, but {facts.status.topic} is published with "
            f"{', '.join(first.offered)}{_hears_instead(progress, alike)}: "
            "change the QoS of the subscription, or of the publishers and this topic"
        )
        return Verdict(State.UNHEARD, Cause.QOS_INCOMPATIBLE, text)
    if progress.unmatched and facts.status.came:
        return Verdict(State.UNHEARD, Cause.NO_SUBSCRIBER, _plural(progress.endpoints, *NOT_MATCHED, "subscriptions"))
    if not progress.endpoints and not progress.subscribers and facts.status.came:
        return Verdict(
            State.UNHEARD, Cause.NO_SUBSCRIBER, no_subscriber(facts.status.topic, f"in domain {facts.status.domain_id}")
        )
    return None


def _clocks(facts: Facts) -> Verdict | None:
    if not facts.progress.clocks:
        return None
    text = (
        f"{facts.status.topic} also comes from {named(facts.progress.clocks)}, so its time jumps back and forth: "
        "keep one source, or set use_name on the server"
    )
    return Verdict(State.UNHEARD, Cause.SEVERAL_CLOCKS, text)


def _hears_instead(progress: TopicProgress, deaf: Collection[Endpoint]) -> str:
    """Return what subscribers that do not match hear of other publishers, and who hears this topic, as a clause."""
    assert progress.qos is not None
    nodes = {each.node for each in deaf}
    others = {p.node for p in progress.others if any(not clashes(p.qos, each.qos) for each in deaf)}
    hearing = {each.node for each in progress.endpoints if not clashes(progress.qos, each.qos)} - nodes
    clause = f", so that {'it hears' if len(nodes) == 1 else 'they hear'} only {named(others)}" if others else ""
    if hearing:
        clause += f", while {named(hearing)} {'hears' if len(hearing) == 1 else 'hear'} this topic"
    return clause


def _plural(endpoints: Collection[Endpoint], one: str, several: str, what: str = "publishers") -> str:
    """Name the nodes, with a verb for their number; count the endpoints if some nodes have several.

    Args:
        one: the verb for one node.
        several: the verb for several nodes.
        what: the plural of the endpoints' kind.
    """
    nodes = {each.node for each in endpoints}
    count = "" if len(endpoints) == len(nodes) else f" ({len(endpoints)} {what})"
    return f"{named(nodes)}{count} {one if len(nodes) == 1 else several}"


_OF_SENDER: Rules[Facts] = (
    _subscription,
    _publishers_qos,
    _publishers_types,
    _unresolved,
    _lossy,
    _too_large,
    _stale,
    _stopped,
    _expired,
    _late,
    _slow,
    _waiting,
    _departed,
)
_OF_RECEIVER: Rules[Facts] = (_stale, _expired, _late, _clocks, _subscribers, _waiting)

"""The verdict of a topic's half: rules that only read its facts."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rsb_bridge.model.names import is_bridge
from rsb_bridge.model.qos import clashes
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first
from rsb_bridge.model.verdict import LASTING, Cause, Verdict
from rsb_bridge.ros.memory import profile_for_large
from rsb_bridge.route.age import expired_verdict
from rsb_bridge.route.blocking_rules import ACCEPTED, first_missing
from rsb_bridge.route.combined_verdict import NAMED, named, who_publish
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.lateness import late_verdict
from rsb_bridge.route.ledger import LOSS_CAUSES, LOSSES
from rsb_bridge.route.listeners import OF_MANY, mismatch, no_subscriber, why_unmatched
from rsb_bridge.route.resolving import no_publisher
from rsb_bridge.route.sending import USE_TCP, remedy_for_size
from rsb_bridge.telemetry.watches import FAST_ABOVE, LATELY

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import Driver
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.half import Rules
    from rsb_bridge.route.topic_facts import ReceiverFacts, SenderFacts, TopicFacts

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
MAY_BE_LOST = (
    "has published nothing yet, or DDS loses its messages",
    "have published nothing yet, or DDS loses their messages",
)
"""Verbs for one silent publisher, and for several."""
_LARGE = frozenset(
    {
        "nav_msgs/msg/OccupancyGrid",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/PointCloud",
        "sensor_msgs/msg/PointCloud2",
        "stereo_msgs/msg/DisparityImage",
    }
)
_ARRAY = "MultiArray"
"""Types whose messages are larger than `_FRAGMENT`, usually, and the end of the names of others."""
_FRAGMENT = 64_000
"""Bytes of a message, about, from which on Fast DDS sends it in fragments. A lost one is a lost message."""
_REMEDY_FOR_LARGE = "if they are large, start both ends with {variable}=…/{file} (docs/performance.md)"


def _types_and_nodes(endpoints: Iterable[Endpoint]) -> str:
    """``/a has pkg/msg/A and /b has pkg/msg/B``."""
    nodes: dict[str, list[str]] = {}
    for endpoint in endpoints:
        nodes.setdefault(endpoint.type_name, []).append(endpoint.node)
    return join_first([f"{named(who)} has {type_name}" for type_name, who in sorted(nodes.items())], NAMED)


# --- either side


def _expired(half: TopicFacts, crossing: Crossing) -> Verdict | None:
    expired = half.route.age.late() if crossing.flows else None
    return None if expired is None else expired_verdict(expired)


def _late(half: TopicFacts, crossing: Crossing) -> Verdict | None:
    late = half.late() if crossing.flows else None
    return None if late is None else late_verdict(late)


def _several(half: TopicFacts, _: Crossing) -> Verdict | None:
    drivers = half.flow.drivers
    if not (drivers.here or drivers.there) or not (several := drivers.several):
        return None
    text = f"{_driver_names(several)} publish it: a robot follows all; stop all but one"
    return Verdict(State.OK, Cause.SEVERAL_PUBLISHERS, text)


def _shared(half: SenderFacts, _: Crossing) -> Verdict | None:
    type_name, drivers = half.carried.type_name, half.flow.drivers
    own = [each for each in half.carried.endpoints if each.type_name == type_name and not is_bridge(each.node)]
    if len(own) < 2 or type_name in OF_MANY or drivers.are_watched or not half.route.meter.regular:
        return None
    text = f"{_plural(own, 'publishes', 'publish')} it: subscribers get all; stop those that are not meant"
    return Verdict(State.OK, Cause.SEVERAL_PUBLISHERS, text)


def _driver_names(drivers: Collection[Driver]) -> str:
    """Name drivers, and the side of each if they are on both: ``/nav here and /joystick there``."""
    both = len({each.here for each in drivers}) > 1
    where = {True: " here" if both else "", False: " there"}
    names = ("messages by hand" if each.by_hand else each.name or "a node that is not known yet" for each in drivers)
    return join_first([name + where[each.here] for name, each in zip(names, drivers, strict=True)], NAMED)


# --- the sending side


def _subscription(half: SenderFacts, _: Crossing) -> Verdict | None:
    failure = half.subscription.failure
    return Verdict(State.DOWN, Cause.SUBSCRIBE_FAILED, failure) if failure else None


def _publishers_qos(half: SenderFacts, _: Crossing) -> Verdict | None:
    qos = half.flow.qos
    if qos is None or not half.route.life.described:
        return None
    others = [
        each for each in half.carried.endpoints if each.type_name == half.carried.type_name and clashes(each.qos, qos)
    ]
    if not others:
        return None
    offer, asked = zip(*clashes(others[0].qos, qos), strict=True)
    whose = "its" if len({each.node for each in others}) == 1 else "their"
    text = (
        f"{_plural(others, 'offers', 'offer')} {', '.join(offer)}, but this topic asks for {', '.join(asked)}: "
        f"{whose} messages are not received; set qos: auto for this topic"
    )
    # If some publishers are heard, the topic is not down.
    all_of_them = len(others) == sum(each.type_name == half.carried.type_name for each in half.carried.endpoints)
    return Verdict(State.DOWN if all_of_them else State.UNHEARD, Cause.QOS_INCOMPATIBLE, text)


def _publishers_types(half: SenderFacts, _: Crossing) -> Verdict | None:
    left_out = half.route.notices.warning
    return Verdict(State.UNHEARD, Cause.TYPE_CONFLICT, left_out) if left_out else None


def _unresolved(half: SenderFacts, crossing: Crossing) -> Verdict | None:
    if crossing.flows or not half.route.life.accepted or (cause := half.unresolved) is None:
        return None
    if cause is Cause.NO_PUBLISHER:
        cause = _nobody(half)
    state = State.DOWN if cause is Cause.TYPE_CONFLICT else State.WAITING
    return Verdict(state, cause, half.resolver.why())


def _lossy(half: SenderFacts, crossing: Crossing) -> Verdict | None:
    loss = half.health.losses.loss
    if loss is None:
        return None
    expired = half.route.age.late() if crossing.flows else None
    if expired is not None and expired.lost > loss.lost:
        return None  # most of what did not come was too old, which `_expired` tells
    cause, why = LOSSES.get(loss.cause, (Cause.LOSSY, f"lost on the way{_remedy_for_loss(half)}"))
    if loss.cause == "malformed" and half.malformed:
        why = f"they are malformed ({half.malformed}): see what publishes them"
    full = half.route.link_full
    # The cause stays that of the ledger: a full link loses datagrams on the way, where this side has no queue.
    if full is not None and cause in (Cause.LOSSY, Cause.QUEUE_FULL):
        why = f"the link is full ({full.share}): set max_rate, compression: zstd or priority"
    elif cause is Cause.LOSSY and half.flow.was_full_since(loss.since):
        why = "the link was full"
    elif cause is Cause.TOO_LARGE:
        why += f": {remedy_for_size(half.route.transport, half.route.proposal)}"
    # The figures still contain the losses before the recovery.
    if loss.recovering:
        if half.route.judged.shown_cause not in LOSS_CAUSES:
            return None  # a fault that nobody was shown needs no end
        return Verdict(State.SLOW, cause, f"recovering after {LASTING}: most messages arrive again", loss.since)
    if loss.lost >= loss.of:
        text = f"none of the last {loss.of:,} messages arrived"
        return Verdict(State.DOWN, cause, f"{text}, for {LASTING}: {why}", loss.since)
    text = f"{loss.lost:,} of the last {loss.of:,} messages ({loss.share:.0%}) did not arrive"
    return Verdict(State.SLOW, cause, f"{text}, for {LASTING}: {why}", loss.since)


def _remedy_for_loss(half: SenderFacts) -> str:
    """Return what to do about lost datagrams, or nothing while the link may be full: then both remedies do harm."""
    datagrams = half.datagrams()
    # TCP would lose more of what has to be armed, since late messages are dropped.
    if half.loss_unexplained or (half.route.arming.required and datagrams == 1):
        return ""
    if datagrams > 1:
        return f"; each takes {datagrams} datagrams, and is lost if one of them is: {USE_TCP} or smaller messages"
    return f"; {USE_TCP}"


def _too_large(half: SenderFacts, crossing: Crossing) -> Verdict | None:
    """Judge what `_lossy` cannot: the newest message of a latched topic, or one before any was sent."""
    undelivered = half.route.notices.undelivered
    if not undelivered or not crossing.flows:
        return None
    some = half.has_sent
    if some and not (half.flow.qos is not None and half.flow.qos.latched):
        return None
    return Verdict(State.SLOW if some else State.DOWN, Cause.TOO_LARGE, undelivered)


def _stale(half: SenderFacts, crossing: Crossing) -> Verdict | None:
    # STOPPED says the same, and the expected rate.
    if (since := half.stale_since(crossing)) is None or _stopped(half, crossing) is not None:
        return None
    cause, why = _why_silent(half)
    return Verdict(State.STALE, cause, f"nothing for {LASTING}: {why}", since)


def _stopped(half: SenderFacts, _: Crossing) -> Verdict | None:
    since, expected = half.health.stop.since, half.health.expected_rate
    if since is None or expected is None:
        return None
    cause, why = _why_silent(half)
    return Verdict(State.STOPPED, cause, f"nothing for {LASTING}, {expected:.3g} Hz expected: {why}", since)


def _why_silent(half: SenderFacts) -> tuple[Cause, str]:
    """Explain the silence. DDS lists a publisher for up to 40 s after its death, so it may not run any more."""
    ever = half.came or half.came_before
    if half.carried.endpoints and half.subscription.is_unmatched:
        return Cause.UNMATCHED, _unmatched(half.carried.endpoints, refused=half.subscription.refuses)
    if half.carried.endpoints:
        # A publisher that has just come has had no time for its first message.
        stopped = [each for each in half.carried.endpoints if each.gid not in half.health.stop.new] if ever else []
        return (Cause.PUBLISHER_SILENT, _plural(stopped, *STOPPED_PUBLISHING)) if stopped else _nothing_yet(half)
    return Cause.PUBLISHER_GONE if ever else _nobody(half), _no_publisher(half, gone=ever)


def _nothing_yet(half: SenderFacts) -> tuple[Cause, str]:
    """Explain that nothing has come of the present publishers."""
    endpoints, verbs = half.carried.endpoints, NOTHING_SINCE_OPENED if half.came_before else PUBLISHED_NOTHING
    if half.flow.qos and not half.flow.qos.latched and all(each.qos.latched for each in endpoints):
        verbs = LEFT_OUT_LATCHED  # they may well have published, before the subscription
    elif not half.came_before and _may_get_lost(half):
        variable, file = profile_for_large(os.environ)
        remedy = _REMEDY_FOR_LARGE.format(variable=variable, file=file)
        return Cause.PUBLISHER_UNHEARD, f"{_plural(endpoints, *MAY_BE_LOST)}: {remedy}"
    return Cause.PUBLISHER_SILENT, _plural(endpoints, *verbs)


def _nobody(half: SenderFacts) -> Cause:
    elsewhere = half.resolver.elsewhere
    return Cause.NO_PUBLISHER if elsewhere is None else elsewhere.cause


def _no_publisher(half: SenderFacts, *, gone: bool = False) -> str:
    return no_publisher(half.route.local_topic, half.route.context.domain, half.resolver.elsewhere, gone=gone)


def _slow(half: SenderFacts, _: Crossing) -> Verdict | None:
    since, expected = half.health.slow.since, half.health.expected_rate
    if since is None or expected is None:
        return None
    rate = half.route.meter.rate
    rates = f"{_steady_figure(rate)} Hz of {expected:.3g} expected"
    if rate >= FAST_ABOVE * expected:  # the watch waits before it ends the fault
        if half.route.judged.shown_cause != Cause.SLOW:
            return None  # a fault that nobody was shown needs no end
        return Verdict(State.SLOW, Cause.SLOW, f"recovering after {LASTING}: {rates}", since)
    lost_in_dds = half.health.lost_in_dds()
    if lost_in_dds > (expected - rate) * LATELY / 2:  # DDS lost most of the missing messages
        reason = f"DDS lost {lost_in_dds:,} messages before they could be taken"
    else:
        reason = f"that is all that {_plural(half.carried.endpoints, 'publishes', 'publish')}"
    return Verdict(State.SLOW, Cause.SLOW, f"{rates}, for {LASTING}: {reason}", since)


def _steady_figure(rate: float) -> str:
    """Format a rate that changes each second with as many digits as before: ``2.00``, ``20.3``."""
    return f"{rate:#.3g}".rstrip(".")


def _catching_up(half: SenderFacts, _: Crossing) -> Verdict | None:
    left = half.path.backlog.left if half.path.backlog.exists else 0
    return Verdict(State.OK, Cause.CATCHING_UP, f"catching up, {left:,} left") if left else None


def _unsent(half: SenderFacts, crossing: Crossing) -> Verdict | None:
    """Judge a topic that no message has come of, or whose publisher has left while no message was due."""
    if crossing is Crossing.RESTING:
        text = no_subscriber(half.route.far_topic, None, half.flow.audience.deaf)
        return Verdict(State.RESTING, Cause.RESTING, text)
    if not crossing.flows:
        return _no_message(first_missing(half.stages()))
    if half.came:
        return (
            None if half.carried.endpoints else Verdict(State.OK, Cause.PUBLISHER_GONE, _no_publisher(half, gone=True))
        )
    if not half.carried.endpoints:
        return Verdict(State.WAITING, _nobody(half), _no_publisher(half))
    if half.subscription.is_unmatched:
        text = _unmatched(half.carried.endpoints, refused=half.subscription.refuses)
        return Verdict(State.UNHEARD, Cause.UNMATCHED, text)
    return Verdict(State.WAITING, *_nothing_yet(half))


def _may_get_lost(half: SenderFacts) -> bool:
    """Whether DDS may lose all of its messages: they are large, and none is sent again."""
    return all(each.qos.reliability == "best_effort" for each in half.carried.endpoints) and _is_large(half)


def _is_large(half: SenderFacts) -> bool:
    """Whether its messages are large, by those that have come, or else by their type."""
    meter, type_name = half.route.meter, half.carried.type_name
    if meter.count:
        return meter.bytes > meter.count * _FRAGMENT
    return type_name in _LARGE or type_name.endswith(_ARRAY)


def _unmatched(endpoints: Collection[Endpoint], *, refused: bool, what: str = "publishers") -> str:
    who = _plural(endpoints, "does", "do", what)
    return f"{who} not match the bridge: {why_unmatched(endpoints, refused=refused)}"


def _no_message(missing: str = "") -> Verdict:
    return Verdict(State.WAITING, Cause.NO_MESSAGE, missing or "no message yet")


# --- the receiving side


def _nothing_comes(half: ReceiverFacts, crossing: Crossing) -> Verdict | None:
    since = half.stale_since(crossing)
    return None if since is None else Verdict(State.STALE, Cause.SILENT, f"nothing for {LASTING}", since)


def _of_transforms(half: ReceiverFacts, crossing: Crossing) -> Verdict | None:
    return half.of_transforms if crossing.flows else None


def _unreceived(half: ReceiverFacts, crossing: Crossing) -> Verdict | None:
    if crossing is Crossing.RESTING:
        text = no_subscriber(half.route.local_topic, half.route.context.domain, half.flow.audience.deaf)
        return Verdict(State.RESTING, Cause.RESTING, text)
    if not crossing.flows:
        return _no_message(waits_for(half))
    return None if half.came else _no_message()


def waits_for(half: ReceiverFacts) -> str:
    """Return in words what has to pass before anything can cross."""
    stages = half.stages()
    if half.report_now is None and all(each.done is not False for each in stages):
        # Only the sending side knows the first stages, and has not reported on this opening yet.
        return "not yet: the other side's report" if half.route.life.accepted else f"not yet: {ACCEPTED}"
    return first_missing(stages)


def _subscribers(half: ReceiverFacts, crossing: Crossing) -> Verdict | None:
    qos = half.listeners.offered
    if qos is None or not (half.route.life.described and half.carried.type_name):
        return None
    beyond = _beyond_correction(half)
    deaf = {
        each: why
        for each in half.carried.endpoints
        if each not in beyond and (why := mismatch(half.carried.type_name, qos, each)) is not None
    }
    if others := [each for each, why in deaf.items() if why.cause is Cause.TYPE_CONFLICT]:
        if all(each.type_name == half.listeners.type_before for each in others):
            return Verdict(State.UNHEARD, Cause.TYPE_CONFLICT, _changed_type(half, others))
        carries = f"{half.route.local_topic} carries {half.carried.type_name}"
        text = f"{_types_and_nodes(others)}, but {carries}: correct the subscription"
        return Verdict(State.UNHEARD, Cause.TYPE_CONFLICT, text)
    if deaf:
        first = next(iter(deaf.values()))
        alike = [each for each, why in deaf.items() if why == first]
        who = _plural(alike, "asks", "ask", "subscriptions")
        text = (
            f"{who} for {', '.join(first.asked)}, but {half.route.local_topic} is published with "
            f"{', '.join(first.offered)}{_hears_instead(half, qos, alike)}: "
            "change the QoS of the subscription, or of the publishers and this topic"
        )
        return Verdict(State.UNHEARD, Cause.QOS_INCOMPATIBLE, text)
    if half.listeners.unmatched and half.carried.endpoints:
        text = _unmatched(half.carried.endpoints, refused=half.listeners.refused, what="subscriptions")
        return Verdict(State.UNHEARD, Cause.UNMATCHED, text)
    if not half.carried.endpoints and not half.flow.audience.count and half.came and crossing is not Crossing.RESTING:
        return Verdict(
            State.UNHEARD, Cause.NO_SUBSCRIBER, no_subscriber(half.route.local_topic, half.route.context.domain)
        )
    return None


def _beyond_correction(half: ReceiverFacts) -> list[Endpoint]:
    """Return subscriptions of another type that no known node has, if others hear the topic."""
    type_name, listeners = half.carried.type_name, half.listeners
    if not half.flow.audience.nodes:
        return []
    return [each for each in half.carried.endpoints if each.type_name != type_name and listeners.is_nameless(each.gid)]


def _nameless(half: ReceiverFacts, _: Crossing) -> Verdict | None:
    if not half.carried.type_name or not (endpoints := _beyond_correction(half)):
        return None
    types = join_first(sorted({each.type_name for each in endpoints}), NAMED)
    text = f"{named(half.flow.audience.nodes)} can hear it; a subscription of no known node has {types}, and cannot"
    return Verdict(State.OK, Cause.TYPE_CONFLICT, text)


def _changed_type(half: ReceiverFacts, others: Collection[Endpoint]) -> str:
    """Say that the publishers have another type than before, and who still has that one."""
    now, (nodes, _, _) = half.carried.type_name, half.ends()
    changed = f"{who_publish(nodes)} {now} now" if nodes else f"it is published as {now} now"
    return f"{changed}, {_types_and_nodes(others)} as before: correct the publisher"


def _clocks(half: ReceiverFacts, _: Crossing) -> Verdict | None:
    if not half.listeners.clocks:
        return None
    text = (
        f"{half.route.local_topic} also comes from {named(half.listeners.clocks)}, so its time jumps back and forth: "
        "keep one source, or set use_name on the server"
    )
    return Verdict(State.UNHEARD, Cause.SEVERAL_CLOCKS, text)


def _hears_instead(half: ReceiverFacts, offered: Qos, deaf: Collection[Endpoint]) -> str:
    """Return what subscribers that do not match hear of other publishers, and who hears this topic, as a clause."""
    nodes = {each.node for each in deaf}
    others = {p.node for p in half.listeners.others if any(not clashes(p.qos, each.qos) for each in deaf)}
    hearing = {each.node for each in half.carried.endpoints if not clashes(offered, each.qos)} - nodes
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


OF_SENDER: Rules[SenderFacts] = (
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
    _catching_up,
    _several,
    _shared,
    _unsent,
)


OF_RECEIVER: Rules[ReceiverFacts] = (
    _of_transforms,
    _nothing_comes,
    _expired,
    _late,
    _clocks,
    _subscribers,
    _several,
    _nameless,
    _unreceived,
)

"""Quality of service, as session files, the wire and ROS share it.

Values are as in the ROS 2 middleware interface (rmw/types.h, Jazzy); the named profiles are rmw/qos_profiles.h.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Literal

import msgspec

from rsb_bridge.model.keep import KEEP_BUDGET
from rsb_bridge.model.limits import DEPTH, QOS_TIME
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from rsb_bridge.model.keep import Keep

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["volatile", "transient_local"]
History = Literal["keep_last", "keep_all"]
Liveliness = Literal["automatic", "manual_by_topic"]


class Qos(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The policies a bridged endpoint is created with."""

    reliability: Reliability = "reliable"  # whether lost samples are sent again
    durability: Durability = "volatile"
    """``transient_local`` keeps the last ``depth`` messages for subscriptions that join late."""
    history: History = "keep_last"  # ``keep_last`` keeps ``depth`` messages, ``keep_all`` as many as the middleware can
    depth: int = 10  # messages (`rsb_bridge.model.limits.DEPTH`)
    deadline: float = 0.0  # s (`rsb_bridge.model.limits.QOS_TIME`); 0 is no deadline
    lifespan: float = 0.0  # s, as the deadline; 0 is no expiry
    liveliness: Liveliness = "automatic"  # who asserts that a publisher is alive: its process, or the publisher itself
    liveliness_lease_duration: float = 0.0
    """s, as the deadline, after which a publisher that is not asserted is not alive; 0 is no limit."""

    @property
    def latched(self) -> bool:
        """Whether subscriptions that join late get earlier messages."""
        return self.durability == "transient_local"


PROFILES: dict[str, Qos] = {
    "default": Qos(),
    "sensor_data": Qos(reliability="best_effort", depth=5),
    "services_default": Qos(),
    "parameters": Qos(depth=1000),
    "system_default": Qos(),
    "latched": Qos(durability="transient_local", depth=1),
}
"""QoS by name. ``latched`` is not ROS 2's: it is what ROS 1 called a latched topic."""

TIMES = ("deadline", "lifespan", "liveliness_lease_duration")  # in s
AUTO = "auto"
AUTO_SECONDS = 5.0
"""What a reliable volatile topic brings in this time may wait with ``auto``: a link that stalls longer is given up."""
AUTO_DEPTH = 10  # messages, where the QoS names no number: the default of ROS
_AT_FIRST: dict[Reliability, int] = {"reliable": 2_500, "best_effort": 500}
"""Messages before a rate is measured: as many as a topic of 500 Hz brings in `AUTO_SECONDS`, or in the second for which
it is worth sending. DDS takes memory for those that wait only (bench/README.md, *A bridge that stands still*)."""
_MOST_AUTO = 10_000  # messages: as many as the receiving side keeps (`limits.KEPT_DEPTH`)
_ASSERTED_EVERY = 0.02  # s between two assertions of liveliness at least. Each takes 10 µs
QUEUE_BYTES = 32 << 20
"""Of one topic's messages that wait in one place: in DDS, for the link, or until their publisher is known, so that a
large image which comes first is not lost. Not measured."""


class QosProblem(Wording):
    UNKNOWN_NAME = "{value!r} is not one of {names}"
    UNKNOWN_PROFILE = "profile: {value!r} is not one of {names}"
    DEPTH_OUT_OF_RANGE = "depth: {depth} is out of range: {range}"
    TIME_OUT_OF_RANGE = "{policy}: {seconds:g} s is out of range: {range} s, or 0 for none"


class QosMismatch(Wording):
    """Policies that keep a publisher and a subscription apart."""

    POLICY = "the publisher offers {offer}, the subscription asks for {request}"
    DEADLINE = "a deadline of {seconds:g} s"
    NO_DEADLINE = "no deadline"
    LIVELINESS = "liveliness {kind}"
    LEASE = "a liveliness lease of {seconds:g} s"
    NO_LEASE = "no liveliness lease"


def parse_qos(value: object) -> Qos | None:
    """Return the QoS that a session file means: a profile's name, a depth, or a mapping of policies.

    Args:
        value: ``auto``, a name out of `PROFILES`, a depth, or a mapping of `Qos` fields, which may start from a
            profile (``{profile: sensor_data, depth: 20}``).

    Returns:
        The QoS, or None for ``auto``: to be matched to the topic's publishers.

    Raises:
        ValueError: it is none of these. The message names the options.
    """
    if value is None or value == AUTO:
        return None
    match value:
        case Qos():
            qos = value
        case int() if not isinstance(value, bool):  # `qos: true` is no depth of 1
            qos = Qos(depth=value)
        case str():
            if value not in PROFILES:
                raise ValueError(QosProblem.UNKNOWN_NAME(value=value, names=", ".join((AUTO, *PROFILES))))
            qos = PROFILES[value]
        case dict():
            profile = value.get("profile", "default")
            if not isinstance(profile, str) or profile not in PROFILES:
                raise ValueError(QosProblem.UNKNOWN_PROFILE(value=profile, names=", ".join(PROFILES)))
            policies = {key: policy for key, policy in value.items() if key != "profile"}
            try:
                qos = msgspec.convert(msgspec.to_builtins(PROFILES[profile]) | policies, Qos)
            except msgspec.ValidationError as error:
                raise ValueError(str(error)) from None
        case _:
            raise ValueError(f"{value!r} is not a QoS: give a profile's name, a depth, or a mapping")
    if problem := qos_problem(qos):
        raise ValueError(problem)
    return qos


def qos_problem(qos: Qos, *, depth_known: bool = True) -> str:
    """Return the values of a QoS that are out of range, or an empty string.

    Args:
        depth_known: False allows 0: the depth of somebody else's endpoint, which ROS does not tell.
    """
    if qos.depth not in DEPTH and (depth_known or qos.depth):
        return QosProblem.DEPTH_OUT_OF_RANGE(depth=qos.depth, range=DEPTH)
    for policy in TIMES:
        if (seconds := getattr(qos, policy)) and seconds not in QOS_TIME:
            return QosProblem.TIME_OUT_OF_RANGE(policy=policy, seconds=seconds, range=QOS_TIME)
    return ""


_POLICIES = attrgetter("reliability", "durability", "deadline", "lifespan", "liveliness", "liveliness_lease_duration")
"""The policies of a `Qos` that decide whether two endpoints match."""


def match_publishers(offered: Sequence[Qos]) -> Qos:
    """Return the QoS that ``auto`` means: the strictest that a subscription to all these publishers can ask for.

    Args:
        offered: what the topic's publishers offer; their depths are not known to others and do not matter.

    Returns:
        Its depth is `Qos`'s own; without a publisher it is `Qos()`.
    """
    if not offered:
        return Qos()
    reliability, durability, deadline, lifespan, liveliness, lease = zip(*map(_POLICIES, offered), strict=True)
    return Qos(
        reliability="best_effort" if "best_effort" in reliability else "reliable",
        durability="volatile" if "volatile" in durability else "transient_local",
        deadline=_loosest(deadline),
        lifespan=_loosest(lifespan),
        liveliness="automatic" if "automatic" in liveliness else "manual_by_topic",
        liveliness_lease_duration=_loosest(lease),
    )


def match_subscriptions(requested: Sequence[Qos]) -> Qos:
    """Return the QoS that a publisher has to offer at the least, to match all these subscriptions.

    Args:
        requested: at least one; depths are not known to others and do not matter.
    """
    reliability, durability, deadline, _, liveliness, lease = zip(*map(_POLICIES, requested), strict=True)
    return Qos(
        reliability="reliable" if "reliable" in reliability else "best_effort",
        durability="transient_local" if "transient_local" in durability else "volatile",
        deadline=_strictest(deadline),
        liveliness="manual_by_topic" if "manual_by_topic" in liveliness else "automatic",
        liveliness_lease_duration=_strictest(lease),
    )


def parts_of_lease(seconds: float, publishers: int = 1) -> float:
    """Return the time (s) after which publishers with a liveliness lease are asserted, or looked at, again.

    A third of the lease, so that one late assertion ends none; but at most 50 of them a second, which a peer may ask.
    """
    return max(seconds / 3, publishers * _ASSERTED_EVERY)


def auto_depth(reliability: Reliability, rate: float | None, mean_size: float, keep: Keep | None = None) -> int:
    """Return the depth that ``auto`` means on a volatile topic: as many messages as it brings in `AUTO_SECONDS`.

    Args:
        reliability: of the subscription.
        rate: Hz, or None if it is not yet measured.
        mean_size: bytes of a message, or 0 if it is not yet measured.
        keep: the promise to keep more than that, or None. Its seconds and bytes count then, and without a rate the
            most: a deeper subscription later would miss messages while it is made.

    Returns:
        At least 10, at most 10,000 messages, and no more than 32 MiB or the bytes to keep where that is more than 10.
    """
    if rate is None:
        return _AT_FIRST[reliability] if keep is None else _MOST_AUTO
    seconds, size = AUTO_SECONDS, QUEUE_BYTES
    if keep is not None:
        seconds, size = max(seconds, keep.seconds), keep.own_bytes or KEEP_BUDGET
    most = min(_MOST_AUTO, size / mean_size) if mean_size else _MOST_AUTO
    return int(max(AUTO_DEPTH, min(rate * seconds, most)))


def clamp_qos(qos: Qos) -> Qos:
    """Return the QoS nearest to one in the graph, which may be anything, that wire messages may carry.

    A time that is shorter than the shortest becomes that, one beyond the longest (or none at all, as NaN) becomes 0.
    """
    if not qos_problem(qos, depth_known=False):
        return qos
    times = {policy: getattr(qos, policy) for policy in TIMES}
    clamped = {
        policy: max(seconds, QOS_TIME.low) if 0 < seconds <= QOS_TIME.high else 0.0 for policy, seconds in times.items()
    }
    return msgspec.structs.replace(qos, depth=min(max(qos.depth, 0), int(DEPTH.high)), **clamped)


def _loosest(seconds: Collection[float]) -> float:
    return 0.0 if 0.0 in seconds else max(seconds)


def _strictest(seconds: Collection[float]) -> float:
    return min(filter(None, seconds), default=0.0)


def clashes(offered: Qos, requested: Qos) -> list[tuple[str, str]]:
    """Return the publisher's offer and the subscription's request of each policy that keeps them apart.

    The rules are DDS's for request and offer (OMG DDS 1.4, table in section 2.2.3), of the policies that `Qos` has.
    """
    found = []
    if offered.reliability == "best_effort" and requested.reliability == "reliable":
        found.append(("best_effort", "reliable"))
    if offered.durability == "volatile" and requested.durability == "transient_local":
        found.append(("volatile", "transient_local"))
    if requested.deadline and not 0 < offered.deadline <= requested.deadline:
        offer = QosMismatch.DEADLINE(seconds=offered.deadline) if offered.deadline else QosMismatch.NO_DEADLINE()
        found.append((offer, QosMismatch.DEADLINE(seconds=requested.deadline)))
    if offered.liveliness == "automatic" and requested.liveliness == "manual_by_topic":
        found.append((QosMismatch.LIVELINESS(kind="automatic"), QosMismatch.LIVELINESS(kind="manual_by_topic")))
    had, asked = offered.liveliness_lease_duration, requested.liveliness_lease_duration
    if asked and not 0 < had <= asked:
        lease = QosMismatch.LEASE(seconds=had) if had else QosMismatch.NO_LEASE()
        found.append((lease, QosMismatch.LEASE(seconds=asked)))
    return found


def incompatible(offered: Qos, requested: Qos) -> str:
    """Return the reason why a publisher and a subscription do not match, or an empty string."""
    return "; ".join(QosMismatch.POLICY(offer=offer, request=request) for offer, request in clashes(offered, requested))

"""The fields of the topic form: which of them each kind has, and what they are called there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.model import transports
from rsb_bridge.model.limits import CHANNEL, NO_PORT
from rsb_bridge.model.qos import PROFILES
from rsb_bridge.model.session import CALL_TIMEOUT, DEADMAN
from rsb_console.session.draft import SWITCHES, values_of
from rsb_console.widgets.form import Spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Kind, Session
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.session.draft import Ends

KINDS: tuple[Kind, ...] = ("topic", "service", "action", "parameters")
ORDER = (
    "topic", "kind", "direction", "provider", "excepts", "type", "qos", "remote_topic", "timeout", "protocol", "port",
    "max_rate", "priority", "expected_rate", "stale_after", "late_after", "max_age", "compression", "arm", "deadman",
    "paused",
)  # fmt: skip
"""The keys of all fields, in the order in which an operator thinks of them."""
_LABELS: dict[Kind, str] = {"topic": "Topic", "service": "Service", "action": "Action", "parameters": "Node"}
_FOLDERS: dict[Kind, str] = {"topic": "msg", "service": "srv", "action": "action"}


def fields_by_kind(session: Session, ends: Ends, route: RouteSnapshot | None) -> dict[Kind, dict[str, Spec]]:
    """The fields of each kind that the form may be about, by their keys.

    Args:
        session: what it is for.
        ends: of the link.
        route: what is edited; None: the form is for something new, of any kind.
    """
    kinds = KINDS if route is None else (route.spec.kind,)
    values = {} if route is None else values_of(route.spec) | {"provider": route.spec.provider}
    return {
        kind: {spec.key: _with_value(spec, values.get(spec.key, "")) for spec in _specs(session, ends, kind, route)}
        for kind in kinds
    }


def _with_value(spec: Spec, value: str) -> Spec:
    if spec.key in SWITCHES:
        value = "yes" if value else ""
    return replace(spec, value=value, edited=value.startswith("{"))  # QoS policies are changed one by one


def _specs(session: Session, ends: Ends, kind: Kind, route: RouteSnapshot | None) -> Iterator[Spec]:
    yield from _which(ends, kind, new=route is None)
    if kind == "topic":
        known = f"auto, {', '.join(PROFILES)}, a depth (20), or policies: {{reliability: best_effort}}"
        yield Spec("qos", "QoS", known, blank="auto")
    yield Spec(
        "remote_topic",
        "On the server",
        f"Its name there. Empty: the same{f', with /{ends.client} before it' if ends.use_name else ''}.",
        blank=f"/{ends.client} and its name" if ends.use_name else "same name",
    )
    if kind != "topic":
        yield Spec(
            "timeout",
            "Timeout",
            "Seconds without an answer until a call is given up.",
            blank=f"{CALL_TIMEOUT:g} s",
        )
    yield from _how(session, kind, None if route is None else route.spec.protocol)
    yield Spec(
        "arm",
        "Must be armed",
        "Carries nothing until an operator arms it (key A).",
        options=(("", "no"), ("yes", "yes")),
    )
    yield Spec(
        "deadman",
        "Deadman",
        "Seconds without a key on the console that armed it until it disarms; 0: none.",
        blank=f"{DEADMAN:g} s, if it has to be armed",
    )
    yield Spec("paused", "Paused", "Set up, but carries nothing until resumed.", options=(("", "no"), ("yes", "yes")))


def _which(ends: Ends, kind: Kind, *, new: bool) -> Iterator[Spec]:
    """What it is, and between whom."""
    name = f"{'The name of the node' if kind == 'parameters' else 'Its name'} on the client."
    yield Spec(
        "topic",
        _LABELS[kind],
        f"{name} Type to search, ↑ ↓ and ⏎ to pick; or type a name (/scan) or a pattern (/camera/**)." if new else name,
        blank="type to look for what either side has",
    )
    if new:
        yield Spec(
            "kind",
            "Kind",
            "What has that name. What is picked from the list says it by itself.",
            options=tuple((each, each) for each in KINDS),
        )
    if kind == "topic":
        out, back = ("←", "→") if ends.is_server else ("→", "←")
        yield Spec(
            "direction",
            "Direction",
            "transmit: from the client to the server; receive: from the server to the client.",
            options=(("transmit", f"transmit {out}"), ("receive", f"receive {back}")),
        )
    else:
        there, here = ("here", "there") if ends.is_server else ("there", "here")
        yield Spec(
            "provider",
            "Provider",
            "The side whose node answers. The other side's nodes call it.",
            options=(("server", f"the server ({there})"), ("client", f"the client ({here})")),
        )
    yield Spec(
        "excepts",
        "Except",
        "Of a pattern (/camera/**, /nav/*): names and patterns on the client that it leaves out, with blanks between.",
        blank="nothing",
    )
    if kind in _FOLDERS:
        short = ", or a common type's short name (LaserScan)" if kind == "topic" else ""
        form = f"package/{_FOLDERS[kind]}/Name{short}. Empty: the type in either graph."
        yield Spec("type", "Type", form, blank="auto")


def _how(session: Session, kind: Kind, begun: str | None) -> Iterator[Spec]:
    """How it crosses; `begun` is the protocol that it has already."""
    bluetooth = session.is_bluetooth
    has_radio = session.bluetooth_address is not None or begun == "bluetooth"
    if not bluetooth:
        yield _protocol(kind, session, has_radio=has_radio)
    has_ports = transports.of_link(session.server_ip).topic_ports is not NO_PORT
    packing = (("", f"the link's ({'zstd' if bluetooth else 'none'})"), ("none", "none"), ("zstd", "zstd"))
    port = "Channel" if bluetooth else "Port"
    channel = f" Bluetooth: a channel, {CHANNEL}, which several may share." if has_radio and not bluetooth else ""
    if has_ports:
        yield Spec("port", port, f"A {port.lower()} of its own. Empty: it shares the link's.{channel}", blank="shared")
    if kind == "topic":
        after = f"{session.stale_after:g} s"
        yield Spec("max_rate", "Max rate", "Hz; messages beyond it are left out. Empty: no limit.", blank="all")
        yield Spec(
            "priority",
            "Priority",
            "While the link carries less than is asked for, lower ones are thinned first.",
            options=(("", "normal"), ("high", "high"), ("low", "low")),
        )
        yield Spec("expected_rate", "Expected rate", "Hz, shown beside the real rate. Empty: learned.", blank="learned")
        yield Spec("stale_after", "Stale after", "Seconds without a message before a warning; 0: never.", blank=after)
        late = f"{session.late_after:g} s"
        yield Spec("late_after", "Late after", "Seconds that a message may take, or 0 for no limit.", blank=late)
        old = "Seconds; an older message is dropped. 0: no limit. Empty: 1 s if it has to be armed, else no limit."
        yield Spec("max_age", "Max age", old, blank="1 s if armed")
        worth = "zstd is worth it for maps and clouds, and on slow links."
    else:
        yield Spec("max_rate", "Max rate", "Calls a second; those beyond it are refused. Empty: no limit.", blank="all")
        old = "Seconds; an older request is refused. 0: no limit. Empty: 1 s if it has to be armed, else no limit."
        yield Spec("max_age", "Max age", old, blank="1 s if armed")
        worth = "zstd is worth it for large requests and answers, and on slow links."
    yield Spec("compression", "Compression", worth, options=packing)


def _protocol(kind: Kind, session: Session, *, has_radio: bool) -> Spec:
    if session.is_zenoh:
        streams = ("", "by the QoS") if kind == "topic" else ("", "zenoh")
        offered = (streams, ("zenoh", "zenoh"), ("zenoh-drop", "zenoh-drop"))
        meaning = "zenoh delivers all, in order; zenoh-drop, what best effort has, never waits for what was lost."
        return Spec("protocol", "Protocol", meaning, options=offered if kind == "topic" else offered[:1])
    radio = "; bluetooth uses the radio, on a channel of its own" if has_radio else ""
    carriers = [("", "the link's (tcp)"), ("tcp", "tcp")]
    if kind == "topic":
        meaning = "tcp delivers all, in order; udp never waits for what was lost"
        carriers.append(("udp", "udp"))
    else:
        meaning = "calls never go over udp, which may lose them"
    carriers += [("bluetooth", "bluetooth")] if has_radio else []
    return Spec("protocol", "Protocol", f"{meaning}{radio}.", options=tuple(carriers))

"""The fields of a topic, a service and the like, for forms."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.model import transports
from rsb_bridge.model.limits import CHANNEL, NO_PORT
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_console.session.draft import CHOICES, SWITCHES, Ends, values_of
from rsb_console.widgets.form import Spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Kind, Session
    from rsb_console.notation.formats import Row

KINDS: tuple[Kind, ...] = ("topic", "service", "action", "parameters")
_WHICH = ("topic", "kind", "direction", "provider")
ORDER = (*_WHICH, *(key for key in TOPIC_KEYS if key not in _WHICH))
"""The keys of all fields, in the order in which an operator thinks of them."""
EDIT_ORDER = ("max_rate", *(key for key in ORDER if key != "max_rate"))
"""The same for something that is bridged already: most edits are of its rate."""
FIRST = ("link", "topic", "kind", "direction", "provider", "type", "qos", "protocol", "priority")
"""The keys of the fields that a form of something new begins with; the others have good defaults."""
_LABELS: dict[Kind, str] = {"topic": "Topic", "service": "Service", "action": "Action", "parameters": "Node"}
_FOLDERS: dict[Kind, str] = {"topic": "msg", "service": "srv", "action": "action"}


def fields_by_kind(session: Session, ends: Ends, route: Row | None) -> dict[Kind, dict[str, Spec]]:
    """Return the fields of each kind that the form may have, by their keys.

    Args:
        route: the route to edit, or None for a form of something new, of any kind.
    """
    kinds = KINDS if route is None else (route.spec.kind,)
    values = {} if route is None else values_of(route.spec) | {"provider": route.spec.provider}
    fields: dict[Kind, dict[str, Spec]] = {kind: {} for kind in kinds}
    for kind in kinds:
        for spec in _specs(session, ends, kind, route):
            value = values.get(spec.key, "")
            if spec.key in SWITCHES:
                value = "yes" if value else ""
            elif spec.key in CHOICES and value:
                value = "yes" if value == "True" else "no"
            edited = value.startswith("{")  # QoS policies are changed one by one
            fields[kind][spec.key] = replace(spec, value=value, edited=edited)
    return fields


def _specs(session: Session, ends: Ends, kind: Kind, route: Row | None) -> Iterator[Spec]:
    yield from _which(ends, kind, new=route is None)
    yield from _how(session, ends, kind, None if route is None else route.spec.protocol)
    for key in TOPIC_KEYS.values():
        if key.label and key.is_of(kind):
            blank = key.blank.format(session=session)
            yield Spec(key.name, key.label, key.help_of(kind), blank=blank, options=key.options)


def _which(ends: Ends, kind: Kind, *, new: bool) -> Iterator[Spec]:
    name = f"{'The name of the node' if kind == 'parameters' else 'Its name'} on the client."
    if new:
        name += " Type to search, arrows and enter to pick; or type a name (/scan) or a pattern (/camera/**)."
    yield Spec("topic", _LABELS[kind], name, blank="type to look for what either side has")
    if new:
        about = "The kind of the name. An entry picked from the list sets it."
        yield Spec("kind", "Kind", about, options=tuple((each, each) for each in KINDS))
    if kind == "topic":
        out, back = ("←", "→") if ends.is_server else ("→", "←")
        about = "transmit: from the client to the server; receive: from the server to the client."
        options = (("transmit", f"transmit {out}"), ("receive", f"receive {back}"))
        yield Spec("direction", "Direction", about, options=options)
    else:
        there, here = ("here", "there") if ends.is_server else ("there", "here")
        about = "The side whose node answers. The other side's nodes call it."
        options = (("server", f"the server ({there})"), ("client", f"the client ({here})"))
        yield Spec("provider", "Provider", about, options=options)
    if kind in _FOLDERS:
        short = ", or a common type's short name (LaserScan)" if kind == "topic" else ""
        form = f"package/{_FOLDERS[kind]}/Name{short}. Empty: the type in either graph."
        yield Spec("type", "Type", form, blank="auto")


def _how(session: Session, ends: Ends, kind: Kind, begun: str | None) -> Iterator[Spec]:
    """Yield the fields of the way over the link; `begun` is the present protocol."""
    prefix = f", with /{ends.client} before it" if ends.use_name else ""
    blank = f"/{ends.client} and its name" if ends.use_name else "same name"
    yield Spec("remote_topic", "On the server", f"Its name there. Empty: the same{prefix}.", blank=blank)
    link = transports.of_link(session.host)
    has_radio = session.bluetooth_address is not None or begun == "bluetooth"
    if len(session.crossing) > 1:
        yield _protocol(kind, session, has_radio=has_radio)
    if link.topic_ports is not NO_PORT:
        port = link.port_kind.split()[-1].capitalize()
        channel = f" Bluetooth: a channel, {CHANNEL}, which several may share." if has_radio and link.ip_ports else ""
        yield Spec("port", port, f"A {port.lower()} of its own. Empty: it shares the link's.{channel}", blank="shared")
    packed = "maps and clouds" if kind == "topic" else "large requests and answers"
    packing = (("", f"the link's ({link.compression})"), ("none", "none"), ("zstd", "zstd"))
    yield Spec("compression", "Compression", f"zstd is worth it for {packed}, and on slow links.", options=packing)


def _protocol(kind: Kind, session: Session, *, has_radio: bool) -> Spec:
    link = transports.of_link(session.host)
    names = dict.fromkeys((*session.crossing, *(("bluetooth",) if has_radio else ())))
    carriers = [transports.named(name) for name in names]
    lossy = [each.name for each in carriers if not each.reliable]
    if kind != "topic":
        carriers = [each for each in carriers if each.reliable]
    told = [f"{each.name} {each.delivery}" for each in carriers if kind == "topic" or each is not link]
    if kind != "topic" and lossy:
        told.insert(0, f"calls never go over {' or '.join(lossy)}, which may lose them")
    default = "by the QoS" if kind == "topic" and link.best_effort else f"the link's ({link.name})"
    offered = (("", default), *((each.name, each.name) for each in carriers))
    return Spec("protocol", "Protocol", f"{'; '.join(told)}.", options=offered)

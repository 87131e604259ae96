"""The form of a topic, a service and the like: its fields, suggestions from both graphs, and checks while typing."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rich.cells import cell_len
from textual import on, work
from textual.binding import Binding
from textual.widgets import Button

from rsb_bridge.api import EngineError
from rsb_bridge.model import transports
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import CHANNEL, NO_PORT
from rsb_bridge.model.link_budget import LoadSource, cost_of, describe_cost
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.text import plural
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_console.notation.formats import KIND_NOUN
from rsb_console.notation.glyphs import IN, OUT
from rsb_console.session.draft import SWITCHES, Ends, problems_of, topic_of, values_of
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, FieldSearch, FormScreen, Spec
from rsb_console.widgets.lines import Line, fit_middle
from rsb_console.widgets.picker import PickField, Suggestion

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence

    from textual.app import ComposeResult

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Kind, Session, Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, TopicInfo
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
LOOK_EVERY = 2.0  # s between two looks at the graphs; a round figure: each asks the other side for its graph
_NAME_WIDTH, _WHERE_WIDTH, _TYPE_WIDTH = 32, 21, 24  # cells; the name gets the rest, at least so many
_ENDS: dict[Kind, tuple[str, str]] = {
    "topic": ("publisher", "subscriber"),
    "service": ("server", "client"),
    "action": ("server", "client"),
    "parameters": ("parameters", "client"),
}
"""The endpoints of each kind on the providing side, and on the other."""


def fields_by_kind(session: Session, ends: Ends, route: Row | None) -> dict[Kind, dict[str, Spec]]:
    """Return the fields of each kind that the form may have, by their keys.

    Args:
        route: the route to edit, or None for a form of something new, of any kind.
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


def _specs(session: Session, ends: Ends, kind: Kind, route: Row | None) -> Iterator[Spec]:
    yield from _which(ends, kind, new=route is None)
    yield from _how(session, ends, kind, None if route is None else route.spec.protocol)
    for key in TOPIC_KEYS.values():
        if key.label and key.is_of(kind):
            blank = key.blank.format(session=session)
            yield Spec(key.name, key.label, key.help_of(kind), blank=blank, options=key.options)


def _which(ends: Ends, kind: Kind, *, new: bool) -> Iterator[Spec]:
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
            "The kind of the name. An entry picked from the list sets it.",
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
    if kind in _FOLDERS:
        short = ", or a common type's short name (LaserScan)" if kind == "topic" else ""
        form = f"package/{_FOLDERS[kind]}/Name{short}. Empty: the type in either graph."
        yield Spec("type", "Type", form, blank="auto")


def _how(session: Session, ends: Ends, kind: Kind, begun: str | None) -> Iterator[Spec]:
    """Yield the fields of the way over the link; `begun` is the present protocol."""
    yield Spec(
        "remote_topic",
        "On the server",
        f"Its name there. Empty: the same{f', with /{ends.client} before it' if ends.use_name else ''}.",
        blank=f"/{ends.client} and its name" if ends.use_name else "same name",
    )
    link = transports.of_link(session.server_ip)
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
    link = transports.of_link(session.server_ip)
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


class TopicDraft(NamedTuple):
    """The result of the form.

    Attributes:
        topic: as the client sees it.
    """

    topic: Topic
    link: str


class TopicScreen(FormScreen[TopicDraft]):
    """The form of a topic, a service, an action or a node's parameters.

    Args:
        engine: whose graphs and links it is about.
        do: carries out the result; if the engine refuses it, the form stays open and shows the reason.
        route: the route or the pattern to edit, or None for something new.
    """

    BINDINGS: ClassVar = [Binding("f7", "find", show=False), Binding("f8", "unfold", show=False)]

    def __init__(
        self, engine: EngineApi, do: Callable[[TopicDraft], Awaitable[object]], route: Row | None = None
    ) -> None:
        self._engine, self._do, self._route = engine, do, route
        now = engine.snapshot()
        self._links = [route.link] if route is not None else [link.name for link in now.links]
        self._specs = fields_by_kind(engine.session, Ends.of(now, self._links[0]), route)
        self._kind: Kind = KINDS[0] if route is None else route.spec.kind
        self._kind_chosen = False
        self._is_folded = route is None
        self._found: dict[str | None, tuple[TopicInfo, ...]] = {}
        self._errors: dict[str | None, str] = {}
        self._awaited: set[str | None] = set()
        self._late: set[str | None] = set()
        new = "Add a topic, a service, an action or a node's parameters"
        title, yes = (new, "Add") if route is None else (f"Edit {route.topic}", "Change")
        super().__init__(title, [self._field(spec) for spec in self._all_specs()], yes)
        self._search = FieldSearch(self.form)
        self._show_kind()

    def _all_specs(self) -> Iterator[Spec]:
        """Yield the fields of every kind, each once, in the order of `ORDER`."""
        if len(self._links) > 1:
            clients = tuple((name, name) for name in self._links)
            yield Spec("link", "Client", "The client that it is bridged with.", options=clients)
        for key in ORDER if self._route is None else EDIT_ORDER:
            yield from islice((specs[key] for specs in self._specs.values() if key in specs), 1)

    def _show_kind(self) -> None:
        """Show the fields that the kind has, as they are called there."""
        if "kind" in self.form.fields:
            self._kind = next(kind for kind in KINDS if kind == self.form.fields["kind"].value)
        specs = self._specs[self._kind]
        for key, field in self.form.fields.items():
            if key in specs:
                field.describe(specs[key])
            field.display = (key in specs or key == "link") and (
                not self._is_folded or key in FIRST or bool(field.value)
            )

    def _field(self, spec: Spec) -> Field:
        if spec.key == "topic" and self._route is None:
            return PickField(spec, is_literal=lambda text: text.startswith("/"))
        return Field(spec)

    def compose_buttons(self) -> ComposeResult:
        yield self._search
        yield Button("Go to (F7)", id="find", compact=True)
        if self._is_folded:
            yield Button("More (F8)", id="more", compact=True)
        yield from super().compose_buttons()

    def press(self, button: str) -> None:
        if button == "more":
            self.action_unfold()
        elif button == "find":
            self.action_find()
        else:
            super().press(button)

    def action_find(self) -> None:
        """Go to a field by the beginning of its name."""
        self._search.begin()

    def action_unfold(self) -> None:
        """Show all fields, and go to the first one that was hidden."""
        if not self._is_folded:
            return
        hidden = [field for field in self.form.fields.values() if not field.display]
        self._is_folded = False
        self._show_kind()
        self.query_one("#more").display = False
        if appeared := [field for field in hidden if field.display]:
            appeared[0].control.focus()

    @property
    def _link(self) -> str:
        return self.form.values.get("link") or self._links[0]

    def check(self) -> None:
        """Say what is wrong, and what a topic that is right would cost on the link."""
        super().check()
        if (priority := self.form.fields.get("priority")) is not None:  # a topic, not a service
            priority.note.set_text("\n".join(self._cost()))

    def _cost(self) -> tuple[str, ...]:
        values = self.form.values
        if self._kind != "topic" or not values.get("topic") or self.problems(values):
            return ()
        now, draft = self._engine.snapshot(), self.result(values)
        replaces = "" if self._route is None else self._route.key
        known = "" if self._route is None else self._route.type_name
        cost = cost_of(now, draft.link, draft.topic, type_name=known or self._type_of(draft), replaces=replaces)
        return describe_cost(cost, now.time) if cost.load.source is not LoadSource.UNKNOWN else ()

    def _type_of(self, draft: TopicDraft) -> str:
        """Return the type in the sending side's graph, or an empty string."""
        sends_here = (draft.topic.direction == "receive") == (self._engine.session.role == "server")
        found = self._found.get(None if sends_here else draft.link, ())
        names = {draft.topic.topic, draft.topic.remote_topic, f"/{draft.link}{draft.topic.topic}"}
        return next((info.type_name for info in found if info.topic in names), "")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        replaced = None if self._route is None else self._route.spec
        found = problems_of(self.result(values).topic, self._engine.session, replaced)
        renamed = {"direction": "provider"} if self._kind != "topic" else {}
        return {renamed.get(key, key): message for key, message in found.items()}

    def result(self, values: Mapping[str, str]) -> TopicDraft:
        given = {key: value for key, value in values.items() if key != "link"}
        return TopicDraft(topic_of({"kind": self._kind, **given}), self._link)

    @work(group=DIALOG)
    async def accept(self, result: TopicDraft) -> None:
        """Add or change the topic. If the engine refuses, show the reason in the form."""
        try:
            await self._do(result)
        except EngineError as error:
            self.form.show_problems({"": str(error)})
        else:
            self.dismiss(result)

    # -- picking ------------------------------------------------------------------------------------------------------

    def on_mount(self) -> None:
        """Look at the graphs, and go on looking."""
        if self._route is None:
            self._ask_both()
            self.set_interval(LOOK_EVERY, self._ask_both)

    def _ask_both(self) -> None:
        """Ask both sides what they have; a side that has not answered yet is not asked again."""
        # What a whole interval has not answered. A note about it at once would flicker, as most answers come soon.
        self._late = set(self._awaited)
        for side in (None, self._link):
            if side not in self._awaited:
                self._awaited.add(side)
                self._ask(side)
        self._suggest()

    @work(group="ask")
    async def _ask(self, side: str | None) -> None:
        try:
            self._found[side] = await asyncio.wrap_future(self._engine.topics(side))
            self._errors.pop(side, None)
        except EngineError as error:
            self._errors[side] = str(error)
        self._awaited.discard(side)
        self._late.discard(side)
        self._suggest()

    def _suggest(self) -> None:
        """List what has been found, and say whose answer is missing."""
        link, now = self._link, self._engine.snapshot()
        bridged = [route for route in now.routes if route.link == link]
        field = self.form.fields["topic"]
        assert isinstance(field, PickField)
        late = "waiting for what the other side has …" if link in self._late else ""
        field.note.set_text(self._errors.get(link) or self._errors.get(None) or late)
        waiting = self._awaited & {None, link}
        what = self._kind if self._kind_chosen else "topic, service, action or node with parameters"
        empty = "asking both sides …" if waiting else f"no other {what} on either side; type the full name"
        here, there = (
            [info for info in self._found.get(side, ()) if not self._kind_chosen or info.kind == self._kind]
            for side in (None, link)
        )
        suggestions = suggestions_for(Ends.of(now, link), here, there, bridged)
        field.suggest(suggestions, lambda _text: empty)

    @on(Field.Changed)
    def _another_client_or_kind(self, event: Field.Changed) -> None:
        key = event.field.spec.key
        if key == "link":
            self._ask_both()
        elif key == "kind":
            # Not what a pick fills in: the list would then keep to that kind.
            self._kind_chosen = self._kind_chosen or event.field.control.has_focus
            self._show_kind()
            self._suggest()
            self.check()

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        if event.suggestion is not None:
            for key, value in {"topic": event.suggestion.value, **event.suggestion.fills}.items():
                self.form.fields[key].value = value
            self._show_kind()
        event.field.touched = True
        self.check()
        self.form.fields["direction" if self._kind == "topic" else "provider"].control.focus()


def suggestions_for(
    ends: Ends, here: Iterable[TopicInfo], there: Iterable[TopicInfo], bridged: Sequence[RouteSnapshot]
) -> list[Suggestion]:
    """Return what can be bridged from both graphs: topics, then services, actions and parameters, each by name.

    A publisher makes a topic flow away from its side; where there are only subscriptions it is to flow towards them.
    If a name has both, one on each side, the publisher decides. So it is with the servers and clients of a service.

    Args:
        bridged: the link's routes; neither end of one is offered the same way again, nor its services.
    """
    taken = {route.spec.identity for route in bridged}
    crossing = {
        (kind, is_here, f"{route.topic if is_here else route.remote_topic}{suffix}", _from_here(route))
        for route in bridged
        for kind, suffix in (
            (route.spec.kind, ""),
            *(("service", lane.suffix) for lane in LANES[route.spec.kind] if lane.suffix and not lane.is_topic),
        )
        for is_here in (True, False)
    }
    infos = [(info, is_here) for graph, is_here in ((here, True), (there, False)) for info in graph]
    suggestions: dict[str, Suggestion] = {}
    # Publishers first, as the first suggestion of a key stays.
    for info, is_here in sorted(infos, key=lambda each: not each[0].publishers):
        suggestion = _suggestion(ends, info, is_here)
        from_here = info.kind == "topic" and is_here == bool(info.publishers)
        if (
            suggestion is not None
            and (info.kind, is_here, info.topic, from_here) not in crossing
            and (info.kind, suggestion.value, _direction(ends, info, is_here)) not in taken
        ):
            suggestions.setdefault(suggestion.key, suggestion)
    order = {str(kind): number for number, kind in enumerate(KIND_NOUN)}
    return sorted(suggestions.values(), key=lambda each: (order[each.fills["kind"]], each.value))


def _from_here(route: RouteSnapshot) -> bool:
    """Whether a topic's messages go out. False for calls: their names cross one way only."""
    return route.outgoing and route.spec.kind == "topic"


def _direction(ends: Ends, info: TopicInfo, is_here: bool) -> str:
    """Messages go away from publishers, and requests towards servers."""
    gives = (is_here == ends.is_server) == bool(info.publishers)
    return "receive" if gives == (info.kind == "topic") else "transmit"


def _suggestion(ends: Ends, info: TopicInfo, is_here: bool) -> Suggestion | None:
    """Make the suggestion with the client's name, or return None if the client has none."""
    name = ends.client_topic(info.topic, on_server=is_here == ends.is_server)
    if name is None:
        return None
    direction = _direction(ends, info, is_here)
    fills = {
        "kind": info.kind,
        "direction": direction,
        "provider": "server" if direction == "transmit" else "client",
        "type": AUTO if info.kind == "parameters" else info.type_name or AUTO,
    }
    return Suggestion(f"{info.kind} {direction} {name}", name, partial(_line, info, is_here), fills)


def _line(info: TopicInfo, is_here: bool, width: int) -> Line:
    name_width = max(_NAME_WIDTH, width - 2 - _WHERE_WIDTH - _TYPE_WIDTH)
    gives, takes = _ENDS[info.kind]
    count, what = (info.publishers, gives) if info.publishers else (info.subscriptions, takes)
    amount = gives if info.kind == "parameters" and info.publishers else f"{count} {plural(count, what)}"
    outwards = (is_here == bool(info.publishers)) == (info.kind == "topic")
    return (
        (f"{OUT if outwards else IN} ", ""),
        *padded(info.topic, name_width, "strong"),
        *padded(f"{amount} {'here' if is_here else 'there'}", _WHERE_WIDTH, "dim"),
        (_type_of(info), ""),
    )


def _type_of(info: TopicInfo) -> str:
    if info.kind == "parameters":
        return ""
    return info.type_name.replace("/msg/", "/") or "several types"


def padded(text: str, width: int, look: str) -> Line:
    cut = fit_middle(text, width - 1)
    return (cut, look), (" " * (width - cell_len(cut)), "")

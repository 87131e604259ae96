"""Add a topic, or edit one: picked from what either side's graph offers, checked as it is typed."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from textual import on, work

from rsb_bridge.api import EngineError
from rsb_bridge.model.limits import CHANNEL
from rsb_bridge.model.qos import PROFILES
from rsb_console.screens.form import FormScreen
from rsb_console.screens.topic_suggestions import suggestions_for
from rsb_console.session.draft import Ends, problems_of, topic_of, values_of
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.picker import PickField

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot, TopicInfo

LOOK_EVERY = 2.0  # s between two looks at the graphs


class Draft(NamedTuple):
    """What the form gives.

    Attributes:
        topic: as the client sees it.
        link: the client's name.
    """

    topic: Topic
    link: str


class TopicScreen(FormScreen[Draft]):
    """The form of a topic.

    Args:
        engine: whose graphs and links it is about.
        do: carries out what the form gives; the form stays open, with the reason, if the engine refuses it.
        route: the topic to edit; None: a new one.
    """

    def __init__(
        self, engine: EngineApi, do: Callable[[Draft], Awaitable[object]], route: RouteSnapshot | None = None
    ) -> None:
        self._engine, self._do, self._route = engine, do, route
        now = engine.snapshot()
        self._links = [route.link] if route is not None else [link.name for link in now.links]
        fields = [self._field(spec) for spec in _specs(engine.session, now, self._links, route)]
        self._found: dict[str | None, list[TopicInfo]] = {}
        self._errors: dict[str | None, str] = {}
        self._awaited: set[str | None] = set()
        self._late: set[str | None] = set()
        title, yes = ("Add a topic", "Add") if route is None else (f"Edit {route.topic}", "Change")
        super().__init__(title, fields, yes)

    def _field(self, spec: Spec) -> Field:
        if spec.key == "topic" and self._route is None:
            return PickField(spec, is_literal=lambda text: text.startswith("/"))
        return Field(spec)

    @property
    def _link(self) -> str:
        return self.form.values.get("link") or self._links[0]

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        replaced = None if self._route is None else self._route.spec
        return problems_of(self.result(values).topic, self._engine.session, replaced)

    def result(self, values: Mapping[str, str]) -> Draft:
        return Draft(topic_of({key: value for key, value in values.items() if key != "link"}), self._link)

    @work(group=DIALOG)
    async def accept(self, result: Draft) -> None:
        """Have it carried out; what is refused is said here, beside the values."""
        try:
            await self._do(result)
        except EngineError as error:
            self.form.show_problems({"": str(error)})
        else:
            self.dismiss(result)

    # -- picking ------------------------------------------------------------------------------------------------------

    def on_mount(self) -> None:
        """Look at the graphs, and go on looking."""
        super().on_mount()
        if self._route is None:
            self._look()
            self.set_interval(LOOK_EVERY, self._look)

    def _look(self) -> None:
        """Ask both sides what they have; a side that has not answered yet is not asked again."""
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
        late = "waiting for the other side's topics …" if link in self._late else ""
        field.note.set_text(self._errors.get(link) or self._errors.get(None) or late)
        waiting = self._awaited & {None, link}
        empty = "asking both sides …" if waiting else "no other topic on either side; type the full name"
        suggestions = suggestions_for(Ends.of(now, link), self._found.get(None, []), self._found.get(link, []), bridged)
        field.suggest(suggestions, lambda _text: empty)

    @on(Field.Changed)
    def _another_client(self, event: Field.Changed) -> None:
        if event.field.spec.key == "link":
            self._look()

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        if event.suggestion is not None:
            for key, value in {"topic": event.suggestion.value, **event.suggestion.fills}.items():
                self.form.fields[key].value = value
        event.field.touched = True
        self.check()
        self.form.fields["direction"].control.focus()


def _specs(session: Session, now: Snapshot, links: list[str], route: RouteSnapshot | None) -> Iterator[Spec]:
    """The fields, in the order in which an operator thinks of them."""
    values = {} if route is None else values_of(route.spec)
    if len(links) > 1:
        yield Spec("link", "Client", "The client whose topic it is.", options=tuple((name, name) for name in links))
    for spec in (*_what(session, Ends.of(now, links[0]), new=route is None), *_how(session, values.get("protocol"))):
        value = values.get(spec.key, "")
        if spec.key == "paused":
            value = "yes" if value else ""
        yield replace(spec, value=value, edited=value.startswith("{"))  # QoS policies are changed one by one


def _what(session: Session, ends: Ends, *, new: bool) -> tuple[Spec, ...]:
    out, back = ("←", "→") if ends.is_server else ("→", "←")
    name = "Its name on the client."
    return (
        Spec(
            "topic",
            "Topic",
            f"{name} Type to search, ↑ ↓ and ⏎ to pick; or type the full name: /scan." if new else name,
            blank="type to look for a topic of either side",
        ),
        Spec(
            "direction",
            "Direction",
            "transmit: from the client to the server; receive: from the server to the client.",
            options=(("transmit", f"transmit {out}"), ("receive", f"receive {back}")),
        ),
        Spec(
            "type",
            "Type",
            "package/msg/Name, or a common type's short name (LaserScan). Empty: the type in either graph.",
            blank="auto",
        ),
        Spec(
            "qos",
            "QoS",
            f"auto, {', '.join(PROFILES)}, a depth (20), or policies: {{reliability: best_effort}}",
            blank="auto",
        ),
        Spec(
            "remote_topic",
            "On the server",
            f"Its name there. Empty: the same{f', with /{ends.client} before it' if ends.use_name else ''}.",
            blank=f"/{ends.client} and its name" if ends.use_name else "same name",
        ),
    )


def _how(session: Session, begun: str | None) -> tuple[Spec, ...]:
    """How it crosses; `begun` is the protocol that it has already."""
    bluetooth = session.is_bluetooth
    has_radio = session.bluetooth_address is not None or begun == "bluetooth"
    carriers = (("", "the link's (tcp)"), ("tcp", "tcp"), ("udp", "udp"))
    protocol = Spec(
        "protocol",
        "Protocol",
        "tcp delivers all, in order; udp never waits for what was lost"
        f"{'; bluetooth uses the radio, on a channel of its own' if has_radio else ''}.",
        options=(*carriers, ("bluetooth", "bluetooth")) if has_radio else carriers,
    )
    packing = (("", f"the link's ({'zstd' if bluetooth else 'none'})"), ("none", "none"), ("zstd", "zstd"))
    port = "Channel" if bluetooth else "Port"
    channel = f" Bluetooth: a channel, {CHANNEL}, which several may share." if has_radio and not bluetooth else ""
    after = f"{session.stale_after:g} s"
    return (
        *(() if bluetooth else (protocol,)),
        Spec("port", port, f"A {port.lower()} of its own. Empty: it shares the link's.{channel}", blank="shared"),
        Spec("max_rate", "Max rate", "Hz; messages beyond it are left out. Empty: no limit.", blank="all"),
        Spec("expected_rate", "Expected rate", "Hz, shown beside the real rate. Empty: learned.", blank="learned"),
        Spec("stale_after", "Stale after", "Seconds without a message before a warning; 0: never.", blank=after),
        Spec("compression", "Compression", "zstd is worth it for maps and clouds, and on slow links.", options=packing),
        Spec("paused", "Paused", "Set up, but carries nothing until resumed.", options=(("", "no"), ("yes", "yes"))),
    )

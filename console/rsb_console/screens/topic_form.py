"""The form of a topic, a service and the like, with checks while typing."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from textual import on, work
from textual.binding import Binding
from textual.widgets import Button

from rsb_bridge.api import EngineError
from rsb_bridge.model.link_budget import LoadSource, cost_of, describe_cost
from rsb_console.screens.topic_fields import EDIT_ORDER, FIRST, KINDS, ORDER, fields_by_kind
from rsb_console.screens.topic_suggestions import suggestions_for
from rsb_console.session.draft import Ends, problems_of, topic_of
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, FieldSearch, FormScreen, Spec
from rsb_console.widgets.picker import PickField

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from textual.app import ComposeResult

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import TopicInfo
    from rsb_console.notation.formats import Row

LOOK_EVERY = 2.0  # s between two looks at the graphs; a round figure: each asks the other side for its graph


class TopicDraft(NamedTuple):
    """The result of the form."""

    topic: Topic  # as the client sees it
    link: str


@dataclass
class SideGraph:
    """The answers of one side so far."""

    infos: tuple[TopicInfo, ...] = ()
    problem: str = ""  # the reason why it does not answer
    is_awaited: bool = False
    is_late: bool = False  # the question has been open for a whole interval


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
        self._graphs: defaultdict[str | None, SideGraph] = defaultdict(SideGraph)
        """The graph of each side that has been asked: None is this side, a link's name the other."""
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
            is_shown = not self._is_folded or key in FIRST or bool(field.value)
            field.display = is_shown and (key in specs or key == "link")

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
        """Show the problems, and what a valid topic would cost on the link."""
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
        found = self._graphs[None if sends_here else draft.link].infos
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
        try:
            await self._do(result)
        except EngineError as error:
            self.form.show_problems({"": str(error)})
        else:
            self.dismiss(result)

    # -- picking ------------------------------------------------------------------------------------------------------

    def on_mount(self) -> None:
        if self._route is None:
            self._ask_both()
            self.set_interval(LOOK_EVERY, self._ask_both)

    def _ask_both(self) -> None:
        """Ask both sides what they have; a side that has not answered yet is not asked again."""
        for side in (None, self._link):
            graph = self._graphs[side]
            # What a whole interval has not answered. A note about it at once would flicker, as most answers come soon.
            graph.is_late = graph.is_awaited
            if not graph.is_awaited:
                graph.is_awaited = True
                self._ask(side, graph)
        self._suggest()

    @work(group="ask")
    async def _ask(self, side: str | None, graph: SideGraph) -> None:
        try:
            graph.infos, graph.problem = await asyncio.wrap_future(self._engine.topics(side)), ""
        except EngineError as error:
            graph.problem = str(error)
        graph.is_awaited = graph.is_late = False
        self._suggest()

    def _suggest(self) -> None:
        """List the names that both sides have, and name the side whose answer is missing."""
        link, now = self._link, self._engine.snapshot()
        here, there = self._graphs[None], self._graphs[link]
        bridged = [route for route in now.routes if route.link == link]
        field = self.form.fields["topic"]
        assert isinstance(field, PickField)
        late = "waiting for what the other side has …" if there.is_late else ""
        field.note.set_text(there.problem or here.problem or late)
        what = self._kind if self._kind_chosen else "topic, service, action or node with parameters"
        is_asking = here.is_awaited or there.is_awaited
        empty = "asking both sides …" if is_asking else f"no other {what} on either side; type the full name"
        ours, theirs = (
            [info for info in graph.infos if not self._kind_chosen or info.kind == self._kind]
            for graph in (here, there)
        )
        field.suggest(suggestions_for(Ends.of(now, link), ours, theirs, bridged), lambda _text: empty)

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

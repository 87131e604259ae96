"""Add a topic, a service and the like, or edit one: picked from both sides' graphs, checked as it is typed."""

from __future__ import annotations

import asyncio
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from textual import on, work

from rsb_bridge.api import EngineError
from rsb_bridge.model.link_budget import LoadSource, cost_of, told
from rsb_console.screens.form import FormScreen
from rsb_console.screens.topic_fields import KINDS, ORDER, fields_by_kind
from rsb_console.screens.topic_suggestions import suggestions_for
from rsb_console.session.draft import Ends, problems_of, topic_of
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.picker import PickField

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, TopicInfo

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
    """The form of a topic, a service, an action or a node's parameters.

    Args:
        engine: whose graphs and links it is about.
        do: carries out what the form gives; the form stays open, with the reason, if the engine refuses it.
        route: what to edit; None: something new.
    """

    def __init__(
        self, engine: EngineApi, do: Callable[[Draft], Awaitable[object]], route: RouteSnapshot | None = None
    ) -> None:
        self._engine, self._do, self._route = engine, do, route
        now = engine.snapshot()
        self._links = [route.link] if route is not None else [link.name for link in now.links]
        self._specs = fields_by_kind(engine.session, Ends.of(now, self._links[0]), route)
        self._kind: Kind = KINDS[0] if route is None else route.spec.kind
        self._kind_chosen = False
        self._found: dict[str | None, list[TopicInfo]] = {}
        self._errors: dict[str | None, str] = {}
        self._awaited: set[str | None] = set()
        self._late: set[str | None] = set()
        new = "Add a topic, a service, an action or a node's parameters"
        title, yes = (new, "Add") if route is None else (f"Edit {route.topic}", "Change")
        super().__init__(title, [self._field(spec) for spec in self._all_specs()], yes)
        self._show_kind()

    def _all_specs(self) -> Iterator[Spec]:
        """Those of every kind, each once, in an order that is that of each kind."""
        if len(self._links) > 1:
            clients = tuple((name, name) for name in self._links)
            yield Spec("link", "Client", "The client that it is bridged with.", options=clients)
        for key in ORDER:
            yield from islice((specs[key] for specs in self._specs.values() if key in specs), 1)

    def _show_kind(self) -> None:
        """Show the fields that the kind has, as they are called there."""
        if "kind" in self.form.fields:
            self._kind = next(kind for kind in KINDS if kind == self.form.fields["kind"].value)
        specs = self._specs[self._kind]
        for key, field in self.form.fields.items():
            if key in specs:
                field.describe(specs[key])
            field.display = key in specs or key == "link"

    def _field(self, spec: Spec) -> Field:
        if spec.key == "topic" and self._route is None:
            return PickField(spec, is_literal=lambda text: text.startswith("/"))
        return Field(spec)

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
        return told(cost, now.time) if cost.load.source is not LoadSource.UNKNOWN else ()

    def _type_of(self, draft: Draft) -> str:
        """The type that the sending side's graph has; empty: none."""
        sends_here = (draft.topic.direction == "receive") == (self._engine.session.role == "server")
        found = self._found.get(None if sends_here else draft.link, [])
        names = {draft.topic.topic, draft.topic.remote_topic, f"/{draft.link}{draft.topic.topic}"}
        return next((info.type_name for info in found if info.topic in names), "")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        replaced = None if self._route is None else self._route.spec
        found = problems_of(self.result(values).topic, self._engine.session, replaced)
        renamed = {"direction": "provider"} if self._kind != "topic" else {}
        return {renamed.get(key, key): message for key, message in found.items()}

    def result(self, values: Mapping[str, str]) -> Draft:
        given = {key: value for key, value in values.items() if key != "link"}
        return Draft(topic_of({"kind": self._kind, **given}), self._link)

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
        late = "waiting for what the other side has …" if link in self._late else ""
        field.note.set_text(self._errors.get(link) or self._errors.get(None) or late)
        waiting = self._awaited & {None, link}
        what = self._kind if self._kind_chosen else "topic, service, action or node with parameters"
        empty = "asking both sides …" if waiting else f"no other {what} on either side; type the full name"
        here, there = (
            [info for info in self._found.get(side, []) if not self._kind_chosen or info.kind == self._kind]
            for side in (None, link)
        )
        suggestions = suggestions_for(Ends.of(now, link), here, there, bridged)
        field.suggest(suggestions, lambda _text: empty)

    @on(Field.Changed)
    def _another_client_or_kind(self, event: Field.Changed) -> None:
        key = event.field.spec.key
        if key == "link":
            self._look()
        elif key == "kind":
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

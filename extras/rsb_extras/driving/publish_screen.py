"""A form that publishes a message by hand."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple

from textual import on, work

from rsb_bridge.feature_api import Effect, EngineError, Wording, escape_text
from rsb_console.feature_console import DIALOG, DONE, FAILED, ConfirmScreen, Field, Spec
from rsb_console.screens.by_hand_screen import ByHandScreen, FieldsText, fields_problem
from rsb_console.screens.dialog import beginning
from rsb_console.widgets.form import TextField
from rsb_extras.driving.landing import REPORTED_WITHIN, Landing, hearing, publish
from rsb_extras.driving.publish_requests import DraftMessage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_console.feature_console import Console, MainScreen
    from rsb_extras.driving.publish_requests import Published

_TYPED_FOR = 0.5
"""s without a key in the topic's name after which its fields are looked up."""
_LANDING, _LOOK_EVERY = "landing", 0.1
"""The group of the workers that wait for reports, and s between two looks for one."""
_KEYS = "F9 publish   tab next   esc close"


class PublishText(Wording):
    """Texts of the form."""

    TOPIC_MISSING = "missing: name the topic"
    NOT_ABSOLUTE = "a name begins with /"
    LAST = "These are the fields of a message that has just passed."
    FIELDS_UNKNOWN = "Its fields are not known: {error}"
    QUESTION = "Publish on {topic}?"
    MEANS = "It is published once, on this side{links}:\n{fields}"
    PUBLISHED = "{sign} published on {topic}: {subscriptions} here{links}"
    OVER_LINKS = ", and over the link to {links}"
    NOBODY = "{sign} nobody gets {topic}: it has no subscription here, and no link takes it{reasons}"
    HERE = "here: {hearing}"
    UNDER_WAY = "the message before is not published yet"


class Message(NamedTuple):
    """A message that is to be published.

    Attributes:
        topic: its name on this side.
        type_name: its type, or an empty string if the topic has one.
        fields: as YAML.
    """

    topic: str
    type_name: str
    fields: str


async def publish_selected(screen: MainScreen) -> None:
    """Open the form on the topic under the cursor, or another one."""
    route = screen.topics.route
    if screen.console.engine is not None:
        topic = route.topic if route is not None and route.calls is None else ""
        await screen.console.ask(PublishScreen(screen.console, Message(topic, "", "")))


async def publish_message(console: Console, topic: str, type_name: str, fields: str) -> None:
    """Open the form on a message that another screen has made."""
    await console.ask(PublishScreen(console, Message(topic, type_name, fields)))


class PublishScreen(ByHandScreen[Message]):
    """Publishes messages, each after a question; it stays open for more.

    Args:
        message: to begin with; without fields, the topic's last message or its type's defaults are offered.
    """

    AUTO_FOCUS = ".field Input"
    CSS = """
    .dialog.-publish { width: 100%; max-width: 110; }
    .dialog.-publish TextArea { height: 40vh; }
    """

    def __init__(self, console: Console, message: Message) -> None:
        self._template = ""
        self._is_busy = False
        fields = [
            Field(Spec("topic", "Topic", "Its name on this side.", message.topic)),
            Field(
                Spec(
                    "type", "Type", "Needed only for a topic that nobody has yet.", message.type_name, "the topic's own"
                )
            ),
            TextField(
                Spec(
                    "message",
                    "Message",
                    "Its fields as YAML. Missing fields get their defaults; a time may be now.",
                    message.fields,
                    "empty: every field has its default",
                )
            ),
        ]
        super().__init__(console, "Publish by hand", fields, "Publish…", _KEYS, "-publish")

    def on_mount(self) -> None:
        self._offer_template()

    # -- the message --------------------------------------------------------------------------------------------------

    @on(Field.Changed)
    def _another_topic(self, event: Field.Changed) -> None:
        if event.field.spec.key in {"topic", "type"}:
            self._offer_template(_TYPED_FOR)

    @work(group="template", exclusive=True)
    async def _offer_template(self, after: float = 0.0) -> None:
        """Write all fields of the message, unless the operator has written something else."""
        # Each further key cancels this worker, which is exclusive, and begins another.
        await asyncio.sleep(after)
        values, field, engine = self.form.values, self.form.fields["message"], self.console.engine
        if not values["topic"].startswith("/") or field.value not in ("", self._template) or engine is None:
            return
        try:
            draft = await asyncio.wrap_future(engine.do(DraftMessage(values["topic"], values["type"])))
        except EngineError as error:
            field.note.set_text(PublishText.FIELDS_UNKNOWN(error=error))
            return
        if field.value in ("", self._template):  # asked again: the operator may have typed meanwhile
            field.note.set_text(PublishText.LAST() if draft.is_last else "")
            self._template = draft.fields.strip()
            field.value = self._template

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return the problems of the name and the YAML."""
        found = {}
        if not values["topic"].startswith("/"):
            found["topic"] = PublishText.NOT_ABSOLUTE() if values["topic"] else PublishText.TOPIC_MISSING()
        if problem := fields_problem(values["message"]):
            found["message"] = problem
        return found

    def result(self, values: Mapping[str, str]) -> Message:
        return Message(values["topic"], values["type"], values["message"])

    # -- publishing ---------------------------------------------------------------------------------------------------

    @work(group=DIALOG)
    async def accept(self, result: Message) -> None:
        if self._is_busy:
            self.notify(PublishText.UNDER_WAY(), timeout=3)
            return
        routes = [each for each in self.console.snapshot().routes if each.outgoing and each.topic == result.topic]
        peers = ", ".join(sorted({self.console.peer_of(each) for each in routes if each.state.flows}))
        fields = beginning(result.fields) or FieldsText.ALL_DEFAULTS()
        means = PublishText.MEANS(links=f", and goes over the link to {peers}" if peers else "", fields=fields)
        title = PublishText.QUESTION(topic=result.topic)
        if await self.console.ask(ConfirmScreen(title, means, "Publish", Effect.MOVES)):
            self._publish(result)

    @work(group="publish")
    async def _publish(self, message: Message) -> None:
        self._is_busy = True
        # Reports of the message before would overwrite this one's result.
        self.workers.cancel_group(self, _LANDING)
        self.state.set_text("")
        landing = Landing(message.topic, self.console.snapshot())
        try:
            published = await publish(self.console.engine, message.topic, message.fields, message.type_name)
        except EngineError as error:
            self._show("down", f"{FAILED} {error}")
        else:
            lines = self._show_result(message.topic, published)
            if published.links:
                self._show_landing(landing, published, lines)
        finally:
            self._is_busy = False

    @work(group=_LANDING)
    async def _show_landing(self, landing: Landing, published: Published, lines: Sequence[str]) -> None:
        """Add what the other sides report of a message, which takes them up to a second."""
        for _ in range(round(REPORTED_WITHIN / _LOOK_EVERY)):
            if landing.is_settled(self.console.snapshot(), published.links):
                break
            await asyncio.sleep(_LOOK_EVERY)
        reports = landing.reports(self.console.snapshot(), published.links)
        heard = [each.is_heard for each in reports]
        look = "ok" if all(heard) else "slow" if any(heard) or published.audience.count else "down"
        self._show(look, *lines, *(each.text for each in reports))

    def _show_result(self, topic: str, published: Published) -> list[str]:
        """Show a message's way on this side; return it in words."""
        count, deaf = published.audience.count, published.audience.deaf
        here = [PublishText.HERE(hearing=hearing(published.audience))] if deaf else []
        if count or published.links:
            subscriptions = f"{count} subscription{'' if count == 1 else 's'}"
            links = PublishText.OVER_LINKS(links=", ".join(published.links)) if published.links else ""
            text = PublishText.PUBLISHED(sign=DONE, topic=topic, subscriptions=subscriptions, links=links)
            self._show("slow" if deaf else "ok", text, *here)
            return [text, *here]
        routes = (each for each in self.console.snapshot().routes if each.outgoing and each.topic == topic)
        reasons = "".join(f"; {each.link}: {each.reason or each.state.value}" for each in routes)
        text = PublishText.NOBODY(sign=FAILED, topic=topic, reasons=reasons)
        self._show("down", text, *here)
        return [text, *here]

    def _show(self, look: str, *lines: str) -> None:
        self.state.set_text("\n".join(map(escape_text, lines)))
        self.state.set_classes(f"call-state -{look}")

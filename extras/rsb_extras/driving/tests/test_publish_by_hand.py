"""Publishing a message by hand in the console, on an engine that plays a script."""

from dataclasses import replace
from typing import Any

import pytest
from msgspec import structs
from tests.console.driving import (
    NARROW,
    WIDE,
    Decorator,
    fill,
    form_of,
    gone,
    notified,
    on_main,
    put,
    settled,
    shown,
    text,
    until,
)
from tests.console.scripted import call_route, route
from tests.support.long import long
from tests.support.wording import says
from textual.events import Paste
from textual.pilot import Pilot
from textual.widgets import Button, Static

from rsb_bridge.api import EngineError
from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State
from rsb_console.app import ConsoleApp
from rsb_console.screens.by_hand_screen import FieldsText
from rsb_extras.driving.landing import HearingText
from rsb_extras.driving.publish_requests import Draft, Publish, Published
from rsb_extras.driving.publish_screen import PublishScreen, PublishText
from rsb_extras.driving.tests.publishing_engine import PublishingEngine, engine_of

STRING = "std_msgs/msg/String"
WORDS = route("/words", outgoing=True, spec=Topic("/words", "transmit"), type_name=STRING)
DRAFT = Draft(STRING, "data: ''\n")
TAKEN = Published(is_done=True, ticket=5, type_name=STRING, audience=Audience(2), links=("robot1",))
ALONE = Published(is_done=True, ticket=5, type_name=STRING)


def on(*sizes: Any, routes: tuple[RouteSnapshot, ...] = (WORDS,), drafts: dict[str, Draft] | None = None) -> Decorator:
    """A test's steps run once the form is open, for the topic under the cursor."""

    def make(session: Any, base: Any) -> PublishingEngine:
        engine = PublishingEngine(session, base, routes)
        engine.drafts = {"/words": DRAFT} if drafts is None else drafts
        return engine

    async def opened(pilot: Pilot[None]) -> None:
        await pilot.press("S")
        await until(pilot, lambda: isinstance(pilot.app.screen, PublishScreen), "the form")

    return on_main(*sizes, landmark=routes[0].topic, opening=opened, make_engine=make)


def sent(app: ConsoleApp) -> list[Publish]:
    return [command[1] for command in engine_of(app).commands if command[0] == "publish"]  # type: ignore[misc]


def drafts(app: ConsoleApp) -> list[tuple[object, ...]]:
    return [command[1:] for command in engine_of(app).commands if command[0] == "draft"]


def message(app: ConsoleApp) -> str:
    return form_of(app).values["message"]


async def submit(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Press the form's key, once it listens again: it ignores keys for a moment after the one before."""
    await until(pilot, lambda: isinstance(app.screen, PublishScreen), "the form")
    await until(pilot, lambda: not form_of(app).input_guard.covers(Paste("")), "a form that listens")
    await pilot.press("f9")


async def publish(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Say yes to the question."""
    count = len(sent(app))
    await submit(app, pilot)
    await shown(pilot, PublishText.QUESTION)
    await pilot.press("y")
    await until(pilot, lambda: len(sent(app)) > count, "a message")


# -- a message to begin with


@pytest.mark.parametrize("is_last", [True, False])
def test_the_last_message_or_the_defaults_are_offered(is_last: bool) -> None:
    @on(drafts={"/words": Draft(STRING, "data: hello\n", is_last)})
    async def test(app: ConsoleApp, pilot: Pilot[None]) -> None:
        await until(pilot, lambda: message(app) == "data: hello", "the message")
        assert drafts(app) == [("/words", "")]
        await (shown if is_last else gone)(pilot, PublishText.LAST)
        assert not sent(app)

    test()


@on(drafts={})
async def test_untyped_form_has_reason_and_is_filled(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, PublishText.FIELDS_UNKNOWN)
    assert all(line.isprintable() for line in text(app).split("\n"))
    await fill(pilot, message="data: hello", type=STRING)
    engine_of(app).published = [TAKEN]
    await publish(app, pilot)
    ((topic, fields, type_name),) = [(each.topic, each.fields, each.type_name) for each in sent(app)]
    assert (topic, fields, type_name) == ("/words", "data: hello", STRING)


@on(drafts={"/words": DRAFT, "/other": Draft(STRING, "data: other\n")})
async def test_another_topic_has_another_message(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app) == "data: ''", "the message")
    await fill(pilot, topic="/other")
    await until(pilot, lambda: message(app) == "data: other", "the other message")
    assert drafts(app)[-1] == ("/other", "")


@on(drafts={"/other": Draft(STRING, "data: other\n"), "/words": DRAFT})
async def test_a_message_that_was_written_is_not_replaced(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app) == "data: ''", "the message")
    await fill(pilot, message="data: mine")
    await fill(pilot, topic="/other", type=STRING)
    await settled(pilot)
    await gone(pilot, "data: other")
    assert message(app) == "data: mine"
    assert drafts(app) == [("/words", "")]


@on(drafts={"/w": DRAFT})
async def test_a_type_helps_where_nobody_has_the_topic(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, PublishText.FIELDS_UNKNOWN)
    engine_of(app).drafts["/words"] = DRAFT
    await fill(pilot, type=STRING)
    await until(pilot, lambda: message(app) == "data: ''", "the message")
    assert drafts(app)[-1] == ("/words", STRING)
    await gone(pilot, PublishText.FIELDS_UNKNOWN)


@on(routes=(call_route("service", "/dock"),))
async def test_a_service_is_no_topic(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await settled(pilot)
    assert form_of(app).values["topic"] == ""
    assert drafts(app) == []


# -- problems


@on()
async def test_mistakes_are_shown_and_nothing_is_asked(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    for topic, problem in (("", PublishText.TOPIC_MISSING), ("words", PublishText.NOT_ABSOLUTE)):
        await fill(pilot, topic=topic, message="data: x")
        await pilot.press("f9")
        await shown(pilot, problem)
        await gone(pilot, PublishText.QUESTION)
    await fill(pilot, topic="/words")
    for wrong, words in (("- 1", FieldsText.NO_MAPPING), ("data: [", "while parsing"), ("a: &x 1\nb: *x", "alias")):
        await fill(pilot, message=wrong)
        await shown(pilot, words)
        await pilot.press("f9")
        await settled(pilot)
        await gone(pilot, PublishText.QUESTION)
    assert not sent(app)


# -- the question


@on(*long(WIDE), NARROW)
async def test_a_message_is_published_after_a_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    await fill(pilot, message="data: hello")
    await pilot.press("f9")
    await shown(pilot, PublishText.QUESTION, topic="/words")
    await shown(pilot, "10.0.0.20:49152:")
    await shown(pilot, "data: hello")
    await until(pilot, lambda: app.focused is app.screen.query_one("#no", Button), "No under enter")
    await pilot.press("enter")
    await gone(pilot, PublishText.QUESTION)
    assert not sent(app)
    engine_of(app).published = [TAKEN, TAKEN]
    await publish(app, pilot)
    await shown(pilot, PublishText.PUBLISHED, sign="✓", topic="/words")
    await shown(pilot, PublishText.OVER_LINKS, links="robot1")
    assert [(each.topic, each.fields, each.type_name, each.rest) for each in sent(app)] == [
        ("/words", "data: hello", "", "")
    ]
    await publish(app, pilot)  # the form stays open
    assert len(sent(app)) == 2
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list")


@on()
async def test_an_empty_message_has_all_defaults(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    await fill(pilot, message="")
    await pilot.press("f9")
    await shown(pilot, FieldsText.ALL_DEFAULTS)
    await pilot.press("y")
    await until(pilot, lambda: [each.fields for each in sent(app)] == [""], "the message")


@on(routes=(route("/words", State.PAUSED, outgoing=True), route("/words", key="in", link="robot2")))
async def test_the_question_names_only_links_that_take_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    await pilot.press("f9")
    await shown(pilot, PublishText.QUESTION)
    await gone(pilot, "10.0.0.20:49152:")


# -- the result


@on(routes=(route("/words", State.DOWN, outgoing=True, reason="no link \x1b[2J"),))
async def test_nobody_gets_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    engine_of(app).published = [ALONE]
    await publish(app, pilot)
    await shown(pilot, PublishText.NOBODY, sign="✗", topic="/words")
    await shown(pilot, "robot1: no link")
    assert all(line.isprintable() for line in text(app).split("\n"))


@on()
async def test_refusal_is_shown_and_can_be_tried_again(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    engine_of(app).published = [EngineError("no luck [red]\x1b[2J"), TAKEN]
    await publish(app, pilot)
    await shown(pilot, "✗ no luck [red]")
    assert all(line.isprintable() for line in text(app).split("\n"))
    await publish(app, pilot)
    await shown(pilot, PublishText.PUBLISHED, sign="✓")
    await gone(pilot, "no luck")


@on()
async def test_the_next_message_waits_for_the_one_before(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    await publish(app, pilot)
    await submit(app, pilot)
    await notified(pilot, PublishText.UNDER_WAY)
    assert len(sent(app)) == 1
    engine_of(app).publishing.set_result(TAKEN)
    await shown(pilot, PublishText.PUBLISHED, sign="✓")
    await publish(app, pilot)


# -- where nothing is published


@on()
async def test_the_form_shows_what_the_other_side_reports(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: message(app), "the message")
    engine_of(app).published = [TAKEN]
    await publish(app, pilot)
    delivered = replace(WORDS.ledger, delivered=WORDS.ledger.delivered + 1)
    put(app, replace(WORDS, ledger=delivered, audience=Audience(1, ("motors",))))
    await shown(pilot, HearingText.HEARD, nodes="motors")
    await shown(pilot, PublishText.PUBLISHED, sign="✓", topic="/words")
    result, report = str(app.screen.query_one(".call-state", Static).render()).splitlines()
    assert says(result, PublishText.PUBLISHED, sign="✓", topic="/words")
    assert "motors" in report
    assert app.screen.query_one(".call-state").has_class("-ok")


@pytest.mark.parametrize(("here", "look"), [(Audience(2), "-slow"), (Audience(), "-down")])
@on()
async def test_the_form_warns_of_deaf_subscribers(
    app: ConsoleApp, pilot: Pilot[None], here: Audience, look: str
) -> None:
    await until(pilot, lambda: message(app), "the message")
    engine_of(app).published = [structs.replace(TAKEN, audience=here)]
    await publish(app, pilot)
    deaf = Deaf("/base", "qos_incompatible", "no way")
    delivered = replace(WORDS.ledger, delivered=WORDS.ledger.delivered + 1)
    put(app, replace(WORDS, ledger=delivered, audience=Audience(0, (), (deaf,))))
    await shown(pilot, HearingText.NOT_HEARD, node="/base", reason="no way")
    assert app.screen.query_one(".call-state").has_class(look)

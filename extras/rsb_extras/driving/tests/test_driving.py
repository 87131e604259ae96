"""Driving by keys: what keys mean and for how long, what is sent, and what ends it."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from tests.console.driving import (
    NARROW,
    WIDE,
    Decorator,
    engine_as,
    gone,
    is_shown,
    notified,
    on_main,
    put,
    shown,
    text,
    until,
)
from tests.console.scripted import SESSION, route
from tests.support import replaced
from tests.support.heights import heights_of
from tests.support.wording import says
from textual.events import Key
from textual.pilot import Pilot

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.commands import AskHolder, Command
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, Driver, RouteSnapshot, Snapshot, State
from rsb_console.app import ConsoleApp
from rsb_console.screens.take_over import HandOverText
from rsb_console.terminal.pulse import Pulse
from rsb_extras.driving.drive_screen import (
    TWIST,
    TWIST_STAMPED,
    DriveScreen,
    DriveText,
    also_driving,
    drive_one,
    limits_on,
    velocity,
    why_not_driven,
)
from rsb_extras.driving.landing import ByHandText, HearingText
from rsb_extras.driving.publish_requests import Draft, Publish, Published
from rsb_extras.driving.tests import driving_places
from rsb_extras.driving.tests.publishing_engine import PublishingEngine, engine_of

SPEED, TURN = 0.2, 0.5

# -- topics

ARMED = route(
    "/cmd_vel", outgoing=True, type_name=TWIST, max_age=0.5,
    arming=ArmingSnapshot(armed=True, by="anna", here=True, left=42.0, deadman=60.0),
)  # fmt: skip
DISARMED = replace(
    ARMED, state=State.DISARMED, arming=ArmingSnapshot(armed=False, deadman=60.0, why="not_yet", reason="not yet")
)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, None),
        ({"type_name": TWIST_STAMPED}, None),
        ({"type_name": "", "spec": Topic("/cmd_vel", "transmit", type=TWIST)}, None),
        ({"type_name": "std_msgs/msg/String"}, DriveText.OTHER_TYPE),
        ({"type_name": ""}, DriveText.TYPE_UNKNOWN),
        ({"arming": None}, DriveText.NOT_DRIVEN),
        ({"max_age": 0.0}, DriveText.NOT_DRIVEN),
    ],
)
def test_only_armed_velocity_without_old_messages_is_driven(changes: dict[str, Any], reason: DriveText | None) -> None:
    found = why_not_driven(replace(ARMED, **changes))
    assert says(found, reason, topic="/cmd_vel") if reason else found == ""


# -- commands


class Clock:
    """The screen's module `time`, which advances only by the duration of commands."""

    def __init__(self) -> None:
        self.now = time.monotonic()
        self.looks = 0

    def monotonic(self) -> float:
        self.looks += 1
        return self.now


class Robot(PublishingEngine):
    """An engine that asks for a ticket, and takes 0.1 s for each command."""

    def _execute(self, command: Any, step: Any) -> Future[Any]:
        if isinstance(command, Publish):
            driving_places.DRIVE_TIME.value.now += 0.1
            if not self.published:
                self.published = [Published(is_done=command.ticket > 0, ticket=command.ticket + 1)]
        return super()._execute(command, step)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    driving_places.DRIVE_TIME.set(monkeypatch, made)
    driving_places.DRIVE_STOOD_STILL.set(monkeypatch, float("inf"))  # as this clock does
    return made


def driven(shown_route: RouteSnapshot = ARMED) -> Decorator:
    """A test's steps run once the screen is open on a route."""

    async def opened(pilot: Pilot[None]) -> None:
        await pilot.press("D")
        await until(pilot, lambda: isinstance(pilot.app.screen, DriveScreen), "the screen")

    return on_main(landmark=shown_route.topic, opening=opened, make_engine=robot_of(shown_route))


def robot_of(*routes: RouteSnapshot) -> Callable[..., Robot]:
    return lambda session, base: Robot(session, base, routes)


def sent(app: ConsoleApp) -> list[Publish]:
    return [command[1] for command in engine_as(app, Robot).commands if command[0] == "publish"]  # type: ignore[misc]


def velocities(app: ConsoleApp) -> list[str]:
    return [each.fields for each in sent(app)]


async def arm(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("A")
    await shown(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).commands == [("arm", "/cmd_vel")], "armed")


async def pressed(pilot: Pilot[None], clock: Clock, *keys: str) -> None:
    """Press keys, once no command has put the screen's clock ahead of the keys' own."""
    await until(pilot, lambda: time.monotonic() >= clock.now, "the keys' clock")
    clock.now = time.monotonic()
    await pilot.press(*keys)


async def pressed_until_shown(app: ConsoleApp, pilot: Pilot[None], clock: Clock, key: str, words: str) -> None:
    """Press a key until the screen shows its effect: commands may end it before a slow machine has drawn it."""
    deadline = time.monotonic() + 180.0
    while not is_shown(app, words):
        assert time.monotonic() < deadline, f"{words!r} not on the screen:\n{text(app)}"
        await pressed(pilot, clock, key)


async def rests(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> int:
    """Wait until nothing more is sent, and return the number of messages."""

    count, looks = len(sent(app)), clock.looks

    def unchanged() -> bool:
        nonlocal count, looks
        if len(sent(app)) != count:
            count, looks = len(sent(app)), clock.looks
        return clock.looks > looks + 20

    await until(pilot, unchanged, "rest")
    return count


ZERO = velocity(TWIST, 0.0, 0.0)


@driven()
async def test_commands_go_out_while_key_counts_then_zeros(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await pressed(pilot, clock, "u")
    await until(pilot, lambda: ZERO in velocities(app), "the end of the key")
    count = await rests(app, pilot, clock)
    moving = velocities(app).index(ZERO)
    assert moving >= 6
    assert velocities(app) == [velocity(TWIST, SPEED, TURN)] * moving + [ZERO] * (count - moving)
    assert 4 <= count - moving <= 6
    assert {(each.topic, each.type_name, each.rest, each.rest_after) for each in sent(app)} == {
        ("/cmd_vel", TWIST, ZERO, 0.5)
    }
    assert [each.ticket for each in sent(app)] == [*range(count)]


@driven()
async def test_round_trip_has_lateness_of_terminal(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "round trip 3 ms")
    app.writer.late = 2.0  # type: ignore[misc]
    await shown(pilot, "round trip 2003 ms")


@pytest.mark.parametrize(("forward", "turn"), [(0.2, -0.5), (-2.0, 0.0), (0.0, 0.0)])
def test_a_velocity_has_the_fields_of_its_type(forward: float, turn: float) -> None:
    twist = {"linear": {"x": f"{forward:.3f}"}, "angular": {"z": f"{turn:.3f}"}}
    assert read_fields(velocity(TWIST, forward, turn)) == twist
    assert read_fields(velocity(TWIST_STAMPED, forward, turn)) == {"header": "auto", "twist": twist}


@driven()
async def test_while_the_robot_stands_nothing_is_sent(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await shown(pilot, DriveText.NO_KEY)
    await pressed(pilot, clock, "space", "k", "plus", "minus")
    assert await rests(app, pilot, clock) == 0


@driven(replace(ARMED, type_name=TWIST_STAMPED))
async def test_a_stamped_velocity(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await pressed(pilot, clock, "down")
    await until(pilot, lambda: sent(app), "a command")
    assert (sent(app)[0].type_name, sent(app)[0].rest) == (TWIST_STAMPED, velocity(TWIST_STAMPED, 0.0, 0.0))
    assert read_fields(sent(app)[0].fields) == read_fields(velocity(TWIST_STAMPED, -SPEED, 0.0))


@driven()
async def test_a_key_that_was_held_up_moves_nothing(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    """It counts from the time when it came to this process, however long the console was busy."""
    event = Key("up", None)
    event.time -= 2.0
    clock.now = time.monotonic()
    app.post_message(event)
    assert await rests(app, pilot, clock) == 0


@on_main(NARROW, WIDE, landmark=ARMED.topic, make_engine=robot_of(ARMED))
async def test_box_has_its_height_at_once(app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a slow line would carry it twice."""
    heights = heights_of("#drive", monkeypatch)
    await pilot.press("D")
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the screen")
    await shown(pilot, DriveText.NO_KEY)
    await pilot.pause(0.3)
    assert heights == [app.screen.query_one("#drive").outer_size.height]


@driven()
async def test_a_burst_of_late_keys_stops(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    assert isinstance(app.screen, DriveScreen)
    steering = app.screen._steering
    events = [Key("up", None) for _ in range(20)]
    for event in events:
        event.time = events[0].time
        app.post_message(event)
    await until(pilot, lambda: steering.came_late(events[0].time), "late keys")
    assert steering.at(events[0].time) == (0.0, 0.0)


@driven()
async def test_a_refusal_is_shown(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    engine_of(app).published = [EngineError("no luck [red]\x1b[2J")] * 200
    await pressed(pilot, clock, "up")
    await shown(pilot, "no luck [red]\\x1b[2J")
    engine_of(app).published = []
    await pressed(pilot, clock, "up")
    await gone(pilot, "no luck")
    assert ZERO in velocities(app) or await rests(app, pilot, clock)


@driven()
async def test_tickets_that_are_too_old_are_reported(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    engine_of(app).published = [Published(is_done=False, ticket=7)] * 200
    await pressed(pilot, clock, "up")
    await shown(pilot, ByHandText.TOO_SLOW, topic="/cmd_vel")
    assert [each.ticket for each in sent(app)][:4] == [0, 7, 7, 7]
    await rests(app, pilot, clock)
    engine_of(app).published = []
    await pressed(pilot, clock, "up")
    await gone(pilot, ByHandText.TOO_SLOW)


@driven()
async def test_after_old_tickets_three_are_tried_again(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    screen = app.screen
    assert isinstance(screen, DriveScreen)
    send = screen._send
    for _ in range(2):
        engine_of(app).published = [Published(is_done=False, ticket=7)] * 4
        assert [await send(0.1, 0.0) for _ in range(3)] == [False] * 3
        with pytest.raises(EngineError):
            await send(0.1, 0.0)
    engine_of(app).published = [Published(is_done=True, ticket=8)]
    assert await send(0.1, 0.0)


# -- the screen


@driven()
async def test_closing_the_screen_ends_the_sending(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await pressed(pilot, clock, "up")
    await until(pilot, lambda: sent(app), "a command")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list")
    await until(pilot, lambda: all(each.is_finished for each in app.workers if each.name == "_drive"), "the end")


@driven()
async def test_it_shows_whether_the_topic_is_armed(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await shown(pilot, DriveText.LEFT, seconds=42.0)
    put(app, DISARMED)
    await shown(pilot, DriveText.DISARMED, reason=" (not yet)")
    put(app, route("/other"))
    await shown(pilot, DriveText.GONE)
    await pressed(pilot, clock, "A")
    assert engine_of(app).commands == []


@driven()
async def test_disarming_is_immediate_arming_asks(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await pilot.press("A")
    await until(pilot, lambda: engine_of(app).commands == [("disarm", "/cmd_vel")], "disarmed")
    put(app, DISARMED)
    await pilot.press("A")
    await shown(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("A")
    await shown(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).commands[1:] == [("arm", "/cmd_vel")], "armed")
    assert isinstance(app.screen, DriveScreen)


def arming(*, here: bool = True, by: str = "anna") -> ArmingSnapshot:
    return ArmingSnapshot(armed=True, by=by, here=here, deadman=60.0)


@pytest.mark.parametrize("shown_as", [ARMED, DISARMED], ids=["armed", "under way"])
@driven(DISARMED)
async def test_leaving_the_screen_disarms_what_it_has_armed(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, shown_as: RouteSnapshot
) -> None:
    await arm(app, pilot)
    put(app, shown_as)
    await pilot.press("escape")
    await until(pilot, lambda: engine_of(app).commands[1:] == [("disarm", "/cmd_vel", "own")], "disarmed")


@driven()
async def test_leaving_the_screen_leaves_armed_what_was_before(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock
) -> None:
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list")
    assert engine_of(app).commands == []


@driven()
async def test_another_driver_is_named(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    put(app, replace(ARMED, arming=arming(here=False, by="robot1 says: bert")))
    await shown(pilot, DriveText.ARMED_BY, who="robot1 says: bert")


@driven()
async def test_lost_bridge_leaves_nothing_shown_as_armed(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    put(app, replace(ARMED, arming=replace(arming(), velocity=(0.2, 0.0))))
    await shown(pilot, DriveText.MOVING, forward=0.2)
    engine_of(app).unreachable = "no router answers"
    await shown(pilot, DriveText.DETACHED, reason="no router answers")
    assert is_shown(app, DriveText.NOT_WHILE_DETACHED)
    assert not is_shown(app, DriveText.MOVING, forward=0.2)
    engine_of(app).unreachable = ""
    await shown(pilot, DriveText.MOVING, forward=0.2)


@driven(DISARMED)
async def test_no_velocity_is_shown_while_disarmed(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await shown(pilot, DriveText.NOT_WHILE_DISARMED)
    await pressed(pilot, clock, "up")
    assert f"{SPEED:+.2f}" not in text(app)


@on_main(
    landmark="/cmd_vel",
    make_engine=robot_of(ARMED, replace(ARMED, key="other", link="robot2")),
)
async def test_other_moved_robots_are_named_and_asked_for(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await pilot.press("D")
    await shown(pilot, DriveText.SEVERAL(topic="/cmd_vel", count=2))
    await shown(pilot, "robot1 and robot2")
    await pilot.press("n")
    await until(pilot, lambda: app.screen is app.main, "the list")
    await pilot.press("D")
    await shown(pilot, DriveText.SEVERAL(topic="/cmd_vel", count=2))
    await pilot.press("y")
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the screen")


@driven(DISARMED)
async def test_only_keys_on_arming_screen_keep_armed(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    kept: list[bool] = []
    engine_of(app).kept = kept
    await pilot.press("A", "y")
    put(app, ARMED)
    kept.clear()
    await pilot.press("up")
    await until(pilot, lambda: any(kept), "a key that counts")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is app.main, "the list")
    app.pull()
    kept.clear()
    await pilot.press("up", "down")
    app.pull()
    assert kept
    assert not any(kept)


@pytest.mark.parametrize(
    ("spec", "known"),
    [(Topic("/cmd_vel", "transmit", type="Twist"), True), (Topic("/cmd_vel", "transmit"), False)],
)
@on_main(landmark="/cmd_vel", make_engine=robot_of(ARMED))
async def test_type_may_be_short_or_known_to_bridge(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, spec: Topic, known: bool
) -> None:
    put(app, replace(ARMED, type_name="", spec=spec))
    if not known:
        engine_of(app).drafts["/cmd_vel"] = Draft(TWIST, "")
    await pilot.press("D")
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the screen")
    await pressed(pilot, clock, "up")
    await until(pilot, lambda: sent(app), "a command")
    assert sent(app)[0].type_name == TWIST


@on_main(landmark="/cmd_vel", make_engine=robot_of(replace(ARMED, max_age=0.0)))
async def test_a_topic_that_cannot_be_driven_is_named(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("D")
    await notified(pilot, DriveText.NOT_DRIVEN, topic="/cmd_vel")
    assert app.screen is app.main


# -- on a picture of the robot

OTHER = replace(DISARMED, topic="/robot3/cmd_vel", key="3")
UNTYPED = replace(DISARMED, type_name="", spec=Topic("/cmd_vel", "transmit"))
ON_A_ROBOT: list[tuple[tuple[RouteSnapshot, ...], str | DriveText]] = [
    ((DISARMED,), "/cmd_vel"),
    ((DISARMED, replace(OTHER, arming=ARMED.arming)), "/robot3/cmd_vel"),
    ((UNTYPED,), "/cmd_vel"),
    ((replace(UNTYPED, topic="/untyped"),), DriveText.TYPE_UNKNOWN),
    ((), DriveText.NONE_HERE),
    ((replace(DISARMED, max_age=0.0),), DriveText.NONE_HERE),
    ((DISARMED, OTHER), DriveText.SEVERAL_HERE),
]


@pytest.mark.parametrize(("routes", "result"), ON_A_ROBOT)
@on_main(landmark="/cmd_vel", make_engine=robot_of(DISARMED))
async def test_the_one_topic_of_a_robot_is_driven(
    app: ConsoleApp, pilot: Pilot[None], routes: tuple[RouteSnapshot, ...], result: str | DriveText
) -> None:
    put(app, *routes)
    engine_of(app).drafts["/cmd_vel"] = Draft(TWIST, "")
    app.run_worker(drive_one(app, routes))
    if isinstance(result, DriveText):
        await notified(pilot, result)
        assert app.screen is app.main
    else:
        await shown(pilot, f"Drive {result}")


@driven()
async def test_what_the_robot_has_in_hand_is_shown(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    assert ARMED.arming is not None
    for given, motion in [
        ((0.2, 0.0), DriveText.MOVING(forward=0.2, turning="")),
        ((0.2, -0.5), DriveText.MOVING(forward=0.2, turning=DriveText.TURNING(turn=-0.5))),
        ((0.0, 0.0), DriveText.RESTS()),
    ]:
        put(app, replace(ARMED, arming=replace(ARMED.arming, velocity=given)))
        await shown(pilot, DriveText.IN_HAND, link=ARMED.link, motion=motion)


JOYSTICK, HAND = Driver("/joystick", here=True, rate=10.0), Driver("", here=True, rate=5.0, by_hand=True)
BESIDE = Driver("/nav", here=False)
JOYSTICK_DRIVES = DriveText.ALSO(who="/joystick", rate="10")


@pytest.mark.parametrize(
    ("drivers", "holds", "text"),
    [
        ((), True, ""),
        ((replace(JOYSTICK, rate=0.0),), True, ""),
        ((replace(JOYSTICK, rate=None),), True, ""),
        ((HAND,), True, ""),
        ((HAND,), False, DriveText.ALSO(who="anna", rate="5")),
        ((JOYSTICK, HAND), True, JOYSTICK_DRIVES),
        ((JOYSTICK, BESIDE), True, f"{JOYSTICK_DRIVES}; {DriveText.BESIDE(who='/nav', link='robot1')}"),
    ],
)
def test_who_else_moves_robot(drivers: tuple[Driver, ...], holds: bool, text: str) -> None:
    snapshot = SimpleNamespace(routes=(replace(ARMED, drivers=drivers),))
    assert also_driving(ARMED, cast("Snapshot", snapshot), holds=holds) == text


def test_on_robots_side_far_drivers_have_rates() -> None:
    receiving = replace(ARMED, outgoing=False, drivers=(replace(JOYSTICK, here=False), replace(BESIDE, here=True)))
    snapshot = cast("Snapshot", SimpleNamespace(routes=(receiving,)))
    beside = DriveText.BESIDE_HERE(who="/nav", link="robot1")
    assert also_driving(receiving, snapshot, holds=True) == f"{JOYSTICK_DRIVES}; {beside}"


@driven(replace(ARMED, drivers=(JOYSTICK,)))
async def test_box_says_that_joystick_drives(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    await shown(pilot, DriveText.NO_KEY)
    await shown(pilot, DriveText.ALSO, who="/joystick", rate="10")
    await pressed_until_shown(app, pilot, clock, "up", f"forward {SPEED:+.2f} m/s")
    await shown(pilot, DriveText.ALSO, who="/joystick", rate="10")
    put(app, ARMED)
    await gone(pilot, JOYSTICK_DRIVES)


@driven()
async def test_who_cannot_hear_here_is_shown(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    deaf = Deaf("/base", "qos_incompatible", "no way")
    engine_of(app).published = [Published(is_done=True, ticket=8, audience=Audience(0, (), (deaf,)))] * 20
    await pressed(pilot, clock, "up")
    await shown(pilot, HearingText.NOT_HEARD, node="/base", reason="no way")


# -- several drivers

ELSEWHERE = replace(ARMED, arming=ArmingSnapshot(armed=True, by="bert on pts/2", here=True, deadman=60.0))
QUESTION = replace(arming(), asked_by="bert on pts/2", goes_in=7.0)
ASKED = replace(ARMED, arming=QUESTION)


@pytest.mark.parametrize(
    ("key", "command"), [("y", "ask_holder"), ("t", "take_arming"), ("A", "disarm"), ("n", ""), ("escape", "")]
)
@driven(ELSEWHERE)
async def test_topic_of_other_console_is_asked_taken_disarmed(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, key: str, command: str
) -> None:
    """Also if it was armed on this side."""
    engine_of(app).holds = ()
    await shown(pilot, DriveText.ARMED_BY, who="bert on pts/2")
    await pilot.press("A")
    await shown(pilot, HandOverText.HELD, topic="/cmd_vel")
    await shown(pilot, "bert on pts/2 holds it")
    await pilot.press(key)
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the screen")
    expected = [(command, "/cmd_vel")] if command else []
    await until(pilot, lambda: engine_of(app).commands == expected, "the command")


@driven(ELSEWHERE)
async def test_yes_arms_nothing_that_holder_has_released(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    engine_of(app).holds = ()
    await shown(pilot, DriveText.ARMED_BY, who="bert on pts/2")
    await pilot.press("A")
    await shown(pilot, HandOverText.HELD, topic="/cmd_vel")
    put(app, DISARMED)
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "no question")
    assert engine_of(app).commands == []


@driven(DISARMED)
async def test_second_key_disarms_what_first_has_just_armed(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    replaced.DEADMAN_KEEP.set(monkeypatch, lambda *_: None)  # no answer says yet that this console holds it
    await arm(app, pilot)
    put(app, ARMED)
    await pilot.press("A")
    await until(pilot, lambda: engine_of(app).commands[1:] == [("disarm", "/cmd_vel")], "disarmed")


@driven(ELSEWHERE)
async def test_who_may_not_take_is_not_offered_it(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    engine_of(app).holds = ()
    engine_of(app).may_take = False
    await shown(pilot, DriveText.ARMED_BY, who="bert on pts/2")
    await pilot.press("A")
    await shown(pilot, "A disarm   n no")
    question = app.screen
    assert not question.query("#take")
    assert HandOverText.TAKE_KEY().strip() not in text(app)
    await pilot.press("t")
    await pilot.press("n")
    await until(pilot, lambda: isinstance(app.screen, DriveScreen), "the screen")
    assert engine_of(app).commands == []


@driven(ELSEWHERE)
async def test_leaving_the_screen_asks_no_longer(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    asking: list[Future[None]] = []

    def answer(command: Command[Any]) -> Future[None] | None:
        if not isinstance(command, AskHolder):
            return None
        asking.append(Future())
        return asking[-1]

    engine = engine_of(app)
    engine.holds = ()
    engine.answering = answer
    await shown(pilot, DriveText.ARMED_BY, who="bert on pts/2")
    await pilot.press("A")
    await shown(pilot, HandOverText.HELD, topic="/cmd_vel")
    await pilot.press("y")
    await until(pilot, lambda: asking, "the question")
    engine.kept.clear()
    put(app, replace(ELSEWHERE, arming=replace(QUESTION, by="bert on pts/2", here=False, asked_by="anna")))
    await shown(pilot, DriveText.ASKED, who="bert on pts/2", seconds=7.0)
    await until(pilot, lambda: engine.kept, "a sign of life, without which the question ends")
    await pilot.press("escape")
    await until(pilot, asking[0].cancelled, "no question")


@pytest.mark.parametrize(("key", "gives"), [("y", True), ("n", False)])
@driven()
async def test_holder_sees_question_while_driving_and_answers(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, key: str, gives: bool
) -> None:
    """The keys that drive and stop do so meanwhile. A key that came before the question is no answer."""
    clock.now += 60.0
    put(app, ASKED)
    await shown(pilot, DriveText.ASKS, who="bert on pts/2", seconds=7.0)
    clock.now -= 60.0
    await pilot.press(key)
    await pressed(pilot, clock, "up")
    await until(pilot, lambda: sent(app), "a command")
    assert not [command for command in engine_of(app).commands if command[0] == "answer_asker"]
    put(app, ARMED)
    await gone(pilot, "asks for it")
    await rests(app, pilot, clock)  # each command puts the screen's clock ahead of the keys' own
    clock.now = time.monotonic() - 1.0
    put(app, ASKED)
    await shown(pilot, DriveText.ASKS, who="bert on pts/2", seconds=7.0)
    deadline = time.monotonic() + 180.0
    while ("answer_asker", "/cmd_vel", gives) not in engine_of(app).commands:
        assert time.monotonic() < deadline
        await pilot.press(key)  # again, if a late command has put the screen's clock ahead once more
        await pilot.pause(0.2)
    assert isinstance(app.screen, DriveScreen)


@driven(ELSEWHERE)
async def test_refusal_is_gone_once_another_operator_holds_topic(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock
) -> None:
    """It names the holder of before, and this console may be the holder now."""
    engine_of(app).published = [EngineError("no luck")] * 200
    await pressed(pilot, clock, "up")
    await shown(pilot, "no luck")
    await rests(app, pilot, clock)
    put(app, ARMED)
    await gone(pilot, "no luck")


@driven()
async def test_a_multiplexer_asks_for_held_keys(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    assert isinstance(app.screen, DriveScreen)
    assert not is_shown(app, "to drive")
    app.input_gate.pulse = Pulse({"TMUX": "1"})
    await shown(pilot, "to drive")
    await shown(pilot, "u i o     ↖ ↑ ↗")


async def arrive(app: ConsoleApp, clock: Clock, *arrivals: float) -> None:
    """Have one key come at some times (s) from now."""
    began = clock.now
    for at in arrivals:
        clock.now = began + at
        key = Key("up", None)
        key.time = clock.now
        app.post_message(key)


@pytest.mark.parametrize(
    ("arrivals", "words", "seconds"),
    [
        ([0.0], DriveText.HOLD, None),
        ([0.0, 0.05], DriveText.LET_GO, None),
        ([0.0, 0.5, *[0.7] * 6, *[0.9] * 6, *[1.1] * 6], DriveText.BUNCHES, 0.2),
        ([0.0, 0.5, *[1.0] * 15, *[1.5] * 15, *[2.0] * 15], DriveText.TOO_FAR_APART, 0.5),
    ],
    ids=["one", "two", "bunches", "too far apart"],
)
@driven()
async def test_box_says_why_key_does_not_count(
    app: ConsoleApp, pilot: Pilot[None], clock: Clock, arrivals: list[float], words: Any, seconds: float | None
) -> None:
    app.input_gate.pulse = Pulse({"TMUX": "1"})
    await arrive(app, clock, *arrivals)
    await shown(pilot, words, **({} if seconds is None else {"seconds": seconds}))
    assert not sent(app)


# -- limits

LIMITED = replace(ARMED, limits=VelocityLimits(0.1, 0.3), limited_by=("robot.yaml:14",))


@driven(LIMITED)
async def test_speed_is_within_limits_whose_line_is_shown(app: ConsoleApp, pilot: Pilot[None], clock: Clock) -> None:
    """The bridge reduces what is beyond limits that this console does not know yet."""
    await shown(pilot, DriveText.LIMITED, limits=VelocityLimits(0.1, 0.3), lines="robot.yaml:14")
    await pressed(pilot, clock, "o")
    await until(pilot, lambda: sent(app), "a command")
    assert velocities(app)[0] == velocity(TWIST, 0.1, -0.3)
    await pressed_until_shown(app, pilot, clock, "o", "+0.10")
    assert all(each.reduce for each in sent(app))
    await pressed(pilot, clock, "minus", "minus", "minus", "minus", "minus", "space")
    await rests(app, pilot, clock)
    await pressed(pilot, clock, "i")
    await until(pilot, lambda: velocity(TWIST, SPEED / 1.25**5, 0.0) in velocities(app), "a slower command")


def test_smallest_limits_of_all_robots_on_topic_count() -> None:
    slow = replace(ARMED, key="2", link="robot2", limits=VelocityLimits(0.05), limited_by=("pc.yaml:3",))
    elsewhere = replace(LIMITED, key="3", topic="/other", limits=VelocityLimits(0.01), limited_by=("pc.yaml:9",))
    snapshot = replace(PublishingEngine(SESSION).snapshot(), routes=(LIMITED, slow, elsewhere))
    assert limits_on(LIMITED, snapshot) == (VelocityLimits(0.05, 0.3), ["robot.yaml:14", "pc.yaml:3"])

"""Keys that come late: the terminal's pulse, and screens that take young keys only."""

from __future__ import annotations

import asyncio
import re
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import choose, engine_of, notified, on_main, put, scripted_app, shown, until
from tests.console.late_input_helpers import Time
from tests.console.scripted import LINK, route
from tests.support.waiting import eventually
from textual import events

from rsb_bridge.model.commands import Effect
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, State
from rsb_bridge.model.verdict import LinkCause
from rsb_console.operations.topic_operations import OperationText
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.screens.links_screen import LinkText
from rsb_console.screens.take_over import HandOverScreen
from rsb_console.terminal.driver import ConsoleDriver, KeyParser
from rsb_console.terminal.input_queue import SEEN_AFTER, GuardedScreen, InputGate, LateInput, is_guarded
from rsb_console.terminal.pulse import (
    ANSWERS_WITHIN,
    ASKED_EVERY,
    FRESH_FOR,
    WHO_ARE_YOU,
    Pulse,
    heard_before,
    without_answers,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from textual.geometry import Region
    from textual.message import Message
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


Place = tuple[int, int]
"""Row and column."""


def place_in(question: str) -> Place:
    found = re.fullmatch(r"\x1b7\x1b\[(\d+);(\d+)H\x1b\[6n\x1b8", question)
    assert found is not None
    return int(found[1]), int(found[2])


class Line:
    """A terminal at the other end of a line that may hang. What it sends arrives in order.

    Args:
        size: lines and columns. For a place beyond, the terminal takes its last line or column.

    Attributes:
        hangs: whether nothing passes in either direction.
    """

    def __init__(
        self,
        clock: Time,
        environ: dict[str, str] | None = None,
        *,
        latency: float = 0.0,
        size: tuple[int, int] = (24, 80),
    ) -> None:
        self.clock, self.latency = clock, latency
        self.pulse = Pulse(environ or {}, clock)
        self.hangs = False
        self._size = size
        self._to_terminal: list[tuple[float, Place]] = []
        self._to_console: list[tuple[float, Place | Message]] = []
        self.keys: list[events.Key] = []

    def ask(self) -> None:
        if question := self.pulse.question():
            row, column = place_in(question)
            place = min(row, self._size[0]), min(column, self._size[1])
            self._to_terminal.append((self.clock() + self.latency / 2, place))

    def press(self, key: str = "up") -> None:
        self._to_console.append((self.clock() + self.latency / 2, events.Key(key, None)))

    def go_on(self, seconds: float) -> None:
        """Let time pass, in which the console asks."""
        until_, asked = self.clock.now + seconds, self.clock.now
        while self.clock.now < until_:
            self.clock.now += 0.01
            if self.clock.now - asked >= ASKED_EVERY:
                self.ask()
                asked = self.clock.now
            self.deliver()

    def deliver(self) -> None:
        if self.hangs:
            return
        now = self.clock()
        for due, place in [each for each in self._to_terminal if each[0] <= now]:
            self._to_terminal.remove((due, place))
            self._to_console.append((now + self.latency / 2, place))
        while self._to_console and self._to_console[0][0] <= now:
            _, what = self._to_console.pop(0)
            if isinstance(what, tuple):
                self.pulse.answered(*what)
            else:
                self.pulse.stamp(what)
                assert isinstance(what, events.Key)
                self.keys.append(what)

    def fresh(self) -> list[bool]:
        return [self.clock() - heard_before(each) < FRESH_FOR for each in self.keys]


@pytest.mark.parametrize("latency", [0.0, 0.3, 0.7])
def test_a_key_counts_while_the_terminal_answers(latency: float) -> None:
    line = Line(Time(), latency=latency)
    line.go_on(3.0)
    for _ in range(10):
        line.press()
        line.go_on(latency / 2 + 0.02)
        assert line.fresh()[-1]
        line.go_on(0.3)


def test_keys_of_a_small_terminal_count() -> None:
    line = Line(Time(), size=(6, 20))
    line.go_on(20.0)  # as many questions as there are places, and more
    for _ in range(60):
        line.press()
        line.go_on(0.3)
        assert line.fresh()[-1]


@pytest.mark.parametrize("latency", [0.0, 0.3])
@pytest.mark.parametrize("hang", [1.3, 8.0, 40.0])
@pytest.mark.parametrize("keys", [1, 3, 9])
def test_late_keys_of_hung_line_do_not_count(latency: float, hang: float, keys: int) -> None:
    clock = Time()
    line = Line(clock, latency=latency)
    line.go_on(3.0)
    line.hangs = True
    line.go_on(0.1)
    for _ in range(keys):
        line.press()
    line.go_on(hang)
    line.hangs = False
    line.deliver()
    assert line.fresh() == [False] * keys
    line.go_on(3.0)
    line.keys.clear()
    line.press()
    line.go_on(latency / 2 + 0.02)
    assert line.fresh() == [True]


def test_console_that_stood_still_finds_its_keys_old() -> None:
    clock = Time()
    line = Line(clock)
    line.go_on(1.0)
    line.ask()
    line.deliver()
    line.press()
    clock.now += 8.0
    line.deliver()
    assert line.fresh() == [False]


def test_a_lost_answer_makes_no_other_one_older() -> None:
    clock = Time()
    pulse = Pulse({}, clock)
    places = [place_in(pulse.question()) for _ in range(3)]
    clock.now += 0.1
    pulse.answered(*places[2])
    assert pulse.heard == 100.0
    asked, place = clock.now, place_in(pulse.question())
    clock.now += 0.1
    pulse.answered(*place)
    assert pulse.heard == asked
    pulse.answered(*places[0])
    pulse.answered(1, 7)
    assert pulse.heard == asked


def test_a_terminal_that_hangs_gets_few_questions() -> None:
    clock = Time()
    pulse = Pulse({}, clock)
    count = 0
    for _ in range(100):
        clock.now += ASKED_EVERY
        count += bool(pulse.question())
    assert count == 8
    clock.now += 10
    assert pulse.question()


@pytest.mark.parametrize(
    ("kind", "relayed"),
    [("84;0;0", True), ("83;40900;0", True), ("1;10;0", True), ("41;390;0", False), ("65;6800;1", False)],
)
def test_a_multiplexer_is_known_by_its_kind(kind: str, relayed: bool) -> None:
    pulse = Pulse({})
    pulse.answered(*place_in(pulse.question()))
    pulse.take_kind(kind)
    assert pulse.relayed is relayed


@pytest.mark.parametrize("name", ["TMUX", "STY", "ZELLIJ"])
def test_a_multiplexer_is_known_by_its_variable(name: str) -> None:
    pulse = Pulse({name: "1"})
    assert pulse.relayed
    pulse.answered(*place_in(pulse.question()))
    pulse.take_kind(XTERM)
    assert pulse.relayed


# -- another terminal, as where dtach is attached anew

XTERM, MOSH = "41;390;0", "1;10;0"


def answering(kind: str = XTERM, latency: float = 0.0) -> Line:
    """Return a line whose terminal has answered, with its kind if it tells one."""
    line = Line(Time(), latency=latency)
    line.pulse.doubt()
    if kind:
        line.pulse.take_kind(kind)
    line.go_on(3.0)
    assert line.pulse.asks_kind is bool(kind)
    return line


def test_newest_kind_counts() -> None:
    line = answering()
    for kind, relayed in ((MOSH, True), (XTERM, False), (MOSH, True)):
        line.pulse.take_kind(kind)
        assert line.pulse.relayed is relayed


@pytest.mark.parametrize("latency", [0.0, 0.3])
def test_no_key_counts_until_another_terminal_answers(latency: float) -> None:
    line = answering(latency=latency)
    line.ask()
    line.clock.now += 0.001
    line.pulse.doubt()
    assert line.pulse.is_doubted
    line.press()
    line.go_on(latency / 2 + 0.02)  # to the question before the doubt, an answer comes, which proves nothing
    assert line.fresh() == [False]
    line.go_on(ASKED_EVERY + latency)
    assert not line.pulse.is_doubted
    line.press()
    line.go_on(latency / 2 + 0.02)
    assert line.fresh() == [False, True]


def test_doubted_terminal_is_asked_though_questions_wait() -> None:
    line = answering()
    line.hangs = True
    line.go_on(14.0)
    assert not line.pulse.question()
    line.pulse.doubt()
    assert line.pulse.question()
    for _ in range(100):
        line.pulse.doubt()
        line.pulse.question()
    assert not line.pulse.question()  # a late answer could be taken for one to a newer question at its place


def test_terminal_without_kind_is_asked_again_after_gap() -> None:
    line = answering("")
    line.hangs = True
    line.go_on(FRESH_FOR + 2 * ASKED_EVERY)
    assert line.pulse.asks_kind


def test_sooner_answer_may_be_a_multiplexers() -> None:
    line = answering("", latency=0.2)
    line.latency = 0.02
    line.go_on(ASKED_EVERY + 0.05)
    assert line.pulse.is_doubted
    assert line.pulse.asks_kind
    line.go_on(ASKED_EVERY + 0.05)
    assert not line.pulse.is_doubted


def test_several_terminals_prove_nothing() -> None:
    line = answering()
    place = place_in(line.pulse.question())
    line.pulse.answered(*place)
    assert not line.pulse.relayed
    line.pulse.answered(*place)
    assert line.pulse.relayed
    line.go_on(10.0)
    assert not line.pulse.relayed


def test_mute_terminal_is_not_doubted() -> None:
    clock = Time()
    pulse = Pulse({}, clock)
    clock.now += ANSWERS_WITHIN + 0.1
    pulse.doubt()
    assert pulse.relayed
    assert not pulse.is_doubted
    assert pulse.heard_now == float("inf")


def test_terminal_that_never_answers_is_as_multiplexer() -> None:
    clock = Time()
    pulse = Pulse({}, clock)
    pulse.question()
    key = events.Key("up", None)
    pulse.stamp(key)
    assert clock() - heard_before(key) >= FRESH_FOR
    assert not pulse.relayed
    clock.now += ANSWERS_WITHIN + 0.1
    assert pulse.relayed
    pulse.stamp(key)
    assert clock() - heard_before(key) < FRESH_FOR


def test_answers_in_a_paste_are_taken_out() -> None:
    assert without_answers("a: 1\x1b[>41;390;0c\x1b[3;4R\nb: 2") == "a: 1\nb: 2"


@on_main()
async def test_a_paste_answers_no_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """It may contain reports of every place, which would make itself and late keys look young."""
    driver = ConsoleDriver(app)
    row, column = place_in(driver.pulse.question())
    paste = events.Paste(f"y\x1b[{row};{column}R")
    driver.process_message(paste)
    assert paste.text == "y"
    assert driver.pulse.heard == heard_before(paste) == float("-inf")


def test_the_kind_of_a_terminal_is_no_key() -> None:
    assert WHO_ARE_YOU == "\x1b[>c"
    parser = KeyParser()
    keys = [each.key for each in parser.feed("a\x1b[>84;0;0cb") if isinstance(each, events.Key)]
    assert (keys[0], keys[2], len(keys)) == ("a", "b", 3)
    assert keys[1].startswith("<")


def test_keys_that_come_at_once_have_one_time() -> None:
    parser = KeyParser()
    times = []
    for message in parser.feed("iii"):
        times.append(message.time)
        time.sleep(0.03)  # the thread that reads them stands still
    assert len(times) == 3
    assert len(set(times)) == 1


@pytest.mark.parametrize(("trip", "asked"), [(0.01, 20), (0.2, 20), (0.3, 40), (0.7, 40)])
def test_keys_at_rest_are_young_with_fewer_questions(trip: float, asked: int) -> None:
    """As fewer as a line with its round trip allows."""
    clock = Time()
    pulse, answers, count = Pulse({}, clock), list[tuple[float, Place]](), 0
    for tick in range(240):
        clock.now += ASKED_EVERY / 5
        while answers and answers[0][0] <= clock.now:
            pulse.answered(*answers.pop(0)[1])
        if tick % 5 == 0 and pulse.is_due(at_rest=True):
            answers.append((clock.now + trip, place_in(pulse.question())))
            count += tick >= 40
        assert tick < 40 or clock() - pulse.heard < FRESH_FOR
    assert count == asked


@on_main()
async def test_terminal_attached_by_dtach_is_doubted(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """It types Ctrl-L. What comes after it is another terminal's, and may be old."""
    driver = ConsoleDriver(app)
    driver.pulse.answered(*place_in(driver.pulse.question()))
    before, redraw, after = (events.Key(name, None) for name in ("i", "ctrl+l", "i"))
    for each in (before, redraw, after):
        driver.process_message(each)
    assert heard_before(before) > float("-inf")
    assert heard_before(after) == float("-inf")


# -- screens


def gate_of(clock: Time, environ: dict[str, str] | None = None, *, answers: bool = True) -> InputGate:
    app = scripted_app()
    app.notify = lambda *_, **__: None  # type: ignore[method-assign]
    gate = InputGate(app, clock)
    gate.pulse = pulse = Pulse(environ or {}, clock)
    if answers:
        pulse.answered(*place_in(pulse.question()))
    return gate


def key(name: str, heard: float, came_at: float = float("inf")) -> events.Key:
    """Return a key that came long after anything was drawn, or at a time."""
    event = events.Key(name, None)
    event.time = came_at
    vars(event)["heard"] = heard
    return event


def test_guarded_screen_takes_young_and_safe_keys() -> None:
    clock = Time()
    gate, screen = gate_of(clock), ConfirmScreen("Arm?", "", "Arm", Effect.MOVES)
    assert gate.refuses(key("y", 99.9), screen)  # not drawn
    assert not gate.refuses(key("n", 0.0), screen)
    screen.drawn_at = 100.0
    clock.now = 100.0 + SEEN_AFTER - 0.1
    assert gate.refuses(key("y", clock.now, clock.now), screen)
    clock.now = 100.0 + SEEN_AFTER
    assert gate.refuses(key("y", clock.now, clock.now - 0.1), screen)  # handled later than it came
    assert not gate.refuses(key("y", clock.now, clock.now), screen)
    assert gate.refuses(key("y", 99.9), screen)  # pressed before the terminal had the picture, for all we know
    assert not gate.refuses(key("y", 100.2), screen)
    clock.now = 103.0
    assert gate.refuses(key("y", 101.9), screen)
    assert not gate.refuses(key("y", 102.1), screen)
    assert gate.refuses(events.Paste("y"), screen) is False  # from no terminal
    paste = events.Paste("y")
    vars(paste)["heard"] = 101.9
    assert gate.refuses(paste, screen)
    for harmless in (GuardedScreen.__mro__[1](), ConfirmScreen("Attach?", "", "Attach", Effect.HARMLESS)):
        assert not gate.refuses(key("y", 0.0), harmless)


class Seen:
    """What a terminal has of the screen."""

    def __init__(self, late: float) -> None:
        self.late, self.shown = late, False

    def has(self, region: Region) -> bool:
        return self.shown


def test_no_key_moves_anything_while_what_is_seen_is_late_and_unproven() -> None:
    """A terminal that answers proves both; where nothing does, what waits for the line is all that is known."""
    clock = Time()
    gate, screen = gate_of(clock), ConfirmScreen("Arm?", "", "Arm", Effect.MOVES)
    screen.drawn_at, clock.now = 99.0, 101.0
    gate.sight = seen = Seen(SEEN_AFTER + 0.1)
    assert not gate.refuses(key("y", clock.now, clock.now), screen)  # after an answer
    assert gate.refuses(key("y", float("inf"), clock.now), screen)
    assert not gate.refuses(key("n", float("inf"), clock.now), screen)  # which is safe
    seen.late = 0.1
    assert not gate.refuses(key("y", float("inf"), clock.now), screen)


@on_main()
async def test_question_counts_as_seen_once_terminal_has_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    clock = Time()
    app.input_gate.pulse = Pulse({}, clock)
    app.input_gate.sight = seen = Seen(0.0)
    question = ConfirmScreen("Move the arm?", "It moves.", "Move", Effect.MOVES)
    app.push_screen(question)
    await shown(pilot, "Move the arm?")
    await pilot.pause(0.3)
    assert question.drawn_at is None
    seen.shown = True
    await until(pilot, lambda: question.drawn_at is not None, "drawn")


@on_main()
async def test_pictures_of_question_say_when_its_keys_count(app: ConsoleApp, pilot: Pilot[None]) -> None:
    clock = Time()
    app.input_gate.pulse = Pulse({}, clock)
    clock.now += ANSWERS_WITHIN + 0.1  # it gives none
    answers: list[Any] = []
    question = ConfirmScreen("Move the arm?", "It moves.", "Move", Effect.MOVES)
    question.seen_after = 60.0
    app.push_screen(question, answers.append)
    await until(pilot, lambda: question.drawn_at is not None, "drawn")
    await pilot.press("y", "tab", "enter")
    await asyncio.sleep(0)
    assert app.screen is question
    await shown(pilot, "…")
    question.seen_after = 0.0
    await shown(pilot, "y yes")
    await pilot.press("y")
    await until(pilot, lambda: answers == [True], "the answer")


def test_operator_is_told_that_terminal_may_be_another() -> None:
    told: list[str] = []
    app, clock = scripted_app(), Time()
    app.notify = lambda text, **_: told.append(text)  # type: ignore[method-assign]
    gate = InputGate(app, clock)
    gate.pulse = pulse = Pulse({}, clock)
    pulse.doubt()
    pressed = events.Key("y", None)
    pulse.stamp(pressed)
    assert gate.refuses(pressed, ConfirmScreen("Arm?", "", "Arm", Effect.MOVES))
    assert told == [LateInput.MAY_BE_ANOTHER()]


def test_harmless_question_can_be_answered_over_slow_line() -> None:
    clock = Time()
    gate, screen = gate_of(clock), ConfirmScreen("Quit?", "", "Quit", Effect.LOSES)
    screen.drawn_at = clock.now
    clock.now += 3.0
    assert gate.refuses(key("y", screen.drawn_at - 0.1), screen)
    assert not gate.refuses(key("y", screen.drawn_at + 0.1), screen)


def test_question_that_opens_itself_waits_for_typing() -> None:
    clock = Time()
    gate, screen = gate_of(clock), ConfirmScreen("Give it?", "", "Give", Effect.MOVES)
    screen.opens_itself, screen.drawn_at = True, clock.now
    for _ in range(10):
        clock.now += 0.2
        assert gate.refuses(key("y", clock.now, clock.now), screen)
    clock.now += SEEN_AFTER
    assert not gate.refuses(key("y", clock.now, clock.now), screen)


@pytest.mark.parametrize("environ", [{"TMUX": "1"}, {}], ids=["tmux", "no answers"])
def test_a_late_answer_behind_a_multiplexer_does_nothing(environ: dict[str, str]) -> None:
    """Nothing tells its age, but the question has been open for long."""
    clock = Time()
    gate, screen = gate_of(clock, environ, answers=bool(environ)), ConfirmScreen("Arm?", "", "Arm", Effect.MOVES)
    clock.now += ANSWERS_WITHIN + 0.1
    screen.drawn_at = clock.now
    clock.now += 8.0
    assert gate.waits_for_key(screen)
    for _ in range(3):
        assert gate.refuses(key("y", clock.now, clock.now), screen)
        assert not gate.takes_keys(screen)
    clock.now += SEEN_AFTER
    assert not gate.waits_for_key(screen)
    assert not gate.refuses(key("y", clock.now, clock.now), screen)


def test_answer_that_proves_its_age_may_be_late() -> None:
    clock = Time()
    gate, screen = gate_of(clock), ConfirmScreen("Arm?", "", "Arm", Effect.MOVES)
    screen.drawn_at = clock.now
    clock.now += 60.0
    assert not gate.refuses(key("y", clock.now, clock.now), screen)


def test_list_that_slid_after_key_came_refuses_it() -> None:
    clock = Time()
    gate = gate_of(clock)
    gate.refuses(key("p", clock.now, clock.now), GuardedScreen.__mro__[1]())
    clock.now += 2 * SEEN_AFTER
    assert not gate.was_seen(clock.now - 1.5 * SEEN_AFTER)
    assert gate.was_seen(100.0 - SEEN_AFTER)


@pytest.mark.parametrize("name", ["n", "escape"])
def test_typing_as_somebody_asks_decides_nothing(name: str) -> None:
    question = HandOverScreen(scripted_app(), route("/cmd_vel", arming=ArmingSnapshot(armed=True, asked_by="bert")))
    assert gate_of(Time()).refuses(key(name, 0.0), question)


@pytest.mark.parametrize("asks", ["q", "R", "f6", "d"])
@on_main()
async def test_questions_with_an_effect_take_no_late_keys(app: ConsoleApp, pilot: Pilot[None], asks: str) -> None:
    await pilot.press(asks)
    await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
    assert is_guarded(app.screen)


# -- resuming


def test_gate_knows_whether_newest_input_is_young() -> None:
    clock = Time()
    gate = gate_of(clock, answers=False)
    screen = GuardedScreen.__mro__[1]()
    gate.refuses(key("p", clock.now - FRESH_FOR), screen)
    assert not gate.is_young
    gate.refuses(events.Key("p", None), screen)  # from no terminal: what sets it off is the input before it
    assert not gate.is_young
    gate.refuses(key("p", clock.now), screen)
    assert gate.is_young
    clock.now += ANSWERS_WITHIN + 0.1  # it gives no answers, which proves nothing
    gate.refuses(key("p", float("inf")), screen)
    assert not gate.is_young


def with_terminal(app: ConsoleApp, *, young: bool) -> None:
    """Let an operator who has read the list press the next key."""
    app.input_gate.pulse = Pulse({}, Time())
    app.input_gate.is_young = young
    app.main.topics.slid_at -= SEEN_AFTER


async def resume(app: ConsoleApp, pilot: Pilot[None], *, young: bool) -> None:
    put(app, route("/cmd_vel", State.PAUSED, spec=Topic("/cmd_vel", "receive", paused=True)))
    await shown(pilot, "PAUSED   /cmd_vel")
    assert app.needs_young_keys
    with_terminal(app, young=young)
    await pilot.press("p")


@on_main()
async def test_a_young_key_resumes_at_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await resume(app, pilot, young=True)
    await until(pilot, lambda: engine_of(app).commands == [("pause", "/cmd_vel", False)], "resumed")


@on_main()
async def test_a_late_key_resumes_nothing_without_a_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await resume(app, pilot, young=False)
    await shown(pilot, "Resume /cmd_vel?")
    assert engine_of(app).commands == []
    app.input_gate.pulse = None
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).commands == [("pause", "/cmd_vel", False)], "resumed")


@on_main()
async def test_late_key_lets_nobody_back_in_without_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, state=State.DOWN, cause=LinkCause.SHUT_DOWN),))
    assert app.needs_young_keys
    app.input_gate.is_young = False
    await pilot.press("r")
    await shown(pilot, LinkText.BACK, links=LINK.name)
    await pilot.press("n", "c", "r")
    await shown(pilot, LinkText.BACK, links=LINK.name)
    assert engine_of(app).commands == []
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).commands == [("retry", LINK.name)], "the command")


@on_main()
async def test_late_key_in_form_resumes_nothing_without_question(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/cmd_vel", State.PAUSED, spec=Topic("/cmd_vel", "receive", paused=True)))
    await pilot.press("e")
    await choose(pilot, "paused", "")
    app.input_gate.is_young = False
    await pilot.press("enter")
    await shown(pilot, OperationText.RESUME, topic="/cmd_vel")
    await pilot.press("y")
    await until(pilot, lambda: [each[0] for each in engine_of(app).commands] == ["edit"], "the edit")


@on_main()
async def test_key_ignores_topic_that_slid_under_cursor(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/a"), route("/b"), route("/c", arming=ArmingSnapshot(armed=True)))
    await pilot.press("j", "k")
    app.input_gate.pulse = Pulse({}, Time())
    put(app, *engine_of(app).now.routes[1:])
    await pilot.press("p")
    await notified(pilot, LateInput.LIST_MOVED)
    assert engine_of(app).commands == []
    app.main.topics.slid_at -= SEEN_AFTER
    await pilot.press("p")
    await until(pilot, lambda: engine_of(app).commands == [("pause", "/b", True)], "paused")
    put(app, *engine_of(app).now.routes[1:])
    await pilot.press("A")  # what stops a robot always counts
    await until(pilot, lambda: engine_of(app).commands[1:] == [("disarm", "/c")], "disarmed")


@on_main()
async def test_a_late_key_pauses_at_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/cmd_vel"))
    await shown(pilot, "/cmd_vel")
    with_terminal(app, young=False)
    await pilot.press("p")
    await until(pilot, lambda: engine_of(app).commands == [("pause", "/cmd_vel", True)], "paused")


def _keys(messages: Iterable[Message]) -> list[str]:
    return [each.key for each in messages if isinstance(each, events.Key)]


def _escape_that_counts(parser: KeyParser) -> None:
    """An Escape whose sequence does not come in time: Textual takes it for a key."""
    assert _keys(parser.feed("\x1b")) == []
    eventually(lambda: _keys(parser.tick()) == ["escape"])


@pytest.mark.parametrize("rest", ["[A", "[D", "OA", "[1;5D", "[15~", "[<0;12;30M"])
def test_rest_of_a_torn_sequence_is_no_key(rest: str) -> None:
    """Its letter would arm, disarm or open the drive screen. What comes behind the answer was typed after it."""
    clock = Time()
    pulse = Pulse({}, clock)
    pulse.answered(*place_in(pulse.question()))
    clock.now = time.monotonic()
    before = place_in(pulse.question())
    parser = KeyParser(pulse)
    _escape_that_counts(parser)
    pulse.answered(*before)  # of a question before the Escape, which proves nothing
    assert _keys(parser.feed(rest[:1])) == []
    assert _keys(parser.feed(rest[1:])) == []
    assert _keys(parser.feed("a")) == ["a"]
    _escape_that_counts(parser)
    clock.now = time.monotonic()
    pulse.answered(*place_in(pulse.question()))
    assert _keys(parser.feed("OA")) == ["O", "A"]


def test_sequence_torn_behind_its_bracket_is_no_key() -> None:
    clock = Time()
    clock.now = time.monotonic()
    pulse = Pulse({}, clock)
    pulse.answered(*place_in(pulse.question()))
    parser = KeyParser(pulse)
    assert _keys(parser.feed("\x1bO")) == []
    eventually(lambda: _keys(parser.tick()))
    assert _keys(parser.feed("D")) == []
    assert _keys(parser.feed("D")) == ["D"]
    assert _keys(parser.feed("\x1bOP\x1b[D")) == ["f1", "left"]


@pytest.mark.parametrize("environ", [{"TMUX": "a"}, {}], ids=["multiplexer", "not asked"])
def test_rest_of_a_torn_sequence_without_proof(environ: dict[str, str]) -> None:
    """The answers prove nothing, or there are none: time has to pass."""
    clock = Time()
    clock.now = time.monotonic()
    parser = KeyParser(Pulse(environ, clock))
    _escape_that_counts(parser)
    assert _keys(parser.feed("[D")) == []
    _escape_that_counts(parser)
    clock.now = time.monotonic() + FRESH_FOR + 0.1
    assert _keys(parser.feed("[D")) == ["left_square_bracket", "D"]

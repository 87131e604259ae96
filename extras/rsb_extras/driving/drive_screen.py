"""Drives a robot by keys, over a topic that has to be armed and whose old messages are dropped.

A key counts for a while (`Steering`), and the engine ends a motion by itself if no further command comes
(`Publish.rest`). So the robot stops if the operator lets the key go, if the terminal or the console hangs, or if the
way to the bridge does. Keys that come late never arrive here (`GuardedScreen`), unless a terminal multiplexer hides
that they are late: then `Steering` asks for the rhythm of a key that a hand holds.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from itertools import chain
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.content import Content
from textual.geometry import Spacing
from textual.widgets import Static

from rsb_bridge.feature_api import Effect, EngineError, Wording, escape_text, join_first
from rsb_bridge.model.audience import NOBODY
from rsb_bridge.model.by_hand import smallest_limits
from rsb_console.feature_console import DIALOG, ConfirmScreen, GuardedScreen, SideBox
from rsb_console.notation.formats import PatternRow, RowText, driver_name, driver_rate, full_type
from rsb_console.screens.dialog import ArmScreen
from rsb_console.screens.take_over import AskHolderScreen
from rsb_console.terminal.input_queue import SEEN_AFTER, InputGate
from rsb_extras.driving.landing import ByHandText, Landing, hearing
from rsb_extras.driving.picture_lock import PICTURE_AGE, PictureLock
from rsb_extras.driving.publish_requests import DraftMessage, Publish
from rsb_extras.driving.steering import APART_AT_MOST, STOPS, WAYS, Steering

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Future

    from textual.app import ComposeResult
    from textual.events import Key
    from textual.geometry import Size

    from rsb_bridge.feature_api import EngineApi, RouteSnapshot, Snapshot
    from rsb_bridge.model.by_hand import VelocityLimits
    from rsb_console.feature_console import CameraSight, Console, MainScreen

TWIST, TWIST_STAMPED = (f"geometry_msgs/msg/{name}" for name in ("Twist", "TwistStamped"))
_RATE = 10.0
"""Hz of commands while the robot moves."""
_RESTS_AFTER = 0.5
"""s without a command after which the bridge stops the robot."""
_TICKETS = 3
"""Tickets in a row that were too old when they came back."""
_FASTER = 1.25  # times, at a key: 21 of them lead from the least speed to the most
_LANDING_LASTS = 10.0
"""s without a report after which the count of landed messages starts again at 0."""
_WIDE, _BOX = 120, 44
"""Columns of a screen from which on the box stands at the side, and its own there."""
_NAMED = 4
"""Robots in one line."""
_ARROWS = "arrows"
_WAYS_SHOWN = f"{_ARROWS} uiojlm,."
_WAYS_BOX = ("u i o     ↖ ↑ ↗", "j k l     ← ■ →", "m , .     ↙ ↓ ↘")
"""The letters as they lie on the keyboard, and the way of each; where there is room."""
_KEYS = ("space stop", "+- speed", "A arm", "esc leave")


class DriveText(Wording):
    """Texts of the screen."""

    NO_KEY = "no key is held"
    HOLD = "hold the key: it does not count yet"
    LET_GO = "these keys may be old: let go, then hold one key"
    BUNCHES = "your line bunches keys, each {seconds:.2f} s: hold the key until it moves"
    TOO_FAR_APART = (
        "your line bunches keys, each {seconds:.1f} s: that is too late to drive; use a line with less delay"
    )
    LIMITED = "at most {limits}: {lines}"
    DISARMED = "disarmed: press A to arm it{reason}"
    ARMED = "armed{left}"
    ARMED_BY = "armed by {who}, whose messages pass alone; A asks for it, or disarms it"
    ASKED = "asked {who} for it: without an answer it goes over in {seconds:.0f} s"
    ASKS = "{who} asks for it: y gives it, n keeps it; without an answer it goes over in {seconds:.0f} s"
    LEFT = ", for {seconds:.0f} s without a key"
    NOT_WHILE_DISARMED = "keys do nothing while it is disarmed"
    NOT_WHILE_DETACHED = "keys do nothing while this console is not attached"
    DETACHED = "not attached, so what it has armed disarms by itself: {reason}"
    MOVED = "moves {robots}{round_trip}"
    HERE = "here: {hearing}"
    IN_HAND = "{link} now: {motion}"
    MOVING = "moving {forward:.2f} m/s{turning}"
    TURNING = ", turning {turn:.2f} rad/s"
    RESTS = "rest"
    ALSO = "{who} also drives, {rate} Hz"
    BESIDE = "{who} publishes it at {link}, too"
    BESIDE_HERE = "{who} publishes it here, too"
    SEVERAL = "Drive {count} robots by {topic}?"
    GONE = "it is no longer bridged"
    TYPE_UNKNOWN = "{topic} cannot be driven: its type is unknown; set type: Twist (e)"
    OTHER_TYPE = "{topic} cannot be driven: its type is {type_name}, not Twist or TwistStamped"
    NONE_HERE = "no topic can be driven: that needs a Twist that goes to the robot of the picture, with arm: true"
    SEVERAL_HERE = "several topics can be driven: choose one in the list of topics, and press its key there"
    NOT_DRIVEN = "{topic} cannot be driven: set arm: true on the topic first (e), and leave max_age as it is"


def velocity(type_name: str, forward: float, turn: float) -> str:
    """Return a velocity as the fields of a Twist or a TwistStamped, in YAML.

    Args:
        turn: rad/s, counterclockwise.
    """
    twist = f"linear: {{x: {forward:.3f}}}, angular: {{z: {turn:.3f}}}"
    return f"{{header: auto, twist: {{{twist}}}}}" if type_name == TWIST_STAMPED else f"{{{twist}}}"


def why_not_driven(route: RouteSnapshot, type_name: str = "") -> str:
    """Return the reason why a topic cannot be driven, or an empty string.

    Args:
        type_name: the type, if the route does not know it.
    """
    type_name = full_type(route) or type_name
    if not type_name:
        return DriveText.TYPE_UNKNOWN(topic=route.topic)
    if type_name not in (TWIST, TWIST_STAMPED):
        return DriveText.OTHER_TYPE(topic=route.topic, type_name=type_name)
    if route.arming is None or not route.max_age:
        return DriveText.NOT_DRIVEN(topic=route.topic)
    return ""


def moved_by(route: RouteSnapshot, snapshot: Snapshot) -> list[str]:
    """Return the robots that messages on a route's topic move, by the names of their links."""
    if route.calls is not None or not route.outgoing:
        return [route.link]
    return sorted({each.link for each in snapshot.routes if each.outgoing and each.topic == route.topic} | {route.link})


def _routes_to(route: RouteSnapshot, snapshot: Snapshot) -> list[RouteSnapshot]:
    """Return the routes to all robots that messages on a route's topic move."""
    links, way = moved_by(route, snapshot), (route.topic, route.outgoing)
    return [each for each in snapshot.routes if (each.topic, each.outgoing) == way and each.link in links]


def in_hand(route: RouteSnapshot, snapshot: Snapshot) -> str:
    """Return what robots on a route's topic were given last, as their sides report it, or an empty string."""
    found = []
    for each in _routes_to(route, snapshot):
        if each.arming is not None and (velocity := each.arming.velocity) is not None:
            forward, turn = velocity
            turning = DriveText.TURNING(turn=turn) if turn else ""
            motion = DriveText.MOVING(forward=forward, turning=turning) if any(velocity) else DriveText.RESTS()
            found.append(DriveText.IN_HAND(link=each.link, motion=motion))
    return join_first(found, _NAMED)


def also_driving(route: RouteSnapshot, snapshot: Snapshot, *, holds: bool) -> str:
    """Return who else moves robots on a route's topic, and how often, or an empty string.

    Args:
        holds: whether this console holds the topic, so that the messages by hand are its own.
    """
    found: dict[str, float] = {}
    beside: dict[str, None] = {}
    for each in _routes_to(route, snapshot):
        holder = "" if each.arming is None else each.arming.by
        for driver in each.drivers:
            who = (holder if driver.by_hand else "") or driver_name(driver)
            if driver.rate and not (holds and driver.by_hand and driver.here):
                found[who] = max(found.get(who, 0.0), driver.rate)
            elif driver.rate is None and not driver.by_hand and driver.here != route.outgoing:
                text = DriveText.BESIDE_HERE if driver.here else DriveText.BESIDE
                beside[text(who=who, link=each.link)] = None
    also = [DriveText.ALSO(who=who, rate=driver_rate(rate)) for who, rate in sorted(found.items())]
    return "; ".join([*also, *beside][:_NAMED])


def limits_on(route: RouteSnapshot, snapshot: Snapshot) -> tuple[VelocityLimits | None, list[str]]:
    """Return the limits of messages by hand for all robots on a route's topic, and the lines that set them."""
    routes = [each for each in snapshot.routes if each.topic == route.topic and each.calls is None]
    limits = smallest_limits(each.limits for each in routes)
    found = (each.limited_by for each in routes if limits and each.limits and each.limits.are_in(limits))
    return limits, list(dict.fromkeys(chain.from_iterable(found)))


def suits(route: RouteSnapshot) -> bool:
    """Whether a topic may be driven. If nobody has published on it yet, `drive` asks for its type."""
    return not why_not_driven(route, TWIST)


async def drive_selected(screen: MainScreen) -> None:
    """Drive on the topic under the cursor."""
    row, console = screen.topics.selected, screen.console
    if isinstance(row, PatternRow):
        console.notify(RowText.IS_PATTERN(topic=row.topic), markup=False, timeout=4)
    elif console.engine is not None and row is not None:
        await drive(console, row)


async def drive_one(
    console: Console, routes: Sequence[RouteSnapshot], sight: Callable[[], CameraSight | None] = lambda: None
) -> None:
    """Drive on the one topic of a robot's that can be driven, or the one of several that is armed."""
    driven = [each for each in routes if suits(each)]
    armed = [each for each in driven if each.arming is not None and each.arming.armed]
    if len(only := armed or driven) == 1:
        await drive(console, only[0], sight)
    else:
        text = DriveText.SEVERAL_HERE() if only else DriveText.NONE_HERE()
        console.notify(text, severity="warning", markup=False)


async def drive(console: Console, route: RouteSnapshot, sight: Callable[[], CameraSight | None] = lambda: None) -> None:
    """Open the screen on a topic that can be driven, after a question if that moves other robots, too.

    Only from a worker.

    Args:
        sight: as `PictureLock` takes it.
    """
    type_name = full_type(route)
    if not type_name and console.engine is not None:
        with contextlib.suppress(EngineError):  # then the reason names what is missing
            type_name = (await asyncio.wrap_future(console.engine.do(DraftMessage(route.topic)))).type_name
    if problem := why_not_driven(route, type_name):
        console.notify(problem, title="Not done", severity="warning", markup=False)
        return
    robots = moved_by(route, console.snapshot())
    if len(robots) > 1:
        title = DriveText.SEVERAL(topic=route.topic, count=len(robots))
        means = f"Its messages cross to {join_first(robots, _NAMED)}: all of them move that are armed."
        if not await console.ask(ConfirmScreen(title, means, "Drive", Effect.MOVES)):
            return
    lock = PictureLock(sight, PICTURE_AGE.of(console.preferences))
    await console.ask(DriveScreen(console, route, type_name, lock))


class DriveScreen(GuardedScreen, SideBox[None]):
    """Drives until it is closed. What is below stays in sight beside it: a camera's picture, for example."""

    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss", show=False),
        Binding("plus,equals_sign", f"speed({_FASTER})", show=False),
        Binding("minus", f"speed({1 / _FASTER})", show=False),
        Binding("A", "arm", show=False),
        Binding("y", "answer(True)", show=False),
        Binding("n", "answer(False)", show=False),
    ]
    CSS = """
    DriveScreen { align: center bottom; background: transparent; }
    DriveScreen.-wide { align: right top; }
    #drive {
        width: 100%; max-width: 110; height: auto; min-height: 5; padding: 0 1; border-subtitle-color: $quiet;
        &.-armed { border: heavy $warning; border-title-color: $warning; }
    }
    DriveScreen.-wide #drive { width: 44; height: 100%; padding: 1 1; }
    """
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (_WIDE, "-wide")]  # noqa: RUF012 -- Textual declares it without ClassVar
    # A disarms, or opens a question that is guarded; n keeps what this console holds.
    SAFE_KEYS = frozenset({*STOPS, "escape", "q", "A", "n", "ctrl+c"})

    def __init__(self, console: Console, route: RouteSnapshot, type_name: str, lock: PictureLock) -> None:
        super().__init__()
        self.console = console
        self._route = route
        self._type_name = type_name
        self._has_armed = False
        self._asking: Future[None] | None = None
        self._asker, self._asked_since = "", 0.0
        self._links: tuple[str, ...] = ()
        self._audience = NOBODY
        self._landing: Landing | None = None
        self._landed_at = 0.0
        self._reports = ""
        self._steering = Steering(self._is_relayed)
        self._lock = lock
        self._problem = ""
        self._held_by: tuple[str, bool] | None = None
        self._ticket = self._refusals = 0
        self._pane = Static(id="drive", classes="dialog", markup=False)

    def compose(self) -> ComposeResult:
        # Content is plain text: in a str, Textual reads brackets of a name as markup.
        self._pane.border_title = Content(f" Drive {escape_text(self._route.topic)} ")
        yield self._pane

    def room(self, size: Size) -> Spacing:
        if size.width >= _WIDE:
            return Spacing(0, _BOX, 0, 0)
        return Spacing(0, 0, self._pane.outer_size.height, 0)

    def on_mount(self) -> None:
        # Before the box is laid out: it would get another size later, and be sent twice.
        self.set_class(self.app.size.width >= _WIDE, "-wide")
        self._draw()
        self.set_interval(0.1, self._draw)
        self._drive()

    def _is_relayed(self) -> bool:
        pulse = InputGate.of(self.app).pulse
        return pulse is not None and pulse.relayed

    # -- commands -----------------------------------------------------------------------------------------------------

    @work
    async def _drive(self) -> None:
        """Send what the keys mean, and for some time after the last one that the robot is to stand."""
        sent_until = 0.0
        while True:
            began = time.monotonic()
            forward, turn = self._asked(began)
            moves = bool(forward or turn)
            if moves:
                sent_until = began + _RESTS_AFTER
            if began < sent_until:
                try:
                    if not await self._send(forward, turn):
                        continue  # the keys may mean something else by now
                    self._problem = ""
                except EngineError as error:
                    self._problem, sent_until, moves = str(error), 0.0, False
            self._lock.note_motion(began, moves=moves)
            await asyncio.sleep(max(0.0, began + 1 / _RATE - time.monotonic()))

    async def _send(self, forward: float, turn: float) -> bool:
        """Send a velocity. Return whether it was published: the first one needs a ticket.

        Raises:
            EngineError: the bridge refuses it, or answers too slowly.
        """
        engine, type_name = self.console.engine, self._type_name
        if engine is None:
            raise EngineError(ByHandText.NO_SESSION())
        published = await asyncio.wrap_future(
            engine.do(
                Publish(
                    self._route.topic,
                    velocity(type_name, forward, turn),
                    type_name,
                    ticket=self._ticket,
                    rest=velocity(type_name, 0.0, 0.0),
                    rest_after=_RESTS_AFTER,
                    reduce=True,
                )
            )
        )
        self._ticket, self._links, self._audience = published.ticket, published.links, published.audience
        if self._landing is None and published.is_done:
            self._landing, self._landed_at = Landing(self._route.topic, self.console.snapshot()), time.monotonic()
        self._refusals = 0 if published.is_done else self._refusals + 1
        if self._refusals > _TICKETS:
            self._refusals = 0
            raise EngineError(ByHandText.TOO_SLOW(topic=self._route.topic))
        return published.is_done

    # -- keys ---------------------------------------------------------------------------------------------------------

    def on_key(self, event: Key) -> None:
        """Take a key that drives or stops, which counts from the time when it came to this process."""
        if event.key in WAYS or event.key in STOPS:
            event.stop()
            self._steering.press(event.key, event.time)
            self._draw()

    def action_speed(self, factor: float) -> None:
        """Change the velocity of a key."""
        self._steering.change_speed(factor)
        self._draw()

    @work(group=DIALOG)
    async def action_arm(self) -> None:
        """Arm the topic after a question, or disarm it at once."""
        route, engine = self._current(), self.console.engine
        if engine is None or route is None or route.arming is None:
            return
        if route.arming.armed and not self._is_holder:
            await self._take_over(engine, route)
        elif route.arming.armed:
            await self.console.command(engine.disarm(route.key))
        elif await self.console.ask(ArmScreen(route)):
            # Before the command, so that a screen that is left meanwhile disarms.
            self._has_armed = True
            self.console.deadman.armed_on(self)
            # Closed while the question was open: nobody would see what moves.
            if not self.is_running:
                return
            if await self.console.command(engine.arm(route.key)):
                self._now_holds()

    async def _take_over(self, engine: EngineApi, route: RouteSnapshot) -> None:
        question = AskHolderScreen(self.console, route, may_take=engine.may_take)
        if not await self.console.ask(question) or not self.is_running:
            return
        if question.choice == "disarm":
            await self.console.command(engine.disarm(route.key))
            return
        gets = engine.take_arming if question.choice == "take" else engine.ask_holder
        if self._asking is None:
            self._get(gets(route.key))

    @work
    async def _get(self, asking: Future[None]) -> None:
        """Wait for the holder's answer, apart from the keys, which do not wait for it."""
        self._has_armed, self._asking = True, asking
        self.console.deadman.armed_on(self)
        if await self.console.command(asking):
            self._now_holds()
        self._asking = None

    def _now_holds(self) -> None:
        # The next answer to a sign of life has it, too; until then, A would ask for the topic that is armed here.
        self.console.deadman.held |= {self._route.key}

    def action_answer(self, gives: bool) -> None:
        """Answer an operator who asks for what this console holds, once the question was to be read."""
        engine, who, came_at = self.console.engine, self._asker, InputGate.of(self.app).came_at
        if engine is not None and who and came_at - self._asked_since > SEEN_AFTER:
            self._answer(engine.answer_asker(self._route.key, gives=gives, who=who))

    @work
    async def _answer(self, answering: Future[None]) -> None:
        await self.console.command(answering)

    def hands_over(self, key: str) -> bool:
        return key == self._route.key

    @property
    def _is_holder(self) -> bool:
        return self._route.key in self.console.deadman.held

    def on_unmount(self) -> None:
        """Disarm what this screen has armed, and ask no longer: nobody watches it any more."""
        if self._asking is not None:
            self._asking.cancel()
        engine = self.console.engine
        # Also if it is not shown as armed: it may be about to be. A topic that A has armed on the list stays armed.
        if self._has_armed and engine is not None:
            engine.disarm(self._route.key, own=True)

    # -- the picture --------------------------------------------------------------------------------------------------

    def _current(self) -> RouteSnapshot | None:
        return next((each for each in self.console.snapshot().routes if each.key == self._route.key), None)

    def _draw(self) -> None:
        now = time.monotonic()
        forward, turn = self._asked(now)
        route = self._current()
        if self._detached:
            moves = DriveText.NOT_WHILE_DETACHED()
        elif route is None or route.arming is None or not route.arming.armed:
            moves = DriveText.NOT_WHILE_DISARMED()
        else:
            moving = f"forward {forward:+.2f} m/s  turn {turn:+.2f} rad/s"
            moves = moving if forward or turn else self._why_at_rest(now)
        self._forget_refusal(route)
        speed = f"keys: {self._steering.speed:.2f} m/s, {self._steering.turn:.2f} rad/s"
        problem = "keys came late, all at once: they are ignored" if self._steering.came_late(now) else self._problem
        motion = "" if self._detached else in_hand(self._route, self.console.snapshot())
        texts = (f"{moves}   ({speed})", self._moved(), motion, self._lock.age(now), "" if self._detached else problem)
        first, *others = map(escape_text, texts)
        is_armed = route is not None and route.arming is not None and route.arming.armed and not self._detached
        state = Content.styled(f" {self._state()} ", "$warning bold reverse") if is_armed else Content(self._state())
        also = "" if self._detached else also_driving(self._route, self.console.snapshot(), holds=self._is_holder)
        driving = (Content.styled(escape_text(also), "$warning"),) if also else ()
        lines = (Content(first), *driving, state, *map(Content, (*self._limited(), *others)))
        drive = f"hold {_WAYS_SHOWN} to drive" if self._is_relayed() else f"{_WAYS_SHOWN} drive"
        keys = (drive, *_KEYS)
        is_wide = self.app.size.width >= _WIDE
        if is_wide:  # at the side, a line is short
            drive = f"hold {_ARROWS} to drive, or one of" if self._is_relayed() else f"{_ARROWS} drive, or one of"
            lines += (Content(""), *(Content.styled(key, "$quiet") for key in (drive, *_WAYS_BOX, *_KEYS)))
        self._pane.update(Content("\n").join(lines))
        self._pane.set_class(is_armed, "-armed")
        self._pane.border_subtitle = Content("" if is_wide else f" {' · '.join(keys)} ")

    def _why_at_rest(self, now: float) -> str:
        if locked := self._lock.problem(now):
            return locked
        if not self._steering.waits(now):
            return DriveText.NO_KEY()
        rhythm = self._steering.rhythm
        if rhythm.is_broken:
            return DriveText.LET_GO()
        if not rhythm.apart:
            return DriveText.HOLD()
        text = DriveText.BUNCHES if rhythm.apart <= APART_AT_MOST else DriveText.TOO_FAR_APART
        return text(seconds=rhythm.apart)

    def _forget_refusal(self, route: RouteSnapshot | None) -> None:
        """Show a refusal no longer than the topic is held by the same operator: it names who held it then."""
        arming = None if route is None else route.arming
        held_by = None if arming is None or not arming.armed else (arming.by, self._is_holder)
        if held_by != self._held_by:
            self._held_by, self._problem = held_by, ""

    def _asked(self, now: float) -> tuple[float, float]:
        """Return the velocity that the keys ask at `now` (s), within the limits, to which the bridge reduces it too."""
        velocity = (0.0, 0.0) if self._lock.problem(now) else self._steering.at(now)
        limits, _ = limits_on(self._route, self.console.snapshot())
        return velocity if limits is None else limits.reduced(*velocity)

    def _limited(self) -> Iterator[str]:
        limits, lines = limits_on(self._route, self.console.snapshot())
        if limits is not None:
            yield escape_text(DriveText.LIMITED(limits=limits, lines=join_first(lines, _NAMED)))

    def _moved(self) -> str:
        snapshot = self.console.snapshot()
        robots = join_first(moved_by(self._route, snapshot), _NAMED)
        trip = next((link.rtt for link in snapshot.links if link.name == self._route.link), None)
        round_trip = "" if trip is None else f", round trip {self.console.as_seen(trip) * 1e3:.0f} ms"
        moved = DriveText.MOVED(robots=robots, round_trip=round_trip)
        if self._landing is None:
            return moved
        if (now := time.monotonic()) - self._landed_at > _LANDING_LASTS:
            self._landed_at, self._landing = now, Landing(self._route.topic, snapshot)
        elif self._landing.is_known(snapshot, self._links):
            # Of a topic that nobody takes to another side, or that somebody here cannot hear.
            told = not self._links or self._audience.deaf
            here = [DriveText.HERE(hearing=hearing(self._audience))] if told else []
            self._reports = "; ".join([*here, *(each.text for each in self._landing.reports(snapshot, self._links))])
            self._landed_at, self._landing = now, Landing(self._route.topic, snapshot)
        return f"{moved}   {self._reports}" if self._reports else moved

    @property
    def _detached(self) -> str:
        """Return why the console is not attached, so that the snapshot is an old one, or an empty string."""
        return "" if self.console.engine is None else self.console.engine.unreachable

    def _state(self) -> str:
        route = self._current()
        if self._detached:
            return DriveText.DETACHED(reason=escape_text(self._detached))
        if route is None or route.arming is None:
            return DriveText.GONE()
        if not route.arming.armed:
            reason = f" ({escape_text(route.arming.reason)})" if route.arming.reason else ""
            return DriveText.DISARMED(reason=reason)
        left, seconds = route.arming.left, route.arming.goes_in
        asker = route.arming.asked_by if seconds is not None and self._is_holder else ""
        if asker != self._asker:
            self._asker, self._asked_since = asker, time.monotonic()
        if asker:
            return DriveText.ASKS(who=escape_text(route.arming.asked_by), seconds=seconds)
        if seconds is not None and self._asking is not None:
            return DriveText.ASKED(who=escape_text(route.arming.by), seconds=seconds)
        if not self._is_holder:
            return DriveText.ARMED_BY(who=escape_text(route.arming.by))
        return DriveText.ARMED(left="" if left is None else DriveText.LEFT(seconds=left))

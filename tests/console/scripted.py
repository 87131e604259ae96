"""An engine that plays a script: exact pictures and five hundred topics need figures that are the same every time."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from rsb_bridge.api import EngineApi, EngineError
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, text_of
from rsb_bridge.config.session_file import SessionInFile
from rsb_bridge.model import commands
from rsb_bridge.model.by_hand import Held
from rsb_bridge.model.calls import LANES, CallsSnapshot, GoalSnapshot
from rsb_bridge.model.commands import Command, R
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Kind, Session, Topic
from rsb_bridge.model.snapshot import (
    Event,
    Ledger,
    Level,
    LinkSnapshot,
    Reloaded,
    RouteSnapshot,
    Snapshot,
    Stage,
    State,
    TopicInfo,
)

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import PeekedMessage

T = TypeVar("T")
_ROOT = Path(__file__).parents[2]
NOW = 1_800_000_000.0
STAGES = (
    "publisher seen", "type known", "QoS compatible", "subscribed", "link up", "peer accepted", "sent", "received",
    "published", "subscriber seen",
)  # fmt: skip
SESSION = Session(name="robot1", role="client", server_ip="10.0.0.20", server_port=49152, domain_id=3, key_file="r.key")


def stages(failed: int | None = None, detail: str = "", names: tuple[str, ...] = STAGES) -> tuple[Stage, ...]:
    """All passed, or those before number `failed`."""
    if failed is None:
        return tuple(Stage(name, done=True) for name in names)
    return tuple(
        Stage(name, done=True if i < failed else False if i == failed else None, detail=detail if i == failed else "")
        for i, name in enumerate(names)
    )


def route(topic: str, state: State = State.OK, **changes: Any) -> RouteSnapshot:
    """A route that flows at 10 Hz, with `changes`."""
    flowing = RouteSnapshot(
        key=topic,
        link="robot1",
        topic=topic,
        remote_topic=topic,
        outgoing=False,
        spec=Topic(topic, "receive"),
        state=state,
        reason="",
        type_name="sensor_msgs/msg/LaserScan",
        type_hash="RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
        qos=Qos(reliability="best_effort", depth=5),
        publisher_qos=Qos(reliability="best_effort"),
        subscriber_qos=None,
        transport="udp",
        port=49152,
        stages=stages(),
        ledger=Ledger(offered=7134, delivered=7115, dropped={"queue full": 12, "lost on the way": 7}),
        rate=10.0,
        expected_rate=10.0,
        bytes_per_second=41200.0,
        bytes_total=29_392_800,
        latency_p50=0.0031,
        latency_p99=0.0084,
        latency_uncertainty=0.0004,
        jitter=0.0006,
        last_at=NOW - 0.1,
        history=tuple(10 + round(math.sin(i / 5)) for i in range(120)),
        last_error="",
    )
    return replace(flowing, **changes)


LINK = LinkSnapshot(
    name="robot1",
    peer="10.0.0.20:49152",
    state=State.OK,
    reason="",
    since=NOW - 724,
    retry_in=None,
    attempts=0,
    encrypted=True,
    cipher="AESGCM",
    fingerprint="3f2a 91c0 7be4 11d8",
    rtt=0.0031,
    clock_offset=-0.012,
    clock_uncertainty=0.0004,
    rx_bytes_per_second=312_000.0,
    tx_bytes_per_second=4_100.0,
    peer_version="0.1.0",
    peer_domain=4,
)

ROUTES = (
    route("/robot1/scan"),
    route("/robot1/odom", type_name="nav_msgs/msg/Odometry", rate=49.8, expected_rate=50.0, bytes_per_second=35400.0,
          latency_p50=0.0028, last_at=NOW - 0.02, history=(50,) * 120),
    route("/goal_pose", outgoing=True, transport="tcp", rate=0.2, expected_rate=None, bytes_per_second=100.0,
          last_at=NOW - 2.1, history=tuple(int(i % 5 == 0) for i in range(120))),
    route("/robot1/map", State.STALE, transport="tcp", reason="nothing for 15 s", rate=0.0, expected_rate=1.0,
          last_at=NOW - 8.4, history=(1, 0, 1, 1) + (0,) * 8, bytes_per_second=0.0),
    route("/robot2/scan", State.DOWN, transport="bluetooth", port=3, reason="no publisher of /scan in domain 4",
          stages=stages(0, "no publisher of /scan in domain 4"), rate=0.0, last_at=NOW - 31.0, latency_p50=None,
          qos=None, last_error="No route to host", last_error_at=NOW - 5, history=(10, 10, 8, 3, 1) + (0,) * 31),
    route("/initialpose", State.PAUSED, outgoing=True, rate=0.0, expected_rate=None, last_at=None, latency_p50=None,
          history=(), ledger=Ledger()),
    route("/tf", rate=100.0, expected_rate=100.0, transport="tcp", history=(100,) * 120),
    route("/camera/image_raw/compressed", rate=15.0, expected_rate=15.0, bytes_per_second=2.4e6, history=(15,) * 120),
)  # fmt: skip

EVENTS = (
    Event(1, NOW - 724, Level.INFO, "link.up", "robot1: linked to 10.0.0.20:49152, AESGCM", "robot1"),
    Event(2, NOW - 700, Level.INFO, "route.connected", "/robot1/scan: flowing", "robot1", "/robot1/scan"),
    Event(
        3,
        NOW - 12,
        Level.WARNING,
        "route.stale",
        "/robot1/map: nothing for 15 s (warning 1 of 5)",
        "robot1",
        "/robot1/map",
    ),
    Event(
        4,
        NOW - 5,
        Level.ERROR,
        "route.channel_lost",
        "/robot2/scan channel 3: No route to host",
        "robot1",
        "/robot2/scan",
    ),
)
FAULTY = ["/robot2/scan", "/robot1/map"]
"""Of these, the worst first."""

CALL_STAGES = (
    "server seen", "type known", "link up", "peer accepted", "offered", "called", "answered",
)  # fmt: skip
CALLS = CallsSnapshot(
    asked=120, answered=115, expired=1, refused={"calls under way": 2}, lost=1, in_flight=1, late=1,
    node_p50=0.012, node_p99=0.04, way_p50=0.0008, way_p99=0.0021,
    last_failure="the call of 02:31:07: no answer within 30 s",
)  # fmt: skip


def call_stages(failed: int | None = None, detail: str = "") -> tuple[Stage, ...]:
    return stages(failed, detail, CALL_STAGES)


def call_route(kind: Kind, name: str, state: State = State.OK, **changes: Any) -> RouteSnapshot:
    """A route of calls, from this side to the server's, with `changes`."""
    lanes = tuple(lane.name for lane in LANES[kind] if not lane.is_topic)
    calls = {
        "key": f"{kind} {name}", "spec": Topic(name, "transmit", kind=kind), "outgoing": True, "transport": "tcp",
        "type_name": "std_srvs/srv/SetBool", "qos": None, "publisher_qos": None, "ledger": Ledger(),
        "stages": call_stages(), "calls": CALLS, "lanes": lanes, "rate": 0.4, "expected_rate": None,
        "bytes_per_second": 120.0, "bytes_total": 35_000, "latency_p50": None, "latency_p99": None, "jitter": None,
        "latency_uncertainty": None, "last_at": NOW - 1.4, "history": tuple(int(i % 3 == 0) for i in range(120)),
    }  # fmt: skip
    return route(name, state, **{**calls, **changes})


GOALS = (
    GoalSnapshot("3f2a91c07be411d8a1b2c3d4e5f60718", "executing", NOW - 42, 130, result_awaited=True),
    GoalSnapshot("91c03f2a7be411d8a1b2c3d4e5f60718", "canceling", NOW - 3, 12),
    GoalSnapshot("7be411d83f2a91c0a1b2c3d4e5f60718", "aborted", NOW - 320, 96),
)
CALL_ROUTES = (
    call_route("service", "/robot1/set_mode"),
    call_route("service", "/robot1/map_server/load_map", State.DOWN, reason="no server of /map_server/load_map",
               stages=call_stages(0, "no server of /map_server/load_map in domain 4"), type_name="", rate=0.0,
               last_at=None, calls=CallsSnapshot(), history=()),
    call_route("action", "/navigate_to_pose", type_name="nav2_msgs/action/NavigateToPose", goals=GOALS, rate=1.2),
    call_route("parameters", "/controller_server", type_name="", outgoing=False, rate=0.0, last_at=NOW - 640.0,
               history=(), spec=Topic("/controller_server", "receive", kind="parameters"),
               calls=replace(CALLS, in_flight=0)),
)  # fmt: skip


SUGGESTION = TopicInfo("/camera/depth", "sensor_msgs/msg/Image", "", Qos(reliability="best_effort", depth=5), 1, 0)


class ScriptedEngine(EngineApi):
    """An engine that answers from what it was given, and records the commands."""

    session: Session = SESSION
    unreachable: str = ""
    waits_for_operator: bool = False

    def __init__(
        self, session: Session = SESSION, base: Path = Path(), routes: tuple[RouteSnapshot, ...] = ROUTES
    ) -> None:
        self.session, self.base = session, base
        self.now = Snapshot(NOW, session.name, session.role, "10.0.0.20:49152", 3, True, (LINK,), routes, len(EVENTS))
        self.happened = list(EVENTS)
        self.in_file = SessionInFile()
        self.commands: list[tuple[object, ...]] = []
        self.given: list[Command[Any]] = []  # the same as they came, without signs of life
        self.kept: list[bool] = []
        self.holds: tuple[str, ...] | None = None  # the keys that this console holds, or those armed on this side
        self.running = False
        self.peeked: list[PeekedMessage] = []
        self.described: str | None = None
        self.called: Future[str] = Future()
        self.called_whole: Future[commands.WholeAnswer] = Future()
        self.templates: dict[str, str] = {}
        self.demanded = ""
        self.reloads = Reloaded(("/scan (transmit): max_rate none → 5.0",))
        self.looking: Future[PeekedMessage | None] = Future()
        self.looking.cancel()  # nobody looks yet
        self.answering: Callable[[Command[Any]], Future[Any] | None] = lambda _: (
            None
        )  # instead of the script, if it does

    def start(self) -> None:
        self.running = True

    def stop(self, timeout: float = 5.0) -> None:
        self.running = False

    def snapshot(self) -> Snapshot:
        if self.now.unsaved is not (unsaved := self.in_file.differs(self.session)):
            self.now = replace(self.now, unsaved=unsaved)
        return self.now

    def events(self, after: int = 0) -> list[Event]:
        return [event for event in self.happened if event.number > after]

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self.events(after)

    def _done(self, result: T, *command: object) -> Future[T]:
        self.commands.append(command)
        return answered(result)

    def use_file(self, path: Path | None, holds: Session | None = None) -> None:
        self.file = path
        self.in_file.session = None if path is None else holds or self.session

    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        if (answer := self.answering(command)) is not None:
            return answer
        if not isinstance(command, commands.KeepArmed):
            self.given.append(command)
        return cast("Future[R]", self._execute(command, step))

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        match command:
            case commands.AddTopic(topic, link):
                return self._done(topic.topic, "add", topic, link)
            case commands.EditTopic(key, topic, drop_arm):
                return self._done(key, "edit", key, topic, *["drop_arm"] * drop_arm)
            case commands.ArmTopic(key, shared):
                return self._done(None, "arm", key, *["shared"] * shared)
            case commands.RemoveTopic(key, drop_arm):
                return self._done(self.demanded, "remove", key, *["drop_arm"] * drop_arm)
            case commands.Acknowledge(key, acknowledged, link):
                return self._done(None, "acknowledge", key or link, acknowledged)
            case commands.KeepArmed(pressed):  # not noted: a sign of life
                self.kept.append(pressed)
                held = (route for route in self.now.routes if route.arming is not None and route.arming.here)
                return answered(Held(tuple(route.key for route in held) if self.holds is None else self.holds))
            case commands.DisarmTopic(key, own):
                return self._done(None, "disarm", key, *["own"] * own)
            case commands.AskHolder(key):
                return self._done(None, "ask_holder", key)
            case commands.TakeArming(key):
                return self._done(None, "take_arming", key)
            case commands.AnswerAsker(key, gives):
                return self._done(None, "answer_asker", key, gives)
            case commands.ReleaseArmed():
                return self._done(None, "release")
            case commands.Restart():
                for words in ("telling the peer", "sockets closed", "linked again"):
                    if step is not None:
                        step(words)
            case commands.Reload(dry_run, drop_arm):
                return self._done(self.reloads, "reload", dry_run, *["drop_arm"] * drop_arm)
            case commands.Topics(link):
                return self._done((SUGGESTION,), "topics", link)
            case commands.Peek(key, kept):
                if self.peeked:
                    return self._done(self.peeked.pop(0), "peek", key, kept)
                self.looking = Future()  # until a message comes
                return self.looking
            case commands.Template(key, lane):
                if lane in self.templates:
                    return self._done(self.templates[lane], "template", key, lane)
                return refused("std_srvs is not installed here: apt install ros-jazzy-std-srvs")
            case commands.Call(key, request, lane):
                self.commands.append(("call", key, request, lane))
                return self.called
            case commands.CallWhole(key, request, lane):
                self.commands.append(("call", key, request, lane))
                return self.called_whole
            case commands.DescribeType(key):
                if self.described is None:
                    return refused("neither side knows it")
                return self._done(self.described, "describe", key)
            case commands.Save():
                self.in_file.session = self.session
                return self._done(None, "save")
            case commands.Stop():
                return self._done(None, "told to stop")
        name = str(command.__struct_config__.tag).replace("_", " ")
        result = answers().get(type(command), lambda _: None)(command)
        if isinstance(result, Future):
            return result
        return self._done(result, name, *(getattr(command, field) for field in command.__struct_fields__))


@cache
def answers() -> dict[type[Command[Any]], Callable[[Any], object]]:
    """Return the answers of features' commands, or futures of these, which their tests have in `scripted_answers`."""
    files = sorted(_ROOT.glob("extras/rsb_extras/*/tests/scripted_answers.py"))
    modules = [import_module(f"rsb_extras.{path.parts[-3]}.tests.scripted_answers") for path in files]
    return {kind: answer for module in modules for kind, answer in module.ANSWERS.items()}


def whole_answer(goal: str = "", payload: bytes = b"\0\1\0\0\1\0\0\0\7\0\0\0docked\0") -> commands.WholeAnswer:
    """Return an answer of std_srvs/srv/Trigger as a bridge gives it to a program."""
    fields = (MessageField("success", FieldType(15, 0, 0, "")), MessageField("message", FieldType(17, 0, 0, "")))
    return commands.WholeAnswer(
        payload, text_of(TypeDescription(MessageType("std_srvs/srv/Trigger_Response", fields), ())), goal
    )


def answered(result: T) -> Future[T]:
    future: Future[T] = Future()
    future.set_result(result)
    return future


def refused(reason: str) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_exception(EngineError(reason))
    return future

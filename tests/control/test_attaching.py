"""An attached console sees what the engine sees, does what it may, and knows when the engine is gone."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import socket
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.scripted import EVENTS, ScriptedEngine, refused, route
from tests.control.attaching_helpers import Stalled, consoles
from tests.support import constants, replaced
from tests.support.inside import attached_to, bytes_for, is_sending
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError, InvalidRequestError, NoAnswerError, Unable
from rsb_bridge.control import bridges, control_sockets, protocol
from rsb_bridge.control.attached_console import AttachedConsole, RequestRefused
from rsb_bridge.control.control_sockets import AttachProblem
from rsb_bridge.control.protocol import VersionProblem
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddTopic, AskHolder, Call, Command, Peek, R, Retry
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import Event, Level, State

if TYPE_CHECKING:
    from tests.support.control import Machine

_TWO_YEARS = 2 * 365 * 86400


def test_it_sees_what_the_engine_sees(machine: Machine) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    assert remote.session == engine.session
    assert replace(remote.snapshot(), last_event=0) == replace(engine.now, last_event=0)
    eventually(lambda: len(remote.events()) == len(EVENTS))
    assert remote.events() == list(EVENTS)
    engine.happened.append(replace(EVENTS[-1], number=len(EVENTS) + 1, who="anna", old="5 Hz", new="paused"))
    eventually(lambda: remote.events() == engine.happened)
    engine.now = replace(engine.now, routes=(route("/new"), *engine.now.routes[3:]))
    eventually(lambda: remote.snapshot().routes == engine.now.routes)
    engine.session = msgspec.structs.replace(engine.session, topics=(Topic("/new", "receive"),))
    engine.now = replace(engine.now, time=engine.now.time + 1)
    eventually(lambda: (remote.snapshot(), remote.session == engine.session)[1])


def test_events_are_followed(machine: Machine) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    eventually(remote.events)
    for number in range(5, 2000):
        engine.happened.append(Event(number, 0.0, Level.INFO, EventCode.LINK_UP, f"event {number}"))
    eventually(lambda: len(remote.events()) == 1999)
    assert [event.number for event in remote.events()] == list(range(1, 2000))
    assert remote.events()[-1].text == "event 1999"
    assert [event.number for event in remote.wait_for_events(1997, 1.0)] == [1998, 1999]


def test_commands_reach_engine_and_results_return(machine: Machine) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    topic = Topic("/scan", "transmit", qos={"depth": 3}, max_rate=2.5)
    assert remote.add_topic(topic, "robot1").result(60) == "/scan"
    assert remote.edit_topic("k", topic).result(60) == "k"
    remote.remove_topic("k").result(60)
    remote.pause("k", True).result(60)
    robot2 = Client("robot2", "robot2.key", deny=("/a",), topics=(topic,))
    remote.add_client(robot2).result(60)
    remote.change_client(robot2).result(60)
    remote.remove_client("robot2").result(60)
    remote.retry("robot1").result(60)
    remote.shut_down().result(60)
    steps: list[str] = []
    remote.restart(steps.append).result(60)
    assert remote.topics(None).result(60) == engine.topics().result()
    assert steps == ["telling the peer", "sockets closed", "linked again"]
    assert engine.commands[:-1] == [
        ("add", topic, "robot1"),
        ("edit", "k", topic),
        ("remove", "k"),
        ("pause", "k", True),
        ("add client", robot2),
        ("change client", robot2),
        ("remove client", "robot2"),
        ("retry", "robot1"),
        ("shut down",),
        ("restart",),
        ("topics", None),
    ]
    remote.stop_bridge().result(60)
    assert machine.stopped == 1


class Refusing(ScriptedEngine):
    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        assert isinstance(command, AddTopic)
        return refused(f"no such topic: {command.topic.topic}")


class Failing(ScriptedEngine):
    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        if not isinstance(command, Retry):
            return super().do(command, step)
        failed: Future[R] = Future()
        failed.set_exception(ValueError("a mistake"))
        return failed


def test_internal_error_of_command_ends_no_attachment(machine: Machine) -> None:
    engine = Failing()
    remote = machine.attach_to(engine)
    with pytest.raises(EngineError, match=pattern(Unable.INTERNAL, problem="a mistake")):
        remote.retry().result(60)
    remote.pause("k", True).result(60)
    assert not any(event.code == EventCode.ATTACH_LOST for event in remote.events())


def test_a_refusal_comes_back_in_words(machine: Machine) -> None:
    machine.serve(Refusing())
    with pytest.raises(EngineError, match="no such topic: /x"):
        machine.attach().add_topic(Topic("/x", "transmit")).result(60)


def test_command_without_unicode_is_refused_next_is_not(machine: Machine) -> None:
    remote = machine.attach_to(ScriptedEngine())
    with pytest.raises(InvalidRequestError, match=pattern(protocol.RequestProblem.NOT_UNICODE)):
        remote.call("/text", "data: \udcff").result(30)
    remote.retry().result(30)


def test_read_only_is_enforced_by_the_bridge(machine: Machine) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine, read_only=True)
    for change in (remote.add_topic(Topic("/scan", "transmit")), remote.retry(), remote.stop_bridge()):
        with pytest.raises(EngineError, match="read-only"):
            change.result(60)
    assert remote.topics().result(60)
    assert engine.commands == [("topics", None)]
    assert machine.stopped == 0


def test_who_attached_read_only_stays_so(machine: Machine) -> None:
    engine = ScriptedEngine()
    machine.serve(engine)
    said: list[protocol.ToBridge] = [
        protocol.ConsoleHello(protocol.VERSION, "0.1.0", read_only=True),
        protocol.ConsoleHello(protocol.VERSION, "0.1.0"),
        protocol.CommandRequest(1, Retry("")),
    ]
    with control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection:
        connection.sendall(b"".join(map(protocol.encode, said)))  # at once: the second one ends the connection
        frames = protocol.frames_to_console()
        answers: list[protocol.ToConsole] = []
        with contextlib.suppress(ConnectionResetError):  # ended before it had read all
            while data := connection.recv(1000):
                answers += frames.feed(data)
    assert [type(each) for each in answers] == [protocol.ConsoleWelcome]
    assert engine.commands == []


class Slow(ScriptedEngine):
    """Finishes no command before the test allows it."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: list[Future[Any]] = []

    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        assert isinstance(command, Retry)
        self.waiting.append(Future())
        return self.waiting[-1]


def test_requests_that_wait_are_limited(machine: Machine) -> None:
    engine = Slow()
    remote = machine.attach_to(engine)
    requests = [remote.retry() for _ in range(protocol.REQUESTS_WAITING + 1)]
    with pytest.raises(EngineError, match=pattern(RequestRefused.TOO_MANY_WAITING)):
        requests[-1].result(60)
    eventually(lambda: len(engine.waiting) == protocol.REQUESTS_WAITING)
    for each in engine.waiting:
        each.set_result(None)
    for request in requests[:-1]:
        request.result(60)


def test_engine_finishes_what_console_that_has_gone_began(machine: Machine) -> None:
    engine = Slow()
    remote = machine.attach_to(engine)
    request = remote.retry()
    eventually(lambda: engine.waiting)
    remote.stop()
    with pytest.raises(EngineError, match="detached"):
        request.result(60)
    eventually(lambda: consoles(machine) == 0)
    assert not engine.waiting[0].cancelled()


def test_failed_command_of_departed_console_is_no_error(machine: Machine, caplog: pytest.LogCaptureFixture) -> None:
    engine = Slow()
    remote = machine.attach_to(engine)
    remote.retry()
    eventually(lambda: engine.waiting)
    remote.stop()
    eventually(lambda: consoles(machine) == 0)
    engine.waiting.pop().set_exception(EngineError("it fails"))
    machine.served[-1].close()
    gc.collect(1)
    assert "never retrieved" not in caplog.text


def test_end_of_bridge_is_told_next_is_attached(machine: Machine) -> None:
    first = machine.serve()
    remote = machine.attach()
    eventually(remote.events)
    first.close("the bridge was stopped")
    lost = eventually(lambda: next((e for e in remote.events() if e.code == EventCode.ATTACH_LOST), None))
    assert "the bridge was stopped" in lost.text
    assert "the bridge was stopped" in remote.unreachable
    now = remote.snapshot()
    assert not now.running
    assert {each.state for each in now.routes} | {each.state for each in now.links} == {State.DOWN}
    (since,) = {each.since for each in now.routes} | {each.since for each in now.links}
    assert abs(since - lost.time) < 10.0
    with pytest.raises(EngineError, match=pattern(AttachProblem.NOT_ATTACHED)):
        remote.retry().result(60)
    again = ScriptedEngine(routes=(route("/again"),))
    machine.serve(again)
    eventually(lambda: not remote.unreachable)
    assert [each.topic for each in remote.snapshot().routes] == ["/again"]
    eventually(lambda: remote.events()[-1].text == EVENTS[-1].text)
    numbers = [event.number for event in remote.events()]
    assert numbers == list(range(1, len(EVENTS) * 2 + 3)), "its own count goes on with any server"


def test_console_that_writes_before_it_reads_hears_the_goodbye(machine: Machine) -> None:
    """A broken pipe would take from it what it has not read yet."""
    served = machine.serve()
    with control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection:
        connection.sendall(protocol.encode(protocol.ConsoleHello(protocol.VERSION, "0.1.0")))
        ending = threading.Thread(target=served.close, args=("the bridge was stopped",))
        ending.start()
        eventually(lambda: b"the bridge was stopped" in connection.recv(100_000, socket.MSG_PEEK))
        connection.sendall(protocol.encode(protocol.PollState()))
        frames = protocol.frames_to_console()
        assert protocol.Goodbye("the bridge was stopped") in list(frames.feed(connection.recv(100_000)))
        assert connection.recv(1000) == b""
    ending.join()


def test_step_that_raises_is_reported_then_attaches_again(machine: Machine) -> None:
    def fail(_: str) -> None:
        raise ValueError("a mistake")

    remote = machine.attach_to(ScriptedEngine())
    with pytest.raises(EngineError, match=pattern(Unable.INTERNAL, problem="a mistake")):
        remote.restart(fail).result(30)
    eventually(lambda: any(event.code == EventCode.ATTACH_LOST for event in remote.events()))
    eventually(lambda: not remote.unreachable)
    remote.retry().result(30)


def test_whoever_hears_of_the_loss_sees_it(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    server = machine.serve()
    remote = machine.attach()
    seen: list[tuple[str, bool]] = []
    add = replaced.ADD_EVENT.value

    def look_and_add(log: Any, level: Any, code: EventCode, *about: Any, **more: Any) -> None:
        if code == EventCode.ATTACH_LOST:
            seen.append((remote.unreachable, remote.snapshot().running))
        add(log, level, code, *about, **more)

    replaced.ADD_EVENT.set(monkeypatch, look_and_add)
    server.close("the bridge was stopped")
    eventually(lambda: any(event.code == EventCode.ATTACH_LOST for event in remote.events()))
    assert seen == [("the bridge was stopped", False)]


class Hanging(ScriptedEngine):
    """Does nothing any more while `goes_on` is not set."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()
        self.goes_on.set()

    def snapshot(self) -> Any:
        self.goes_on.wait()
        self.now = replace(self.now, time=self.now.time + 1)
        return self.now


def test_a_bridge_that_hangs_is_not_called_ok(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Hanging()
    remote = machine.attach_to(engine)
    constants.ANSWERS_WITHIN.set(monkeypatch, 0.5)
    engine.goes_on.clear()
    eventually(lambda: not remote.snapshot().running)
    assert says(remote.unreachable, AttachProblem.SILENT_FOR)
    first = remote.snapshot()
    later = eventually(lambda: now if (now := remote.snapshot()).time > first.time + 2.0 else None)
    assert {each.state for each in later.routes} == {State.DOWN}
    assert first.links[0].since == pytest.approx(later.links[0].since, abs=1.0), "since it answered last"
    engine.goes_on.set()
    monkeypatch.undo()
    eventually(lambda: remote.snapshot().running and not remote.unreachable)
    eventually(lambda: State.OK in {each.state for each in remote.snapshot().routes})


def test_bridge_with_slow_state_is_not_silent(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a thin line, parts of it come all the time."""
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)

    async def still_on_its_way(_: AttachedConsole) -> None:
        """Send nothing."""

    replaced.CONSOLE_SHOW.set(monkeypatch, still_on_its_way)
    constants.ANSWERS_WITHIN.set(monkeypatch, 0.5)
    eventually(lambda: not remote.snapshot().running)
    engine.happened.append(replace(EVENTS[-1], number=len(EVENTS) + 1))
    eventually(lambda: remote.snapshot().running and not remote.unreachable)


def test_many_attach_until_limit_is_told(machine: Machine) -> None:
    machine.serve()
    remotes = [machine.attach() for _ in range(protocol.CONSOLES)]
    with pytest.raises(EngineError, match=pattern(AttachProblem.OTHER_CONSOLES, count=32)):
        machine.attach()
    remotes[0].stop()
    eventually(lambda: consoles(machine) < protocol.CONSOLES)
    machine.attach()


def test_another_version_is_told_who_is_older(machine: Machine) -> None:
    machine.serve()
    sent = protocol.ConsoleHello(protocol.VERSION + 1, "9.0.0")
    with control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection:
        connection.sendall(protocol.encode(sent))
        (answer,) = protocol.frames_to_console().feed(connection.recv(1000))
    assert isinstance(answer, protocol.HelloRefused)
    assert says(answer.reason, VersionProblem.BRIDGE_OLDER)


@pytest.mark.parametrize(
    "sent",
    [b"GET / HTTP/1.1\r\n\r\n", protocol.encode(protocol.PollState()), b"\xff" * 100_000, b"\x00\x00\x00\x01\xc1"],
    ids=["http", "no hello", "too large", "no message"],
)
def test_what_is_no_console_is_cut_off(machine: Machine, sent: bytes) -> None:
    machine.serve()
    with (
        control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection,
        contextlib.suppress(ConnectionError),  # it is cut off before its end
    ):
        connection.sendall(sent)
        assert connection.recv(1000) == b""
    machine.attach()


def test_who_says_nothing_is_cut_off(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.CONSOLE_HELLO_WITHIN.set(monkeypatch, 0.0)
    machine.serve()
    with control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection:
        assert connection.recv(1000) == b""


class Busy(ScriptedEngine):
    """Every snapshot is a new one, and large."""

    def __init__(self) -> None:
        super().__init__(routes=tuple(route(f"/t{number}") for number in range(1000)))
        self.looks = 0

    def snapshot(self) -> Any:
        self.looks += 1
        self.now = replace(self.now, time=self.now.time + 1, routes=tuple(replace(r) for r in self.now.routes))
        return self.now


def test_stalled_console_skips_states_and_holds_up_nobody(machine: Machine) -> None:
    engine = Busy()
    machine.serve(engine)
    stalled = Stalled(machine)
    (console,) = eventually(lambda: [each for each in attached_to(machine.served[-1]) if bytes_for(each)])
    eventually(lambda: not is_sending(console), what="one state, and no more")
    held = bytes_for(console)
    remote = machine.attach()
    seen = remote.snapshot().time
    eventually(lambda: remote.snapshot().time > seen)
    for number in range(5, 1000):
        engine.happened.append(Event(number, 0.0, Level.INFO, EventCode.LINK_UP, "x" * 200))
    eventually(lambda: len(remote.events()) == 999)
    assert bytes_for(console) == held, "nothing more waits for it"
    stalled.connection.close()


def test_console_that_takes_nothing_is_given_up(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine.serve(Busy())
    with Stalled(machine).connection:
        eventually(lambda: consoles(machine) == 1)
        constants.CONSOLE_STALLED_FOR.set(monkeypatch, 0.5)
        eventually(lambda: consoles(machine) == 0)


def test_nothing_is_left_behind(machine: Machine) -> None:
    served = machine.serve()
    remotes = [machine.attach() for _ in range(5)]
    for remote in remotes:
        remote.stop()
    served.close()
    eventually(lambda: list(machine.folder.iterdir()) == [], what="no socket")
    eventually(lambda: all(not each.name.startswith("rsb-") for each in threading.enumerate()), what="no thread")


def test_connection_that_comes_while_server_closes_is_closed(machine: Machine) -> None:
    """Python warns of an open socket when its memory is collected, which makes a test fail."""
    for _ in range(20):
        served = machine.serve()
        control_sockets.connect(machine.folder / "robot1.sock", 5.0).close()
        served.close()
        eventually(lambda: not [*machine.folder.iterdir()])  # else the next one finds a bridge there
    gc.collect(1)


def test_absent_bridge_is_told_in_words(machine: Machine) -> None:
    with pytest.raises(EngineError, match=pattern(AttachProblem.NOT_SERVED)):
        RemoteEngine(machine.folder / "nobody.sock").start()
    assert bridges.running_bridges(machine.environ) == []


def test_attachment_that_is_cancelled_leaves_no_socket_open(machine: Machine) -> None:
    """At any turn of the event loop; Python warns of an open socket, which makes a test fail."""
    machine.serve()

    async def cancel_early(turns: int) -> None:
        attaching = asyncio.ensure_future(RemoteEngine(machine.folder / "robot1.sock")._attach())
        for _ in range(turns):
            await asyncio.sleep(0)
        attaching.cancel()
        await asyncio.gather(attaching, return_exceptions=True)

    for turns in range(12):
        asyncio.run(cancel_early(turns))
    gc.collect(1)


def test_a_bridge_that_accepts_nobody_does_not_answer(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.ANSWERS_WITHIN.set(monkeypatch, 0.2)
    machine.folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as busy, contextlib.ExitStack() as waiting:
        busy.bind(str(machine.folder / "robot1.sock"))
        busy.listen(0)
        while (connection := control_sockets.try_connect(machine.folder / "robot1.sock")) is not None:
            waiting.enter_context(connection)
        with pytest.raises(EngineError, match=pattern(AttachProblem.SILENT)):
            RemoteEngine(machine.folder / "robot1.sock").start()


def test_stop_ends_start_that_waits_for_hung_bridge(machine: Machine) -> None:
    machine.folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as hangs:
        hangs.bind(str(machine.folder / "robot1.sock"))
        hangs.listen()
        remote = RemoteEngine(machine.folder / "robot1.sock")
        failed: list[str] = []

        def start() -> None:
            try:
                remote.start()
            except EngineError as error:
                failed.append(str(error))

        starting = threading.Thread(target=start)
        starting.start()
        with hangs.accept()[0]:
            remote.stop()
            starting.join(60)
        assert failed == [AttachProblem.DETACHED()]


@pytest.mark.parametrize("leaves", [True, False], ids=["leaves", "gives up"])
@pytest.mark.parametrize("command", [Peek("/scan"), Call("/text", "data: x"), AskHolder("/scan")])
def test_leaving_console_ends_all_it_asked_for(machine: Machine, command: Command[Any], leaves: bool) -> None:
    class Quiet(ScriptedEngine):
        asked: list[Future[Any]]

        def do(self, command: Command[R], step: Any = None) -> Future[R]:
            if not isinstance(command, Peek | Call | AskHolder):
                return super().do(command, step)
            self.asked.append(Future())
            return self.asked[-1]

    engine = Quiet()
    engine.asked = []
    machine.serve(engine)
    remote = machine.attach(read_only=isinstance(command, Peek))
    done = remote.do(command)
    eventually(lambda: engine.asked)
    if not leaves:
        done.cancel()
        eventually(engine.asked[0].cancelled)
        done = remote.do(command)
        eventually(lambda: len(engine.asked) == 2)
    remote.stop()
    eventually(engine.asked[-1].cancelled)
    with pytest.raises(NoAnswerError):
        done.result(60)


def test_console_sees_the_present_state_after_a_pause(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    constants.CONSOLE_USED_REGULARLY.set(monkeypatch, -1.0)  # each use is one after a pause
    for later in (60.0, 120.0):
        engine.now = replace(engine.now, time=engine.now.time + later)
        assert remote.snapshot().time == engine.now.time


def test_start_follows_a_clock_that_is_set(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot boots without the date, and gets it from the network later."""
    wall = time.time_ns
    with monkeypatch.context() as patch:
        patch.setattr(time, "time_ns", lambda: wall() - _TWO_YEARS * 10**9)
        patch.setattr(time, "time", lambda: time.time_ns() / 1e9)
        machine.serve()
        before = machine.attach().bridge.started
    assert machine.attach().bridge.started == pytest.approx(before + _TWO_YEARS, abs=60.0)

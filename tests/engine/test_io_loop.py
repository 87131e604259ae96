"""An event loop that another thread visits while it waits."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import pytest
from tests.support import constants, replaced
from tests.support.bridge import Bridge, carries, heard, protocol_of, settled
from tests.support.domain import Domain, text
from tests.support.inside import inside
from tests.support.waiting import eventually, holds

from rsb_bridge.engine.io_loop import IoLoop
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_thread import RosToLoopQueue, RosTurns


def wants_its_turn(loop: IoLoop) -> bool:
    return loop._waits.over


@pytest.fixture
def loop() -> Iterator[IoLoop]:
    """One that runs on a thread of its own, with nothing to do."""
    made = IoLoop()
    thread = threading.Thread(target=made.run_forever, daemon=True)
    thread.start()
    yield made
    made.call_soon_threadsafe(made.stop)
    thread.join(60.0)
    assert not thread.is_alive()
    made.close()


def visit(loop: IoLoop, work: Callable[[], object]) -> None:
    """Do something in the loop's place, as soon as it waits."""
    eventually(lambda: loop.do_now(work), what="the loop waits")


@contextlib.contextmanager
def in_a_callback(loop: IoLoop) -> Iterator[None]:
    """The loop is in a callback for the length of a `with`."""
    begun, ends = threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        ends.wait(60.0)

    loop.call_soon_threadsafe(work)
    assert begun.wait(60.0)
    try:
        yield
    finally:
        ends.set()


def test_what_event_loops_may_use_is_there() -> None:
    assert {"_set_running_loop", "_get_running_loop"} <= set(asyncio.events.__all__)


def test_visitor_works_as_if_on_loops_thread(loop: IoLoop) -> None:
    seen: list[object] = []
    visit(loop, lambda: seen.append((asyncio.get_running_loop(), threading.get_ident())))
    assert seen == [(loop, threading.get_ident())]
    with pytest.raises(RuntimeError):
        asyncio.get_running_loop()


def test_visitor_may_have_loop_of_its_own(loop: IoLoop) -> None:
    async def main() -> None:
        visit(loop, lambda: None)
        assert asyncio.get_running_loop() is not loop

    asyncio.run(main())


def test_nobody_visits_while_a_callback_runs(loop: IoLoop) -> None:
    with in_a_callback(loop):
        assert not loop.do_now(pytest.fail)
    visit(loop, lambda: None)


def test_a_visitor_overtakes_no_callback(loop: IoLoop) -> None:
    order: list[int] = []
    for number in range(2000):
        if number % 2 or not loop.do_now(partial(order.append, number)):
            loop.call_soon_threadsafe(order.append, number)
    visit(loop, lambda: order.append(2000))
    assert order == list(range(2001))


def test_callback_visits_neither_loop_nor_visitor(loop: IoLoop) -> None:
    nested: list[bool] = []

    def work() -> None:
        nested.append(loop.do_now(pytest.fail))

    loop.call_soon_threadsafe(work)
    eventually(lambda: nested)
    visit(loop, work)
    assert nested == [False, False]


def test_the_loop_waits_for_a_visitor(loop: IoLoop) -> None:
    ran: list[object] = []

    def work() -> None:
        loop.call_soon_threadsafe(ran.append, 1)
        eventually(partial(wants_its_turn, loop), what="the loop wants its turn")
        assert not ran

    visit(loop, work)
    eventually(lambda: ran)


@pytest.mark.parametrize(
    "leave",
    [
        lambda loop, done: loop.call_soon(done.set),
        lambda loop, done: loop.call_later(0.01, done.set),
        lambda loop, done: loop.create_task(_set(done)),
        lambda loop, done: loop.create_future().add_done_callback(lambda _: done.set()) or loop.call_soon(done.set),
    ],
)
def test_loop_wakes_for_what_visitor_leaves_behind(
    loop: IoLoop, leave: Callable[[IoLoop, threading.Event], object]
) -> None:
    done = threading.Event()
    visit(loop, lambda: leave(loop, done))
    assert done.wait(60.0)


async def _set(done: threading.Event) -> None:
    await asyncio.sleep(0)
    done.set()


def test_loop_hears_socket_registered_by_visitor(loop: IoLoop) -> None:
    near, far = socket.socketpair()
    with near, far:
        near.setblocking(False)
        received: list[bytes] = []
        visit(loop, lambda: loop.add_reader(near, lambda: received.append(near.recv(100))))
        far.send(b"1")
        eventually(lambda: received == [b"1"])
        visit(loop, lambda: loop.remove_reader(near))


@pytest.fixture
def always_ready() -> Iterator[socket.socket]:
    """A socket that can be read at any time."""
    near, far = socket.socketpair()
    with near, far:
        far.send(b"for ever")
        yield near


@pytest.mark.parametrize(
    "leave",
    [
        lambda loop, done: loop.call_soon(done.set),
        lambda loop, done: loop.call_later(0.01, done.set),
        lambda loop, done: loop.create_task(_set(done)),
    ],
)
def test_reader_that_always_has_something_holds_nothing_up(
    loop: IoLoop, always_ready: socket.socket, leave: Callable[[IoLoop, threading.Event], object]
) -> None:
    """Neither what it leaves for later itself, nor others' callbacks, timers, sockets and visits."""
    from_timer, from_reader, from_thread = threading.Event(), threading.Event(), threading.Event()
    reads: list[bytes] = []

    def read() -> None:
        reads.append(always_ready.recv(100, socket.MSG_PEEK))
        if len(reads) == 100:
            leave(loop, from_reader)

    loop.call_soon_threadsafe(loop.call_later, 0.01, from_timer.set)
    loop.call_soon_threadsafe(loop.add_reader, always_ready, read)
    loop.call_soon_threadsafe(from_thread.set)
    near, far = socket.socketpair()
    with near, far:
        received: list[bytes] = []
        loop.call_soon_threadsafe(loop.add_reader, near, lambda: received.append(near.recv(100)))
        far.send(b"1")
        assert from_timer.wait(60.0)
        assert from_reader.wait(60.0)
        assert from_thread.wait(60.0)
        eventually(lambda: received == [b"1"])
        for each in (near, always_ready):
            loop.call_soon_threadsafe(loop.remove_reader, each)
        visit(loop, reads.clear)
        holds(lambda: not reads, 0.05)


def test_reader_may_fail_stop_reading_and_stop_loop(always_ready: socket.socket) -> None:
    loop, errors = IoLoop(), list[dict[str, Any]]()
    loop.set_exception_handler(lambda _, details: errors.append(details))

    def read() -> None:
        if not errors:
            raise KeyError("a mistake")
        loop.remove_reader(always_ready)
        loop.add_reader(always_ready, loop.stop)

    loop.add_reader(always_ready, read)
    loop.run_forever()
    assert isinstance(errors[0]["exception"], KeyError)
    loop.close()


def test_socket_closed_by_visitor_is_not_heard(loop: IoLoop) -> None:
    with contextlib.ExitStack() as sockets:
        near, far, other, beyond = (
            sockets.enter_context(each) for pair in (socket.socketpair(), socket.socketpair()) for each in pair
        )
        number = near.fileno()
        received: list[bytes] = []

        def work() -> None:
            far.send(b"stale")
            eventually(partial(wants_its_turn, loop), what="the loop has it from epoll, and wants its turn")
            loop.remove_reader(number)
            os.dup2(other.fileno(), number)
            loop.add_reader(number, lambda: received.append(os.read(number, 100)))

        visit(loop, lambda: loop.add_reader(number, pytest.fail))
        os.set_blocking(other.fileno(), False)
        visit(loop, work)
        beyond.send(b"new")
        eventually(lambda: received)
        assert received == [b"new"]
        visit(loop, lambda: loop.remove_reader(number))


def test_what_visitors_work_raises_goes_to_exception_handler(loop: IoLoop) -> None:
    errors: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, details: errors.append(details))
    visit(loop, lambda: 1 / 0)
    assert isinstance(errors[0]["exception"], ZeroDivisionError)
    visit(loop, lambda: None)


def test_a_visitor_may_stop_the_loop() -> None:
    loop = IoLoop()
    assert not loop.do_now(pytest.fail)
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    visit(loop, loop.stop)
    thread.join(60.0)
    assert not thread.is_alive()
    assert not loop.do_now(pytest.fail)
    loop.close()
    assert not loop.do_now(pytest.fail)


def test_nobody_visits_in_asyncios_debug_mode(loop: IoLoop) -> None:
    loop.call_soon_threadsafe(loop.set_debug, True)
    eventually(loop.get_debug)
    queue, received = RosToLoopQueue(loop, loop.do_now), Numbers()
    queue.put(received, [1])
    eventually(lambda: received.numbers == [1])


def test_returning_visitor_does_not_keep_loop_waiting(loop: IoLoop) -> None:
    done = threading.Event()
    visit(loop, lambda: loop.call_later(0.01, done.set))
    deadline = time.monotonic() + 60.0
    while not done.is_set() and time.monotonic() < deadline:
        loop.do_now(lambda: None)
    assert done.is_set()


class Numbers:
    """Receives numbers, and finds out whether two threads ever do so at once."""

    inside = 0

    def __init__(self) -> None:
        self.numbers: list[int] = []

    def offer(self, batch: Sequence[int]) -> None:
        Numbers.inside += 1
        assert Numbers.inside == 1
        self.numbers += batch
        Numbers.inside -= 1


@pytest.mark.usefixtures("threads_change_often")
def test_numbers_stay_in_order_while_threads_change(loop: IoLoop) -> None:
    errors: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, details: errors.append(details))
    queue, receivers = RosToLoopQueue(loop, loop.do_now), (Numbers(), Numbers())
    busy = True

    def callback() -> None:
        """The loop has work of its own, and waits in between."""
        Numbers.inside += 1
        assert Numbers.inside == 1
        Numbers.inside -= 1
        if busy:
            loop.call_later(0.0002, callback)

    def put(receiver: Numbers) -> None:
        for first in range(0, 50_000, 10):
            queue.put(receiver, range(first, first + 10))

    loop.call_soon_threadsafe(callback)
    threads = [threading.Thread(target=put, args=(each,)) for each in receivers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    eventually(lambda: all(len(each.numbers) == 50_000 for each in receivers))
    busy = False
    assert [each.numbers for each in receivers] == [list(range(50_000))] * 2
    assert errors == []


class Fails:
    def offer(self, batch: Sequence[int]) -> None:
        raise KeyError(batch)


def test_failing_receiver_keeps_nothing_from_others(loop: IoLoop) -> None:
    errors: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, details: errors.append(details))
    queue, received = RosToLoopQueue(loop, loop.do_now), Numbers()
    with in_a_callback(loop):
        queue.put(received, [1])
        queue.put(Fails(), [2])
        queue.put(received, [3])
    eventually(lambda: received.numbers == [1, 3])
    assert len(errors) == 1


@pytest.mark.usefixtures("threads_change_often")
@pytest.mark.parametrize("topic", ["/tcp", "/udp"])
def test_bridge_keeps_order_while_threads_change_all_time(
    topic: str, bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, out = pc.listener(topic), robot.publisher(topic)
    visits: list[bool] = []
    do_now = IoLoop.do_now

    def noted(loop: IoLoop, work: Callable[[], object]) -> bool:
        visited = do_now(loop, work)
        if visited and loop is visited_loop[0]:
            visits.append(True)
        return visited

    visited_loop: list[object] = [None]
    replaced.LOOP_DO_NOW.set(monkeypatch, noted)
    server, client = bridge.both(Topic(topic, "transmit", protocol=protocol_of(topic), qos=5000))
    carries([out], server, [topic])
    visited_loop[0] = inside(client).context.loop
    sent: list[bytes] = []

    def send(count: int) -> None:
        for _ in range(count):
            sent.append(text(str(len(sent))))
            out.publish(sent[-1])
        settled(client, topic, len(sent))

    send(1000)
    for _ in range(1000):
        if any(visits):
            break
        send(1)  # on a busy machine the loop may not have waited yet
    assert any(visits)
    assert heard(there, len(sent)) == sent
    holds(lambda: len(there.payloads) == len(sent), 0.1)


def test_one_turn_is_handed_on_at_once(loop: IoLoop) -> None:
    """What is express does not wait for the rest of the turn, and takes along what came before it."""
    turns, received = RosTurns(), Numbers()
    queue = RosToLoopQueue(loop, loop.do_now, turns)
    with in_a_callback(loop):
        pass
    turns.gathering = threading.get_ident()
    queue.put(received, [1])
    queue.put(received, [2])
    assert received.numbers == []
    queue.put(received, [3], express=True)
    eventually(lambda: received.numbers == [1, 2, 3])
    queue.put(received, [4])
    assert received.numbers == [1, 2, 3]
    turns.gathered()
    eventually(lambda: received.numbers == [1, 2, 3, 4])


def test_other_thread_hands_on_by_itself(loop: IoLoop) -> None:
    """It may put something while the ROS thread gathers, which then knows nothing of it."""
    turns, received = RosTurns(), Numbers()
    queue = RosToLoopQueue(loop, loop.do_now, turns)
    turns.gathering = threading.get_ident()
    thread = threading.Thread(target=queue.put, args=(received, [1]))
    thread.start()
    thread.join()
    eventually(lambda: received.numbers == [1])


def test_turn_with_more_than_may_wait_is_handed_on_before_its_end(
    loop: IoLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.ROS_BACKLOG.set(monkeypatch, 2)
    turns, received = RosTurns(), Numbers()
    queue = RosToLoopQueue(loop, loop.do_now, turns)
    turns.gathering = threading.get_ident()
    queue.put(received, [1])
    queue.put(received, [2])
    assert received.numbers == []
    queue.put(received, [3])
    eventually(lambda: received.numbers == [1, 2, 3])

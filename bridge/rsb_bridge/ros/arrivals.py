"""Waits until something has come to endpoints, or the graph has changed: by DDS's events, or without these a wait set.

By events, DDS calls libc's `eventfd_write` with the endpoint's own descriptor, and one epoll waits for all of them. So
no code of ours runs on DDS's threads, nobody there wants the GIL, and endpoints that have nothing to say cost nothing.
A wait set is handed every endpoint at each wait: with 200 quiet ones beside it, a message costs twice as much.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import select
import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from rsb_bridge.ros.native.librcl import (
    EVENTFD_WRITE,
    ON_ARRIVAL,
    WaitSetHead,
    add_guard_condition,
    reset_error,
)
from rsb_bridge.ros.native.rclpy_extension import guard_condition, wait_set
from rsb_bridge.ros.ros_interface import RosError, RosProblem
from rsb_bridge.transport.descriptors import for_arrivals

if TYPE_CHECKING:
    from rclpy.context import Context

    from rsb_bridge.ros.service_endpoints import ServiceEndpoint
    from rsb_bridge.ros.topic_endpoints import Reader

    Incoming: TypeAlias = Reader | ServiceEndpoint
    """An endpoint that messages, requests or responses come to. Its `kind` is what it is in a wait set."""


_TOLD_ONCE = select.EPOLLIN | select.EPOLLET


class Arrivals(Protocol):
    """Waits for endpoints. `wait`, `look_again` and `remove` belong to one thread.

    Attributes:
        repeats: whether an endpoint is reported for as long as it has something, or else once for what came.
    """

    repeats: bool

    def add(self, endpoint: Incoming) -> None:
        """Report an endpoint from now on, also for what it has already. From any thread.

        Raises:
            RosError: rcl refused it.
        """

    def remove(self, endpoint: Incoming) -> None:
        """Report an endpoint no more. To be called before it is freed, and does nothing for one that was not added."""

    def look_again(self, address: int, after: float) -> None:
        """Report an endpoint once more after some time, and not before, as the last look may have left something."""

    def wait(self, longest: float | None, rest: float = 0.0) -> tuple[list[int], bool]:
        """Block until something comes, the graph changes, `wake` is called, or `longest` s are over.

        What is quick here is felt by every message and call.

        Args:
            rest: s that it rests before, unless something comes to an endpoint that is express.

        Returns:
            The addresses of the reported endpoints, what is express first, and whether a node or an endpoint of the
            graph came or went.
        """

    def wake(self) -> None:
        """Make `wait` return, now or the next time it is called. From any thread."""

    def close(self) -> None:
        """Free what it waits with, after the endpoints."""


class _Due(dict[int, float]):
    """Endpoints that are to be looked at again, at once or after a rest: when (s), by their addresses."""

    def put(self, address: int, after: float) -> None:
        self[address] = time.monotonic() + after if after else 0.0

    def resting(self) -> set[int]:
        now = time.monotonic()
        return {address for address, at in self.items() if at > now}

    def within(self, longest: float | None) -> float | None:
        """Return how long to wait at most, so that the first of them is looked at in time."""
        if not self:
            return longest
        first = max(0.0, min(self.values()) - time.monotonic())
        return first if longest is None else min(first, longest)

    def take(self) -> list[int]:
        """Remove and return those whose time has come."""
        now = time.monotonic()
        due = [address for address, at in self.items() if at <= now]
        for address in due:
            del self[address]
        return due


class EventArrivals:
    """Arrivals by events. To make it raises OSError if the process has no descriptors left.

    The descriptors are edge-triggered: epoll reports one after each write, so that none has to be read. A message that
    comes while others are taken is reported after that, and may have been taken with them.

    Beyond `for_arrivals`, endpoints share descriptors, as few each as possible, and are looked at for each other's
    messages: 200 that share one cost a message at 100 Hz twice what a wait set of them does.
    """

    repeats = False

    def __init__(self, context: Context, graph_guard: int) -> None:
        self._changing = threading.Lock()
        self._descriptors: dict[int, int] = {}  # by address
        self._addresses: dict[int, dict[int, None]] = {}  # by descriptor
        self._urgent: set[int] = set()  # addresses of what is express
        self._kept: set[int] = set()  # descriptors that DDS might still write to
        self._due = _Due()
        self._epoll, self._express = select.epoll(), select.epoll()
        # The last one is for endpoints where the process has no more.
        self._wake, self._graph, self._spare = (self._descriptor() for _ in range(3))
        self._addresses[self._spare] = {}
        self._express.register(self._wake, _TOLD_ONCE)
        self._watch = _GraphWatch(context, graph_guard, self._graph)

    def add(self, endpoint: Incoming) -> None:
        address = endpoint.handle.address
        with self._changing:
            descriptor = self._least_used()
            self._descriptors[address] = descriptor
            self._addresses[descriptor][address] = None
            if endpoint.express:
                self._urgent.add(address)
                self._tell_at_once(descriptor)
        if code := ON_ARRIVAL[endpoint.kind](address, EVENTFD_WRITE, descriptor):
            reset_error()
            self._forget(address)
            raise RosError(RosProblem.ARRIVALS_NOT_TOLD(code=code))
        # What came before: rmw tells how much it was, but between its count and its listener it may miss a message.
        os.eventfd_write(descriptor, 1)

    def remove(self, endpoint: Incoming) -> None:
        address = endpoint.handle.address
        if address not in self._descriptors:
            return
        # First: DDS has returned from `eventfd_write`, and calls it no more, when this returns. Each rmw has a lock for
        # that. A number that was closed before could be a socket's by now.
        if ON_ARRIVAL[endpoint.kind](address, None, None):
            reset_error()
            self._kept.add(self._descriptors[address])
        self._due.pop(address, None)
        self._forget(address)

    def _forget(self, address: int) -> None:
        with self._changing:
            self._urgent.discard(address)
            descriptor = self._descriptors.pop(address)
            addresses = self._addresses[descriptor]
            del addresses[address]
            if addresses or descriptor == self._spare or descriptor in self._kept:
                return
            del self._addresses[descriptor]
            self._epoll.unregister(descriptor)
            os.close(descriptor)  # which takes it out of the other one

    def look_again(self, address: int, after: float) -> None:
        self._due.put(address, after)

    def wait(self, longest: float | None, rest: float = 0.0) -> tuple[list[int], bool]:
        due, told = self._due, self._addresses
        if rest:
            # What it tells is told once more below, with all that has come meanwhile.
            self._express.poll(due.within(rest) if due else rest)
        found = self._epoll.poll(due.within(longest) if due else longest)
        addresses = dict.fromkeys(due.take()) if due else {}
        graph_changed = False
        for descriptor, _ in found:
            if (sharing := told.get(descriptor)) is not None:
                addresses |= sharing
            elif descriptor == self._graph:
                self._watch.check()
                graph_changed = True
        # What rests is looked at after that, and so need not be remembered.
        for each in due.resting() if due else ():
            addresses.pop(each, None)
        ready = [*addresses]
        if self._urgent and len(ready) > 1:
            ready.sort(key=self._urgent.__contains__, reverse=True)
        return ready, graph_changed

    def wake(self) -> None:
        os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        self._watch.close()
        for descriptor in (*self._addresses, self._wake, self._graph):
            os.close(descriptor)
        self._epoll.close()
        self._express.close()

    def _least_used(self) -> int:
        """Return a new descriptor, or else the one that the fewest endpoints have."""
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if limit == resource.RLIM_INFINITY or len(self._addresses) <= for_arrivals(limit):
            try:
                made = self._descriptor()
            except OSError:  # the process, or the machine, has none left
                pass
            else:
                self._addresses[made] = {}
                return made
        return min(self._addresses, key=lambda descriptor: len(self._addresses[descriptor]))

    def _descriptor(self) -> int:
        # Nobody reads it, and a write that would overflow must not block a thread of DDS.
        descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        try:
            self._epoll.register(descriptor, _TOLD_ONCE)
        except OSError:
            os.close(descriptor)
            raise
        return descriptor

    def _tell_at_once(self, descriptor: int) -> None:
        # Another endpoint that shares it may be express, too; and without room for it, it only waits with the others.
        with contextlib.suppress(OSError):
            self._express.register(descriptor, _TOLD_ONCE)


class _GraphWatch:
    """A thread that sleeps until the graph changes. DDS tells no event of it, only a guard condition."""

    def __init__(self, context: Context, graph_guard: int, descriptor: int) -> None:
        """Begin.

        Args:
            descriptor: written to when the graph has changed, or when the thread has failed.
        """
        self._failure: Exception | None = None
        self._ended = False
        self._end = guard_condition(context)
        self._thread = threading.Thread(
            target=self._serve, args=(context, graph_guard, descriptor), name="ros graph", daemon=True
        )
        self._thread.start()

    def check(self) -> None:
        """Raise what has ended the thread."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        self._ended = True
        self._end.trigger_guard_condition()
        self._thread.join()  # without a limit: it uses what is freed next
        self._end.destroy_when_not_in_use()

    def _serve(self, context: Context, graph_guard: int, descriptor: int) -> None:
        try:
            waits = wait_set(context, guards=2)
            while not self._ended:
                waits.clear_entities()
                if _wait(waits, self._end, graph_guard, None):
                    os.eventfd_write(descriptor, 1)
            waits.destroy_when_not_in_use()
        except Exception as error:  # noqa: BLE001 — no error may end the thread unnoticed
            self._failure = error
            os.eventfd_write(descriptor, 1)


class WaitSetArrivals:
    """Arrivals by a wait set. It does not rest, as it would rest from what is express, too."""

    repeats = True

    def __init__(self, context: Context, graph_guard: int) -> None:
        self._context = context
        self._graph_guard = graph_guard
        self._woken = guard_condition(context)
        self._endpoints: dict[int, Incoming] = {}  # by address
        self._changed = False
        self._due = _Due()
        self._resting: set[int] = set()
        self._capacity: Counter[str] = Counter()
        self._adding: list[tuple[Any, Any]] = []  # the wait set's methods, and what they add
        self._waits = self._wait_set(self._capacity)

    def add(self, endpoint: Incoming) -> None:
        self._endpoints[endpoint.handle.address] = endpoint
        self._changed = True
        self.wake()

    def remove(self, endpoint: Incoming) -> None:
        self._due.pop(endpoint.handle.address, None)
        self._endpoints.pop(endpoint.handle.address, None)
        self._changed = True

    def look_again(self, address: int, after: float) -> None:
        if after:  # else it is reported anyway
            self._due.put(address, after)

    def wait(self, longest: float | None, rest: float = 0.0) -> tuple[list[int], bool]:
        resting: set[int] = set()
        if self._due:
            self._due.take()
            resting, longest = self._due.resting(), self._due.within(longest)
        if self._changed or resting != self._resting:
            self._changed, self._resting = False, resting  # first, as another thread may add one meanwhile
            self._wait_for([each for address, each in self._endpoints.copy().items() if address not in resting])
        waits = self._waits
        waits.clear_entities()
        for add, handle in self._adding:
            add(handle)
        graph_changed = _wait(waits, self._woken, self._graph_guard, longest)
        addresses: list[int] = []
        for kind in self._capacity:
            addresses += waits.get_ready_entities(kind)
        return addresses, graph_changed

    def wake(self) -> None:
        self._woken.trigger_guard_condition()

    def close(self) -> None:
        for handle in (self._waits, self._woken):
            handle.destroy_when_not_in_use()

    def _wait_for(self, endpoints: list[Incoming]) -> None:
        capacity = Counter[str](each.kind for each in endpoints)
        if capacity != self._capacity:
            self._waits.destroy_when_not_in_use()
            self._waits, self._capacity = self._wait_set(capacity), capacity
        waits = self._waits
        add = {"subscription": waits.add_subscription, "client": waits.add_client, "service": waits.add_service}
        self._adding = [(add[each.kind], each.handle.rclpy) for each in endpoints]

    def _wait_set(self, capacity: Counter[str]) -> Any:
        return wait_set(
            self._context,
            subscriptions=capacity["subscription"],
            guards=2,
            clients=capacity["client"],
            services=capacity["service"],
        )


def _wait(waits: Any, guard: Any, graph_guard: int, longest: float | None) -> bool:
    """Wait for a wait set's entities and for two guard conditions; return whether the graph has changed."""
    waits.add_guard_condition(guard)
    index = ctypes.c_size_t()
    # By rcl, because rclpy has no object for the guard condition of the graph.
    add_guard_condition(waits.pointer, graph_guard, index)
    waits.wait(-1 if longest is None else int(longest * 1e9))  # rcl waits without end
    return bool(WaitSetHead.from_address(waits.pointer).guard_conditions[index.value])

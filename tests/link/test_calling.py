"""A client calls its server for as long as it takes."""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.inside import pretend_linked

from rsb_bridge.link.roles import ClientRole
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.route.lifecycle import RouteEvent
from rsb_bridge.transport.registry import Transports
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.wire.messages import Shutdown

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link
    from rsb_bridge.transport.streams import Stream

AN_HOUR = 3600.0
AWAY = 1200.0


class NoServer(Tcp):
    """A network on which nobody answers.

    Attributes:
        times: s, when it was called.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self.times: list[float] = []
        self.error: Exception = ConnectionRefusedError()
        self._loop = loop

    async def connect(self, *_: Any) -> Stream:
        self.times.append(self._loop.time())
        raise self.error


@pytest.fixture
def calls(loop: VirtualLoop) -> NoServer:
    return NoServer(loop)


def client(make_context: Callable[..., Context], tcp: NoServer) -> ClientRole:
    return ClientRole(make_context(transports=Transports(tcp)), {"robot1": ()})


async def run_for(role: ClientRole, seconds: float) -> None:
    await role.start()
    await asyncio.sleep(seconds)
    await role.stop()


def test_client_calls_on_while_its_server_is_away(
    loop: VirtualLoop, make_context: Callable[..., Context], calls: NoServer
) -> None:
    loop.run_until_complete(run_for(client(make_context, calls), AWAY))
    assert loop.errors == []
    assert calls.times[-1] > AWAY - 2.0
    gaps = [later - earlier for earlier, later in zip(calls.times, calls.times[1:], strict=False)]
    assert max(gaps) < 1.6


def test_clients_do_not_return_all_at_once(
    loop: VirtualLoop, make_context: Callable[..., Context], calls: NoServer
) -> None:
    count = 200
    roles = []
    for number in range(count):
        context = make_context(transports=Transports(calls))
        context.random = Random(number)
        roles.append(ClientRole(context, {"robot1": ()}))

    async def all_run(seconds: float) -> None:
        await asyncio.gather(*(run_for(role, seconds) for role in roles))

    loop.run_until_complete(all_run(10.0))
    in_tenths = Counter(int(10 * (each - min(calls.times))) for each in calls.times)
    assert in_tenths[0] == count
    assert max(number for tenth, number in in_tenths.items() if tenth) < 0.3 * count
    assert max(number for tenth, number in in_tenths.items() if tenth > 40) < 0.2 * count


def test_failing_call_task_is_reported_and_restarted(
    loop: VirtualLoop, make_context: Callable[..., Context], calls: NoServer
) -> None:
    calls.error = RuntimeError("a mistake of ours")
    loop.run_until_complete(run_for(client(make_context, calls), 3600.0))
    assert calls.times[-1] > 3600.0 - 13.0
    assert 300 < len(calls.times) < 500
    assert len(loop.errors) == len(calls.times)
    assert str(loop.errors[0]["exception"]) == "a mistake of ours"


def test_cancelled_call_task_is_restarted(
    loop: VirtualLoop, make_context: Callable[..., Context], calls: NoServer
) -> None:
    calls.error = asyncio.CancelledError()  # type: ignore[assignment]
    loop.run_until_complete(run_for(client(make_context, calls), 60.0))
    assert len(calls.times) > 5
    assert [each["message"] for each in loop.errors] == ["a task ended that should go on"] * len(calls.times)


def test_nothing_runs_on_after_a_client_was_stopped(
    loop: VirtualLoop, make_context: Callable[..., Context], calls: NoServer
) -> None:
    loop.run_until_complete(run_for(client(make_context, calls), 10.0))
    before = len(calls.times)
    loop.run_until_complete(asyncio.sleep(60.0))
    assert len(calls.times) == before
    assert loop.errors == []


def test_task_of_link_that_fails_ends_connection(loop: VirtualLoop, context: Context) -> None:
    role = ClientRole(context, {"robot1": ()})
    link: Link = role.links()[0]
    aborted: list[str] = []

    class Control:
        def abort(self, reason: str) -> None:
            aborted.append(reason)

    pretend_linked(link, Control())

    async def fail() -> None:
        raise KeyError("a mistake of ours")

    link.spawn(fail())
    loop.run_until_complete(asyncio.sleep(1.0))
    assert aborted == ["internal error"]
    assert isinstance(loop.errors[0]["exception"], KeyError)


class SaysGoodbye(Tcp):
    """A network with a server that lets everybody in, and ends the link at once.

    Attributes:
        retry_after: s, that the server sends, or None if an operator has shut the link down.
        times: s, when it was called.
    """

    def __init__(self, loop: VirtualLoop, retry_after: float | None) -> None:
        self.role: ClientRole
        self.retry_after = retry_after
        self.times: list[float] = []
        self._loop = loop

    async def connect(self, host: str, port: int, handler: Any, rank: int | None = None) -> Stream:
        self.times.append(self._loop.time())
        (link,) = self.role.links()
        pretend_linked(link, Control(link))
        handler.outcome.set_result(None)
        self._loop.call_soon(link.handlers[Shutdown], Shutdown(reason="for years", retry_after=self.retry_after))
        return None  # type: ignore[return-value]


class AnswersAtTheLastMoment(Tcp):
    """A server that lets its client in just as the client's patience ends.

    Attributes:
        times: s, when it was called.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self.role: ClientRole
        self.times: list[float] = []
        self._loop = loop

    async def connect(self, host: str, port: int, handler: Any, rank: int | None = None) -> Stream:
        self.times.append(self._loop.time())
        (link,) = self.role.links()

        def answer() -> None:
            pretend_linked(link, Control(link))
            handler.outcome.set_result(None)

        self._loop.call_later(5.0, answer)
        return None  # type: ignore[return-value]


def test_server_answering_last_moment_is_not_called_again(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """It would take the second connection for a newer one, and end the first: for minutes, one after the other."""
    network = AnswersAtTheLastMoment(loop)
    role = network.role = ClientRole(make_context(transports=Transports(network)), {"robot1": ()})

    async def run() -> None:
        await role.start()
        await asyncio.sleep(60.0)
        assert network.times == [0.0]
        role.links()[0].lost("the end of the test", EventCode.LINK_LOST)
        await role.stop()

    loop.run_until_complete(run())
    assert loop.errors == []


class Control:
    """A control connection of which only the end matters."""

    is_fault = False

    def __init__(self, link: Link) -> None:
        self._link = link

    def abort(self, reason: str, code: EventCode) -> None:
        self._link.lost(reason, code)


@pytest.mark.parametrize(
    ("retry_after", "soonest", "latest"), [(0.0, 0.25, 0.75), (40.0, 40.0, 40.0), (1e9, 60.0, 60.0), (None, 24.0, 36.0)]
)
def test_server_cannot_keep_client_away_for_years(
    loop: VirtualLoop, make_context: Callable[..., Context], retry_after: float | None, soonest: float, latest: float
) -> None:
    """For all its reasons to end a link, also if it reports that an operator has shut the link down."""
    network = SaysGoodbye(loop, retry_after)
    network.role = ClientRole(make_context(transports=Transports(network)), {"robot1": ()})
    lasting = min(AN_HOUR, 1000 * latest)
    loop.run_until_complete(run_for(network.role, lasting))
    gaps = [later - earlier for earlier, later in zip(network.times, network.times[1:], strict=False)]
    assert len(gaps) >= lasting / latest - 1
    assert soonest - 0.01 < min(gaps) <= max(gaps) < latest + 0.01
    assert (max(gaps) - min(gaps) > 5.0) == (retry_after is None)  # many robots do not ask at the same moment
    assert not network.role.links()[0].end.shut_down


async def test_restart_waits_for_present_topics(
    loop: VirtualLoop, make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each edit meanwhile replaces a route that will never be accepted."""
    replaced.LINKED.set(monkeypatch, True)
    role = ClientRole(make_context(), {"robot1": ()})
    (link,) = role.links()
    link.entries.add(Topic("/chat", "transmit"))
    (route,) = link.routes.values()
    steps: list[str] = []
    restarting = loop.create_task(role.restart(steps.append))
    await asyncio.sleep(1.0)
    for depth in (7, 8):
        route = link.proposed.replace(route, link.proposed.entry(Topic("/chat", "transmit", qos=depth)))
    for event in (RouteEvent.OPEN, RouteEvent.ACCEPT):
        route.life.handle(event)
    await restarting
    assert steps[-1] == "1 of 1 topics and services accepted"


@pytest.mark.parametrize(
    ("fields", "seconds"),
    [({}, 60), ({"profile": "lte"}, 300), ({"profile": "lte", "outlive": 10.0}, 10), ({"outlive": 0.0}, 0)],
    ids=str,
)
def test_association_waits_as_its_profile_says(
    loop: VirtualLoop, make_context: Callable[..., Context], fields: dict[str, Any], seconds: float
) -> None:
    link: Link = ClientRole(make_context(**fields), {"robot1": ()}).links()[0]
    pretend_linked(link, Control(link))
    link.lost("the cable is out", EventCode.LINK_LOST)
    for _ in range(int(seconds)):
        assert link.suspended_since is not None
        loop.run_until_complete(asyncio.sleep(1.0))
    loop.run_until_complete(asyncio.sleep(0.1))
    assert link.suspended_since is None

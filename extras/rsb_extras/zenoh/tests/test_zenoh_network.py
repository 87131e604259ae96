"""Endpoints over a router of Zenoh's own, and what a stranger in the same network may cause."""

from __future__ import annotations

import asyncio
import builtins
import contextlib
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.acceptors import Accepting
from tests.support.coroutines import until
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.model.budgets import Strangers
from rsb_bridge.wire.framing import STRANGER_LIMIT
from rsb_extras.zenoh import HOW_TO_INSTALL, ZenohSettings
from rsb_extras.zenoh import endpoint as endpoints
from rsb_extras.zenoh.endpoint import ROOT, Seen
from rsb_extras.zenoh.network import Network, NetworkProblem
from rsb_extras.zenoh.pipe import SAMPLE
from rsb_extras.zenoh.sample_header import Header, SampleKind
from rsb_extras.zenoh.tests import zenoh_places
from rsb_extras.zenoh.unreachable import Unreachable
from rsb_extras.zenoh.zenoh_transport import FleetText, Links, ZenohTransport

zenoh = pytest.importorskip("zenoh")
from rsb_extras.zenoh.tests.zenoh_router import Router, stranger  # noqa: E402 (it needs the package)

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator, Sequence, Sized

    from rsb_extras.zenoh.endpoint import ZenohEndpoint

NOBODY = "0123456789abcdef"
PATIENT = {"link": {"tx": {"queue": {"congestion_control": {"drop": {"wait_before_drop": 10_000_000}}}}}}
"""Else a router that waits for a processor for a millisecond drops samples (`stranger`)."""


@pytest.fixture(scope="module")
def _router() -> Iterator[Router]:
    with contextlib.closing(Router(transport=PATIENT)) as made:
        yield made


@pytest.fixture
def router(_router: Router) -> Router:
    return _router


@contextlib.asynccontextmanager
async def in_network(
    router: Router, service: str = "server", *watched: str, strangers: Strangers | None = None, fleet: str = "fleet"
) -> AsyncIterator[ZenohEndpoint]:
    """An endpoint of a network of its own, perhaps with a budget for strangers."""
    network = Network(ZenohSettings(connect=(router.endpoint,), fleet=fleet), Path(), strangers)
    made = await network.endpoint(service, "a label", watched)
    while made.address not in {each.address for each in await made.ask(service)}:  # noqa: ASYNC110 (no event of ours)
        await asyncio.sleep(0.01)  # the router does not know this end's subscriptions yet
    try:
        yield made
    finally:
        made.close()
        network.close()


def waiting_bytes(endpoint: ZenohEndpoint) -> int:
    """Return the bytes that wait for the endpoint's loop."""
    return endpoint._waiting_bytes


def of_strangers(endpoint: ZenohEndpoint) -> Sized:
    """Return the samples of strangers that wait for the endpoint's loop."""
    return endpoint._of_strangers


class Somebody:
    """A stranger who puts samples where an endpoint hears them.

    Attributes:
        session: in the endpoint's network.
    """

    def __init__(self, router: Router, server: ZenohEndpoint) -> None:
        self.session = stranger(router)
        self._at = f"{ROOT}/fleet/at/{server.address}"

    async def is_heard(self) -> None:
        """Wait until the router knows the endpoint; before that it drops samples."""
        publisher = self.session.declare_publisher(f"{self._at}/{NOBODY}/{NOBODY}")
        await until(lambda: publisher.matching_status.matching)
        publisher.undeclare()

    def put(
        self,
        payload: bytes = b"x",
        stream: str = NOBODY,
        sender: str = NOBODY,
        *,
        number: int = 0,
        kind: SampleKind = SampleKind.DATA,
    ) -> None:
        self.put_at(f"{sender}/{stream}", payload, Header(kind, 0, number).pack())

    def drop(self, payload: bytes = b"x", sender: str = NOBODY) -> None:
        self.put_at(f"{sender}/drop", payload)

    def put_at(self, key: str, payload: bytes = b"x", attachment: bytes | None = None) -> None:
        block = zenoh.CongestionControl.BLOCK
        self.session.put(f"{self._at}/{key}", payload, attachment=attachment, congestion_control=block)


@contextlib.asynccontextmanager
async def with_stranger(
    router: Router, *watched: str, strangers: Strangers | None = None
) -> AsyncIterator[tuple[ZenohEndpoint, Somebody, list[str]]]:
    """A server's endpoint, a stranger whom it hears, and the streams that the endpoint was asked for."""
    async with in_network(router, "server", *watched, strangers=strangers) as server:
        asked: list[str] = []
        server.on_stream = lambda who, which, _: _kept(asked, which)
        other = Somebody(router, server)
        await other.is_heard()
        yield server, other, asked
        other.session.close()


class End:
    """A stream's end that keeps the received data."""

    def __init__(self, *, trusted: bool = True, of_link: bool = False) -> None:
        self.trusted, self.of_link = trusted, of_link
        self.longest = SAMPLE if trusted else STRANGER_LIMIT
        self.came: list[tuple[Header, bytes]] = []
        self.cut: list[str] = []
        self.threads: set[int] = set()

    def arrived(self, header: Header, payload: bytes) -> None:
        self.came.append((header, payload))
        self.threads.add(threading.get_ident())

    def cut_off(self, reason: str) -> None:
        self.cut.append(reason)

    def doubt(self, reason: str) -> None:
        self.cut.append(reason)


def _kept(asked: list[str], what: str) -> End:
    asked.append(what)
    return End()


async def test_endpoints_see_one_another_come_and_go(router: Router) -> None:
    fleet = "visits"  # of its own: the router may still know endpoints of another test
    async with in_network(router, "server", "client", fleet=fleet) as server:
        seen: list[tuple[str, bool]] = []
        server.on_seen = lambda who, comes: seen.append((who.address, comes))
        async with in_network(router, "client", fleet=fleet) as client:
            await until(lambda: client.address in server.seen)
            assert server.seen[client.address].label == "a label"
            assert [each.address for each in await client.ask("server")] == [server.address]
            address = client.address
        await until(lambda: not server.seen)
        assert seen == [(address, True), (address, False)]


async def test_what_no_endpoint_sends_is_passed_over(router: Router) -> None:
    async with with_stranger(router) as (_, other, asked):
        for sender, stream in (("UPPER", NOBODY), ("\x1b[2J", NOBODY), ("a" * 5000, NOBODY), (NOBODY, "f" * 17)):
            other.put(stream=stream, sender=sender)
        for attachment in (None, b"", b"\1", bytes(11), bytes(60_000)):
            other.put_at(f"{NOBODY}/{'1' * 16}", attachment=attachment)
        other.put(stream="2" * 16)
        await until(lambda: asked)
        assert asked == ["2" * 16]


async def test_samples_of_ended_stream_begin_nothing(router: Router) -> None:
    """Captured samples that are played again, for example, and all that waits for the loop is within a budget."""
    async with with_stranger(router) as (_, other, asked):
        ends: list[Any] = []
        other.session.declare_subscriber(f"{ROOT}/fleet/at/{NOBODY}/*/*", ends.append)
        for number in (7, 8):
            other.put(number=number)
        for kind in (SampleKind.WINDOW, SampleKind.END):
            other.put(kind=kind)
        await until(lambda: len(ends) == 2)
        headers = [Header.unpack(each.attachment.to_bytes()) for each in ends]
        assert [header and header.kind for header in headers] == [SampleKind.END] * 2
        assert asked == []


async def test_what_waits_for_the_loop_is_bounded(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    zenoh_places.RECEIVE_BUFFER.set(monkeypatch, 100_000)
    counted: list[int] = []
    within = zenoh_places.WITHIN_BUDGET.value

    def count(self: ZenohEndpoint, length: int, work: Callable[[], None]) -> None:
        within(self, length, work)
        if length == 1000:
            counted.append(length)

    zenoh_places.WITHIN_BUDGET.set(monkeypatch, count)
    async with with_stranger(router) as (server, other, _):
        came: list[bytes] = []
        server.add(NOBODY, NOBODY, End())
        server.on_datagram = lambda who, payload: came.append(payload)
        for _ in range(500):
            other.drop(bytes(1000))
        eventually(lambda: len(counted) == 500)  # the loop has had no turn
        await until(lambda: waiting_bytes(server) == 0)
        assert len(came) == 100_000 // (1000 + zenoh_places.OVERHEAD.value)


@pytest.mark.parametrize("number", [0, 1])
async def test_strangers_long_sample_is_not_copied(router: Router, number: int) -> None:
    budget = Strangers()
    async with with_stranger(router, strangers=budget) as (_, other, asked):
        other.put(bytes(STRANGER_LIMIT + 1), "1" * 16, number=number)
        other.put(bytes(STRANGER_LIMIT), "2" * 16)
        await until(lambda: asked)
        assert asked == ["2" * 16]
        assert budget.turned_away == 1


async def test_long_sample_on_unproven_stream_is_dropped(router: Router) -> None:
    async with with_stranger(router) as (server, other, _):
        unproven, proven = End(trusted=False), End()
        server.add(NOBODY, "1" * 16, unproven)
        server.add(NOBODY, "2" * 16, proven)
        for stream in ("1" * 16, "2" * 16):
            other.put(bytes(100_000), stream)
        await until(lambda: proven.came)
        assert unproven.came == []


class _Waiting(asyncio.SelectorEventLoop):
    """A loop that always waits, so that it can be visited (`rsb_bridge.engine.io_loop`)."""

    def do_now(self, work: Callable[[], object]) -> bool:
        work()
        return True


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    with asyncio.Runner(loop_factory=_Waiting) as runner:
        yield runner.get_loop()


@pytest.mark.usefixtures("loop")
async def test_zenohs_thread_takes_samples_of_routes_only(router: Router) -> None:
    async with with_stranger(router) as (server, other, _):
        of_route, of_link, unproven = End(), End(of_link=True), End(trusted=False)
        ends = {"1" * 16: of_route, "2" * 16: of_link, "3" * 16: unproven}
        for stream, end in ends.items():
            server.add(NOBODY, stream, end)

        def comes() -> bool:
            for stream in ends:
                other.put(stream=stream)
            return all(end.came for end in ends.values()) and bool(of_route.threads - here)

        here = {threading.get_ident()}
        await until(comes)  # on the loop's thread, if the loop is busy when a sample comes
        assert of_link.threads == unproven.threads == here


async def test_what_strangers_send_takes_no_room_from_peers(router: Router) -> None:
    budget = Strangers(100_000)
    async with with_stranger(router, strangers=budget) as (server, other, asked):
        peer = End()
        server.add(NOBODY, NOBODY, peer)
        for number in range(500):
            other.put(bytes(1000), sender=f"{number:016x}")
        other.put(bytes(1_000_000))
        eventually(lambda: waiting_bytes(server))  # the loop has had no turn
        await until(lambda: peer.came and not of_strangers(server))  # their turns are more than the peer's one
        assert budget.used == 0
        assert len(asked) == 100_000 // (1000 + zenoh_places.OVERHEAD.value)
        assert budget.turned_away == 500 - len(asked)


async def test_few_first_samples_of_strangers_wait(router: Router) -> None:
    async with with_stranger(router) as (server, other, asked):
        before: list[int] = []

        class Peer(End):
            def arrived(self, header: Header, payload: bytes) -> None:
                before.append(len(asked))

        server.add(NOBODY, NOBODY, Peer())
        for number in range(1000):
            other.put(sender=f"{number:016x}")
        other.put()
        eventually(lambda: waiting_bytes(server))  # the loop has had no turn
        await until(lambda: before and not of_strangers(server))
        assert before[0] <= zenoh_places.STRANGERS_AT_A_TIME.value
        assert len(asked) == zenoh_places.STRANGERS_WAIT.value


async def test_arrivals_during_proof_stay_in_order(router: Router) -> None:
    async with with_stranger(router) as (server, other, _):

        class Proving(End):
            def arrived(self, header: Header, payload: bytes) -> None:
                super().arrived(header, payload)
                if header.number == 0:
                    self.trusted = True
                    server.trust(NOBODY, NOBODY)
                    other.put(number=5)
                    eventually(lambda: waiting_bytes(server))

        end = Proving(trusted=False)
        server.add(NOBODY, NOBODY, end)
        for number in range(5):
            other.put(number=number)
        eventually(lambda: len(of_strangers(server)) == 5)  # the loop has had no turn
        await until(lambda: len(end.came) == 6)
        assert [header.number for header, _ in end.came] == [*range(6)]


async def test_datagrams_of_endpoints_without_a_stream_are_dropped(router: Router) -> None:
    async with with_stranger(router) as (server, other, _):
        came: list[str] = []
        server.on_datagram = lambda who, payload: came.append(who)
        server.add("1" * 16, NOBODY, End(trusted=False))
        server.add("2" * 16, NOBODY, End())
        for who in ("0" * 16, "1" * 16, "2" * 16):
            other.drop(sender=who)
        await until(lambda: came)
        assert came == ["2" * 16]
        server.forget("2" * 16, NOBODY)
        server.add("3" * 16, NOBODY, End())
        for who in ("2" * 16, "3" * 16):
            other.drop(sender=who)
        await until(lambda: came[1:])
        assert came[1:] == ["3" * 16]


async def test_flood_leaves_loop_its_other_work() -> None:
    with contextlib.closing(Router()) as router:
        async with with_stranger(router) as (server, other, _):
            turns: list[bytes] = []
            server.add(NOBODY, NOBODY, End())
            server.on_datagram = lambda _, payload: turns.append(payload)
            count = 5 * zenoh_places.AT_A_TIME.value
            for _ in range(count):
                other.drop()
            size = 1 + zenoh_places.OVERHEAD.value
            eventually(lambda: waiting_bytes(server) == count * size)  # the loop has had no turn
            seen_at: list[int] = []
            while len(turns) < count:
                await asyncio.sleep(0)
                seen_at.append(len(turns))
            assert max(b - a for a, b in zip([0, *seen_at], seen_at, strict=False)) <= zenoh_places.AT_A_TIME.value


async def test_failing_arrival_does_not_delay_next(router: Router) -> None:
    asyncio.get_running_loop().set_exception_handler(lambda *_: None)
    async with with_stranger(router) as (server, other, _):
        came: list[bytes] = []

        def take(_: str, payload: bytes) -> None:
            came.append(payload)
            if len(came) == 1:
                raise ZeroDivisionError

        server.add(NOBODY, NOBODY, End())
        server.on_datagram = take
        for payload in (b"fails", b"next"):
            other.drop(payload)
        await until(lambda: len(came) == 2)


async def test_announcements_are_limited_in_number_and_harmless(
    router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    zenoh_places.MOST_SEEN.set(monkeypatch, 5)
    async with in_network(router, "server", "client") as server:
        other = stranger(router)
        live = other.liveliness()
        root = f"{ROOT}/fleet/here/client"
        tokens = [live.declare_token(f"{root}/{'z' * 16}/odd"), live.declare_token(f"{root}/{'1' * 5000}/long")]
        tokens.append(live.declare_token(f"{root}/{'e' * 16}/%1B%5B2J%FF{'x' * 5000}"))
        await until(lambda: "e" * 16 in server.seen)
        label = server.seen["e" * 16].label
        assert label.isprintable()
        assert len(label) <= 300
        tokens += [live.declare_token(f"{root}/{number:016x}/x") for number in range(20)]
        await until(lambda: len(server.seen) == 5)
        assert all(zenoh_places.ADDRESS.value.fullmatch(each) for each in server.seen)
        for token in tokens:
            token.undeclare()
        await until(lambda: not server.seen)
        other.close()


async def test_many_announcements_hide_no_new_one(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    zenoh_places.MOST_SEEN.set(monkeypatch, 5)
    async with in_network(router, "server", "client") as server:
        other = stranger(router)
        root = f"{ROOT}/fleet/here/client"
        first = other.liveliness().declare_token(f"{root}/{'a' * 16}/x")
        await until(lambda: "a" * 16 in server.seen)
        server.add("a" * 16, NOBODY, End())
        tokens = [other.liveliness().declare_token(f"{root}/{number:016x}/x") for number in range(20)]
        await until(lambda: f"{19:016x}" in server.seen)
        assert len(server.seen) == 5
        assert "a" * 16 in server.seen
        del first, tokens
        other.close()


async def test_who_leaves_while_endpoint_is_made_is_forgotten(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a fleet would have two servers for good, and nobody would link."""
    zenoh_places.CONFIRMED.set(monkeypatch, 1.0)
    ghost, ask = Seen("server", NOBODY, "gone"), endpoints.ZenohEndpoint.ask

    async def ask_too_early(self: ZenohEndpoint, service: str) -> list[Seen]:
        return [*await ask(self, service), ghost]

    async with in_network(router) as server:
        zenoh_places.ASK.set(monkeypatch, ask_too_early)
        network = Network(ZenohSettings(connect=(router.endpoint,)), Path())
        client = await network.endpoint("client", "", ["server"])
        assert ghost.address in client.seen
        await until(lambda: ghost.address not in client.seen)
        # Zenoh may report it late, but once only: one that is forgotten all the same stays so.
        await until(lambda: server.address in client.seen)
        client.close()
        network.close()


async def test_false_announcement_ends_no_stream(router: Router) -> None:
    async with in_network(router, "server", "client") as server, in_network(router, "client") as client:
        await until(lambda: client.address in server.seen)
        end = End()
        server.add(client.address, NOBODY, end)
        came: list[str] = []
        server.on_seen = lambda who, comes: came.append(who.address)
        other = stranger(router)
        root = f"{ROOT}/fleet/here/client"
        other.liveliness().declare_token(f"{root}/{client.address}/liar").undeclare()
        with other.liveliness().declare_token(f"{root}/{NOBODY}/marker"):
            await until(lambda: NOBODY in came)
        assert end.cut == []
        assert server.seen[client.address].label == "a label"
        other.close()


def test_process_that_ends_with_network_open_does_end(router: Router) -> None:
    """Zenoh's callbacks have threads for which the interpreter waits: for ever, were the session not closed first.

    A callback that came after that aborted one process of twenty.
    """
    program = f"""
import asyncio
from pathlib import Path
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.network import Network
network = Network(ZenohSettings(connect=({router.endpoint!r},)), Path())
asyncio.run(network.endpoint("server", "x", ("client",)))
"""
    processes = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(4)]
    assert [process.wait(60) for process in processes] == [0, 0, 0, 0]


def test_closed_network_leaves_nothing(router: Router) -> None:
    def descriptors() -> int:
        return len([*Path("/proc/self/fd").iterdir()])

    async def once() -> None:
        async with in_network(router, "server", "client") as server:
            server.outbox.put(server.key(NOBODY, NOBODY), bytes(900_000), Header(SampleKind.DATA, 2, 0))

    def threads() -> int:
        return len([*Path("/proc/self/task").iterdir()])

    for _ in range(3):  # Zenoh's own pools grow to their size, and stay
        asyncio.run(once())
    before = descriptors(), threads()
    for _ in range(10):
        asyncio.run(once())
    eventually(lambda: descriptors() < before[0] + 10, what="descriptors")
    eventually(lambda: threads() < before[1] + 10, what="threads")


@contextlib.asynccontextmanager
async def with_link(router: Router) -> AsyncIterator[tuple[Links, ZenohEndpoint, End]]:
    """A client's links, its endpoint, and the end of a link's own stream there."""
    links = Links(Network(ZenohSettings(connect=(router.endpoint,)), Path()), "robot")
    endpoint, end = await links.endpoint("client", ()), End(of_link=True)
    endpoint.add(NOBODY, NOBODY, end)
    try:
        yield links, endpoint, end
    finally:
        endpoint.forget(NOBODY, NOBODY)
        links.close()
        links.network.close()


async def test_second_connection_has_session_of_its_own(router: Router) -> None:
    async with with_link(router) as (links, first, end):
        assert await links.endpoint("client", ()) is first  # of a route's stream
        told: list[bool] = []
        first.when_retired = lambda: told.append(True)
        second = await links.endpoint("client", (), is_second=True)
        assert second.address != first.address
        assert second.session is not first.session
        await until(lambda: told)
        assert await links.endpoint("client", (), is_second=True) is second  # the link is not there yet
        other = Somebody(router, first)
        await other.is_heard()
        other.put()
        await until(lambda: end.came)  # the first one goes on
        assert not first.session.is_closed()
        first.forget(NOBODY, NOBODY)
        await until(first.session.is_closed)
        assert await links.endpoint("client", ()) is second
        assert not second.session.is_closed()
        other.session.close()


async def test_first_connection_that_is_heard_keeps_its_session(
    router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with with_link(router) as (links, first, end):
        other = Somebody(router, first)
        await other.is_heard()
        reach = zenoh_places.REACH.value

        async def hear_and_reach(endpoints: Sequence[str]) -> None:
            other.put()
            await until(lambda: end.came)
            await reach(endpoints)

        zenoh_places.REACH.set(monkeypatch, hear_and_reach)
        assert await links.endpoint("client", (), is_second=True) is first
        assert end.came
        other.session.close()


async def test_session_stays_while_no_other_is_reached() -> None:
    with contextlib.closing(Router()) as router:
        async with with_link(router) as (links, first, _):
            router.kill()
            await until(lambda: not links.network.connected)
            with pytest.raises(OSError, match=pattern(Unreachable.NOBODY_LISTENS)) as caught:
                await links.endpoint("client", (), is_second=True)
            assert router.endpoint in str(caught.value)
            assert links.endpoint_if_open() is first
            router.start()
            # At once, and not when Zenoh itself tries again.
            assert await links.endpoint("client", (), is_second=True) is not first


async def test_listener_is_not_opened_anew() -> None:
    network = Network(ZenohSettings(listen=(f"tcp/127.0.0.1:{free_port()}",)), Path())
    await network.open()
    endpoint = await network.endpoint("client", "", ())
    await network.open(lambda: True)
    assert network.is_in(endpoint)
    endpoint.close()
    network.close()


class Stuck:
    """A session that a router holds up when it closes."""

    def __init__(self, session: Any) -> None:
        self._session = session

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def close(self) -> None:
        self._session.close()
        raise zenoh.ZError("close operation timed out!")


async def test_session_that_closes_late_is_left(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zenoh raises then, on a thread of which nobody takes exceptions: pytest fails a test for one."""
    opens = zenoh.open
    zenoh_places.OPEN_ZENOH.set(monkeypatch, lambda config: Stuck(opens(config)))
    network = Network(ZenohSettings(connect=(router.endpoint,)), Path())
    await network.open()
    network.close()


async def why(settings: ZenohSettings, base: Path) -> str:
    """Return the reason that an operator gets for a network that is not reached."""
    network = Network(settings, base)
    try:
        with pytest.raises(OSError) as caught:
            await network.open()
        assert not network.connected
        return str(caught.value)
    finally:
        network.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("{ mode:", "expected"),
        ("{ nothing: 1 }", "unknown field `nothing`"),
        ("[1]", ""),
        ("\x00", ""),
    ],
)
def test_a_configuration_that_is_none_is_named(tmp_path: Path, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / "z.json5").write_text(text)
    said = asyncio.run(why(ZenohSettings(connect=("tcp/127.0.0.1:1",), config="z.json5"), tmp_path))
    assert says(said, NetworkProblem.CONFIG, path=tmp_path / "z.json5")
    assert words in said
    assert "\n" not in said


def test_missing_package_is_told_with_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = builtins.__import__

    def without(name: str, *args: Any) -> Any:
        # A network of an earlier test may still be closing.
        if name == "zenoh" and threading.current_thread().name != "zenoh-close":
            raise ImportError(name)
        return usual(name, *args)

    monkeypatch.setattr(builtins, "__import__", without)
    settings = ZenohSettings(connect=("tcp/127.0.0.1:1",))
    assert asyncio.run(why(settings, tmp_path)) == HOW_TO_INSTALL


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:1#", "tcp/127.0.0.1:1?=", "tcp/a..b:7447", f"tcp/{'a' * 64}:7447"])
def test_impossible_endpoint_is_no_internal_error(tmp_path: Path, endpoint: str) -> None:
    assert asyncio.run(why(ZenohSettings(connect=(endpoint,)), tmp_path))


def test_an_endpoint_where_nobody_or_somebody_else_listens(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        there = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        nobody = f"tcp/127.0.0.1:{free_port()}"
        said = asyncio.run(why(ZenohSettings(connect=(nobody,)), tmp_path))
        assert f"{nobody}: {Unreachable.NOBODY_LISTENS()}" in said
        said = asyncio.run(why(ZenohSettings(connect=(there,)), tmp_path))
        assert says(said, Unreachable.NO_ANSWER_WITHIN) or says(said, Unreachable.NO_ZENOH)


async def test_a_network_that_was_closed_meanwhile_is_left(router: Router, tmp_path: Path) -> None:
    """Opening goes on in its thread; what it opens, then, is closed."""
    network = Network(ZenohSettings(connect=(router.endpoint,)), tmp_path)
    network.close()
    with pytest.raises(OSError):
        await network.open()
    assert network._session is None


async def test_router_that_takes_nothing_holds_up_no_loop() -> None:
    """Were one of these sent on the loop, it would be held back there, and the router would never go on."""
    router = Router()
    try:
        async with in_network(router) as server, in_network(router, "client", "server") as client:
            end = End()
            server.on_stream = lambda who, which, header: end
            server_key = client.key(server.address, NOBODY)
            await until(lambda: server.address in client.seen)
            server.add(client.address, NOBODY, end)
            router.pause()
            for number in range(120):
                client.outbox.put(server_key, bytes([number]) * 100_000, Header(SampleKind.DATA, 2, number))
            client.outbox.put(client.key(server.address, "1" * 16), b"link", Header(SampleKind.DATA, 0, 0))
            assert client.outbox.waiting(server_key, 2) > 2_000_000
            router.go_on()
            await until(lambda: sum(len(payload) == 100_000 for _, payload in end.came) == 120)
            data = [header.number for header, payload in end.came if len(payload) == 100_000]
            assert data == [*range(120)]
    finally:
        router.close()


async def test_sample_beyond_ours_is_refused(router: Router) -> None:
    async with with_stranger(router) as (server, other, _):
        came: list[int] = []
        server.add(NOBODY, NOBODY, End())
        server.on_datagram = lambda who, payload: came.append(len(payload))
        other.drop(bytes(20_000_000))
        other.drop(b"small")
        await until(lambda: came)
        assert {*came} == {5}


def opened_ports() -> set[str]:
    """Local addresses of this process's sockets that take datagrams or connections."""
    own = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the folder's own
            own.add(str(descriptor.readlink()))
    found = set()
    for table, state in (("udp", ""), ("udp6", ""), ("tcp", "0A"), ("tcp6", "0A")):
        rows = [row.split() for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
        found |= {row[1] for row in rows if f"socket:[{row[9]}]" in own and row[3].startswith(state)}
    return found


async def test_listener_opens_one_port_connector_none(router: Router, tmp_path: Path) -> None:
    port = free_port()
    here = f"tcp/127.0.0.1:{port}"
    (tmp_path / "z.json5").write_text("{transport: {link: {tls: {verify_name_on_connect: true}}}}")
    before = opened_ports()  # other tests of this process may leave DDS's
    for listen, connect, opens in (((here,), (), {f"{port:04X}"}), ((), (router.endpoint,), set())):
        for config in (None, "z.json5"):
            network = Network(ZenohSettings(listen=listen, connect=connect, config=config), tmp_path)
            await network.open()
            assert {each.partition(":")[2] for each in opened_ports() - before} == opens
            network.close()
            await until(lambda: not opened_ports() - before)  # the next one listens there, too


async def test_port_that_is_taken_is_error_in_words(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        network = Network(ZenohSettings(listen=(f"tcp/127.0.0.1:{busy.getsockname()[1]}",)), tmp_path)
        with pytest.raises(OSError, match=pattern(Unreachable.ERROR)):
            await network.open()
        network.close()


async def test_server_is_told_of_other_servers(router: Router, tmp_path: Path) -> None:
    """Its own announcement comes again when the router does; another's may have no name."""
    # A fleet of its own: the router may still know the server of another test.
    network = Network(ZenohSettings(connect=(router.endpoint,), fleet="told"), tmp_path)
    links, told = Links(network, "pc"), list[str]()
    transport = ZenohTransport(links)
    await transport.listen("zenoh", 0, Accepting(others=told.append))
    endpoint = links.endpoint_if_open()
    try:
        await until(lambda: endpoint.address in endpoint.seen)
        for comes in (False, True):
            endpoint._announced(Seen("server", endpoint.address, "pc"), comes=comes)
        endpoint._announced(Seen("server", NOBODY, ""), comes=True)
    finally:
        transport.close()
    (text,) = told
    assert says(text, FleetText.OTHER_SERVER, fleet="told", names=f"endpoint {NOBODY}")

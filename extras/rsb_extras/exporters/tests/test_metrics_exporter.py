"""A bridge's metrics over a socket, and a bridge that cannot serve them."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection
from typing import TYPE_CHECKING

import pytest
from geometry_msgs.msg import Twist
from msgspec.structs import replace
from prometheus_client.parser import text_string_to_metric_families
from tests.engine.reloading_helpers import Edited
from tests.support.bridge import carries, linked
from tests.support.captured import own_lines
from tests.support.domain import text
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Level
from rsb_extras.driving.tests.publishing_helpers import DRIVEN, TWIST, can_be_armed, drive, speeds
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.metrics import MetricsServer
from rsb_extras.exporters.tests import exporter_places

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

ONE = Topic("/chat", "transmit")


def address(host: str = "127.0.0.1") -> str:
    return f"{host}:{free_port()}"


def scrape(where: str) -> dict[tuple[str, ...], float]:
    """Return the samples, by name and the values of the labels in their order, or nothing if nobody serves any."""
    host, _, port = where.rpartition(":")
    connection = HTTPConnection(host.strip("[]"), int(port), timeout=30)
    try:
        connection.request("GET", "/metrics")
        answer = connection.getresponse()
        assert answer.status == 200
        found = answer.read().decode()
    except OSError:
        return {}
    finally:
        connection.close()
    families = text_string_to_metric_families(found)
    return {(sample.name, *sample.labels.values()): sample.value for family in families for sample in family.samples}


def told(engine: Engine, level: Level) -> int:
    """How many events about metrics of that level there were."""
    return sum((event.code, event.level) == (ExporterCode.METRICS, level) for event in engine.events())


def test_both_sides_serve_crossed_and_dropped(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    here, there = address(), address("[::1]")
    chat, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.server(features={"metrics": there}), bridge.client(ONE, features={"metrics": here})
    eventually(lambda: linked(client) and linked(server) and chat.matched)
    carries([out], server, ["/chat"])
    out.publish(text("one"))
    delivered = "rsb_messages_delivered_total"
    eventually(lambda: scrape(there).get((delivered, "in", "robot1", "/chat")))
    found = eventually(lambda: new if (new := scrape(here)).get((delivered, "out", "robot1", "/chat")) else None)
    assert found["rsb_link_up", "robot1"] == 1
    assert found["rsb_link_receive_bytes_total", "robot1"] > 0
    assert found["rsb_session_info", str(robot.id), "client", "robot1"] == 1
    assert found["process_open_fds",] > 0
    server.stop()
    eventually(lambda: scrape(here)["rsb_link_up", "robot1"] == 0)
    assert scrape(here)["rsb_link_transmit_bytes_total", "robot1"] >= found["rsb_link_transmit_bytes_total", "robot1"]
    assert not scrape(there)


def test_bytes_are_counted_over_all_connections(bridge: Bridge) -> None:
    server, client = bridge.both(ONE, features={})

    def received() -> int:
        return client.snapshot().links[0].rx_bytes_total

    before = eventually(received)
    server.restart().result(60)
    eventually(lambda: linked(client) and linked(server))
    eventually(lambda: received() > before)


def test_another_address_and_none(bridge: Bridge, tmp_path: Path) -> None:
    first, second = address(), address()
    server = bridge.server(features={"metrics": first})
    eventually(lambda: scrape(first))
    file = Edited(server, tmp_path / "server.yaml")
    file.reload(features={"metrics": second})
    eventually(lambda: scrape(second))
    assert not scrape(first)
    file.reload(
        features={"metrics": f"0.0.0.0:{second.rpartition(':')[2]}"}
    )  # the same port, which the one before has to leave
    eventually(lambda: told(server, Level.INFO) == 3)
    assert scrape(second)
    assert told(server, Level.ERROR) == 0
    file.reload(features={})
    eventually(lambda: not scrape(second))


def test_port_in_use_is_tried_again(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.METRICS_RETRIED_EVERY.set(monkeypatch, 0.05)
    where = address()
    with socket.create_server(("127.0.0.1", int(where.rpartition(":")[2]))):
        server, _ = bridge.both(ONE, features={"metrics": where})  # each of which has only this address
        eventually(lambda: told(server, Level.ERROR))
    eventually(lambda: scrape(where))
    assert told(server, Level.ERROR) == 1


def test_without_extra_bridge_says_what_to_install(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    monkeypatch.delitem(sys.modules, "rsb_extras.exporters.metrics", raising=False)
    # One alone: of two threads that import a module at once, the second gets half of it when the first one fails.
    server = bridge.server(features={"metrics": address()})
    eventually(lambda: told(server, Level.WARNING))
    (event,) = [event for event in server.events() if event.code == ExporterCode.METRICS]
    assert "pip install 'rsb-console[metrics]'" in event.text


@pytest.mark.usefixtures("long_lease")
def test_scrape_does_not_delay_end_of_motion(
    bridge: Bridge, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    exporter_places.METRICS_END_WITHIN.set(monkeypatch, 60.0)
    asked, may_answer = threading.Event(), threading.Event()

    def application(*_: object) -> list[bytes]:
        asked.set()
        may_answer.wait(60)
        return []

    exporter_places.METRICS_APPLICATION.set(monkeypatch, lambda *_: application)
    near = pc.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    port = free_port()
    server, client = (
        bridge.server(features={"metrics": f"127.0.0.1:{port}"}),
        bridge.client(replace(DRIVEN, type=TWIST)),
    )
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    with socket.create_connection(("127.0.0.1", port)) as scraper, ThreadPoolExecutor(1) as threads:
        scraper.sendall(b"GET / HTTP/1.0\r\n\r\n")
        assert asked.wait(60)
        drive(server, 0.1, rest_after=60.0)
        stopping = threads.submit(server.stop)
        try:
            eventually(lambda: speeds(near) == [0.1, 0.0])
        finally:
            may_answer.set()
        stopping.result(60)


# --- the server


class Served:
    """A server on a thread, with a clock of its own."""

    def __init__(self, answer: Callable[[], bytes] = lambda: b"1") -> None:
        self.now = 0.0
        self.failures: list[Exception] = []
        self._answer = answer
        self.port = free_port()
        self.server = MetricsServer("127.0.0.1", self.port, self._app, lambda: self.now, self.failures.append)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _app(self, _: object, start_response: Callable[[str, list[tuple[str, str]]], object]) -> list[bytes]:
        content = self._answer()
        start_response("200 OK", [])
        return [content]

    def _run(self) -> None:
        with self.server:
            while not self._ends.is_set():
                self.server.turn()

    def get(self, host: str | None = None) -> bytes:
        with socket.create_connection(("127.0.0.1", self.port), timeout=30) as connection:
            given = "" if host is None else f"Host: {host}\r\n"
            connection.sendall(f"GET / HTTP/1.0\r\n{given}\r\n".encode())
            return b"".join(iter(lambda: connection.recv(4096), b""))

    def close(self) -> None:
        self._ends.set()
        self.server.wake()
        self._thread.join(30)
        assert not self._thread.is_alive()


@pytest.fixture
def served() -> Iterator[Served]:
    with contextlib.closing(Served()) as made:
        yield made


def test_few_silent_connections_are_borne_more_are_closed(served: Served) -> None:
    silent = [socket.create_connection(("127.0.0.1", served.port), timeout=30) for _ in range(8)]
    answer = b""
    with contextlib.suppress(ConnectionError):  # closed in either way
        answer = served.get()
    assert not answer
    served.now += 10.0
    for each in silent:
        assert each.recv(1) == b""
        each.close()
    eventually(lambda: served.get().startswith(b"HTTP/1.0 200"))


def test_closing_waits_for_nobody(served: Served) -> None:
    with socket.create_connection(("127.0.0.1", served.port), timeout=30) as silent:
        eventually(lambda: len(threading.enumerate()) > 2)
        served.close()  # a connection may last 10 s of a clock that stands still here
        with contextlib.suppress(ConnectionResetError):  # its request was not read: the kernel may report it
            assert silent.recv(1) == b""


def test_what_fails_inside_is_told_and_printed_nowhere(capfd: pytest.CaptureFixture[str]) -> None:
    def fail() -> bytes:
        raise ValueError("a mistake")

    served = Served(fail)
    assert served.get().startswith(b"HTTP/1.0 500")
    assert [str(each) for each in served.failures] == ["a mistake"]
    served.close()
    assert own_lines("".join(capfd.readouterr())) == []


def test_a_reader_that_goes_is_no_error(served: Served, capfd: pytest.CaptureFixture[str]) -> None:
    for request in (b"GET / HTTP/1.0\r\n\r\n", b"nonsense\r\n\r\n", b"G", b"x" * 70_000):
        with socket.create_connection(("127.0.0.1", served.port), timeout=30) as connection:
            connection.sendall(request)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    eventually(lambda: served.get().startswith(b"HTTP/1.0 200"))
    assert served.failures == []
    assert own_lines("".join(capfd.readouterr())) == []


@pytest.mark.parametrize(
    ("host", "status"),
    [
        (None, b"200"),
        ("127.0.0.1:9464", b"200"),
        ("[::1]:9464", b"200"),
        ("localhost", b"200"),
        ("LOCALHOST:9464", b"200"),
        ("10.0.0.20:9464", b"200"),
        (socket.gethostname(), b"200"),
        (f"{socket.gethostname()}.local:9464", b"200"),
        ("elsewhere.example:9464", b"421"),
        ("127.0.0.1.elsewhere.example", b"421"),
        ("[::1", b"421"),
    ],
)
def test_name_of_another_page_is_refused(served: Served, host: str | None, status: bytes) -> None:
    assert served.get(host).split()[1] == status


def test_name_in_session_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda _, *rest, **named: resolve("127.0.0.1", *rest, **named))
    server = MetricsServer("robot1.example", 0, lambda *_: [], time.monotonic, list[Exception]().append)
    with server:
        assert server._is_meant("Robot1.example:9464")
        assert not server._is_meant("robot2.example:9464")

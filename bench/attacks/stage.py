"""A real server and its robot, each with stock ROS nodes, and what both have while somebody attacks."""

from __future__ import annotations

import contextlib
import json
import signal
import tempfile
import threading
import time
import unicodedata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed
from bench.attacks.callers import ASKED, ASKED_HZ, CALLED, OFFERS
from bench.attacks.peers import HOARD
from bench.attacks.service import CLIENTS, Clients, Service
from bench.attacks.strangers import FLOW
from bench.attacks.target import Target
from tests.support.calls import CallNode
from tests.support.locks import two_domains
from tests.support.ports import free_port

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Client, Session, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.attacks.target import Attack

TOPIC = "/bench"
HZ, SIZE = 50, 1000
SERVICE = "/bench_service"
CALLS_HZ = 20
_ANSWERED_WITHIN = 3.0
"""Seconds for calls that are pending at the end of a phase."""
_MEETS_WITHIN = 15.0


class Watched(NamedTuple):
    """A process from one moment to another: CPU in % of a core, the most memory (MB) and descriptors, log bytes."""

    cpu: float
    memory: float
    descriptors: int
    log: int


class Row(NamedTuple):
    """One phase of an attack.

    Attributes:
        delivered: share of the robot's messages that arrived, from 0 to 1.
        slowest: the 99th percentile of their latency, ms.
        answered: share of the robot's nodes' calls that got their own answer, from 0 to 1.
        call: the 99th percentile of the time until an answer, ms.
    """

    service: Service
    delivered: float
    slowest: float
    answered: float
    call: float
    server: Watched


class Watch:
    """Watches a process until it is asked."""

    def __init__(self, process: bed.Process, log: Path) -> None:
        self._process, self._log = process, log
        self._began, self._cpu, self._size = time.monotonic(), process.cpu(), log.stat().st_size
        self._memory, self._descriptors = 0.0, 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._sample)
        self._thread.start()

    def _sample(self) -> None:
        with contextlib.suppress(OSError, IndexError):  # it has ended
            while not self._over.wait(0.1):
                self._memory = max(self._memory, self._process.memory())
                files = Path(f"/proc/{self._process.pid}/fd").iterdir()
                self._descriptors = max(self._descriptors, sum(1 for _ in files))

    def end(self) -> Watched:
        self._over.set()
        self._thread.join()
        cpu = self._process.cpu() if self._process.running else self._cpu
        used = 100 * (cpu - self._cpu) / (time.monotonic() - self._began)
        return Watched(used, self._memory, self._descriptors, self._log.stat().st_size - self._size)


class Stage:
    """One server with a robot that sends, and further clients.

    Attributes:
        target: the target as an attacker sees it.
    """

    def __init__(self, resources: contextlib.ExitStack, protocol: str, host: str = "127.0.0.1") -> None:
        self._resources = resources
        near, far = domains()
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory()))
        names = ("robot1", "rogue", *CLIENTS)
        keys = {name: write_key(folder / f"{name}.key").secret for name in names}
        port = free_port()
        clients = tuple(Client(name, key_file=f"{name}.key") for name in names)
        topic = Topic(TOPIC, "transmit", type="std_msgs/msg/String", protocol=protocol, qos=2000)
        self.log = folder / "server.log"
        save(
            Session(name="bench", role="server", server_ip=host, server_port=port, domain_id=far, clients=clients),
            folder / "server.yaml",
        )
        save(
            Session(
                name="robot1", role="client", server_ip=host, server_port=port, domain_id=near, key_file="robot1.key",
                topics=(topic, Topic(SERVICE, "transmit", kind="service")),
            ),
            folder / "client.yaml",
        )  # fmt: skip
        self.target = Target(host, port, far, keys["rogue"].hex())
        self._bed = bed.Bed(self._ros("talk", near, TOPIC), self._ros("listen", far, TOPIC))
        self._callers, servers = (resources.enter_context(contextlib.closing(CallNode(d))) for d in (near, far))
        servers.serve(SERVICE)
        self._server = resources.enter_context(bed.headless(folder / "server.yaml", self.log))
        resources.enter_context(bed.headless(folder / "client.yaml", folder / "client.log"))
        bed.ready(self._bed)
        self._callers.waits_for(SERVICE)
        self._callers.call(SERVICE, 20)  # warm
        self._clients = Clients(host, port, keys)
        resources.callback(self._clients.close)

    def _ros(self, part: str, domain: int, topic: str) -> bed.Process:
        return self._resources.enter_context(
            bed.Process("-m", "rsb_extras.bench.measured_stream", part, str(domain), topic)
        )

    def watch(self, seconds: float) -> Row:
        """Measure the service to everybody for some seconds."""
        began, watch = time.monotonic(), Watch(self._server, self.log)
        # A minute of calls may wait at once, so that a server that hangs does not slow the callers down.
        self._callers.begin(SERVICE, int(CALLS_HZ * seconds), rate=CALLS_HZ, at_once=CALLS_HZ * 60)
        run = self._bed.send(HZ, seconds, SIZE)
        server, service = watch.end(), self._clients.since(began)
        calls = self._callers.settled(SERVICE, _ANSWERED_WITHIN)
        if calls.wrong:
            raise SystemExit(f"a call has a wrong answer: {calls.wrong}")
        answered, slowest = calls.answered / calls.wanted, 1000 * calls.p99
        return Row(service, min(1.0, run.received / run.sent), run.p99, answered, slowest, server)

    @property
    def running(self) -> bool:
        return self._server.running

    def prepare(self, what: str) -> None:
        """Start further nodes that an attack needs in the server's domain."""
        domain = self.target.domain
        if what == "flow":
            self._ros("talk", domain, FLOW).tell("send 1000 100000 4000")
        elif what == "hoard":
            stopped = self._ros("listen", domain, HOARD)
            stopped.ask("report")
            time.sleep(3.5)  # until DDS has discovered it, at the latest
            stopped.signal(signal.SIGSTOP)
            self._resources.callback(stopped.signal, signal.SIGCONT)
        elif what == "called":
            self._resources.enter_context(contextlib.closing(CallNode(domain))).serve(CALLED, delay=None)
        elif what == "asked":
            callers = self._resources.enter_context(contextlib.closing(CallNode(domain)))
            callers.begin(ASKED, 1_000_000, at_once=1_000_000, rate=ASKED_HZ)

    def meets(self) -> str:
        """Whether two nodes that start now in the server's domain find each other."""
        began = time.monotonic()
        listener, talker = (self._ros(part, self.target.domain, "/meet") for part in ("listen", "talk"))
        listener.ask("report")
        while not talker.ask("match")["subscribers"]:
            if time.monotonic() - began > _MEETS_WITHIN:
                return f"nodes that start meanwhile do not find each other within {_MEETS_WITHIN:.0f} s"
            time.sleep(0.1)
        return f"nodes that start meanwhile find each other within {time.monotonic() - began:.1f} s of their start"


@contextlib.contextmanager
def attacker(name: str, target: Target) -> Iterator[bed.Process]:
    with bed.Process("-m", "bench.attacks.attacker", name, json.dumps(target)) as process:
        process.line()
        yield process


class Result(NamedTuple):
    """The result of one attack: rows by phase, the attacker's counts, and further observations."""

    rows: dict[str, Row]
    tally: dict[str, float]
    remarks: list[str]


def perform(name: str, attack: Attack, host: str) -> Result:
    with contextlib.ExitStack() as resources:
        stage = Stage(resources, attack.protocol, host)
        stage.prepare(attack.stage)
        rows = {"before": stage.watch(3.0)}
        remarks = []
        with attacker(name, stage.target) as process:
            rows["during"] = stage.watch(attack.seconds)
            if attack.stage == "nodes":
                remarks.append(stage.meets())
            tally = process.ask("tally")
            if OFFERS in attack.at_least:
                tally[OFFERS] = stage.log.read_text(errors="replace").count(": offered here")
        rows["after"] = stage.watch(3.0)
        if not stage.running:
            remarks.append("the server has ended")
        remarks += seen_in(stage.log)
    return Result(rows, tally, remarks)


def seen_in(log: Path) -> list[str]:
    """Return remarks about log lines that harm a terminal or deceive an operator."""
    lines = log.read_bytes().decode(errors="replace").split("\n")
    raw = sum(1 for line in lines for c in line if unicodedata.category(c) in {"Cc", "Cf"})
    forged = sum(1 for line in lines if line.startswith("2026-01-01"))
    remarks = [f"{raw} raw control characters in the log, {forged} forged lines"] if raw or forged else []
    if (longest := max(map(len, lines))) > 1500:
        remarks.append(f"a line of {longest} characters in the log")
    if any("Traceback" in line or "internal error" in line for line in lines):
        remarks.append("a traceback or an internal error in the log")
    return remarks


def domains() -> tuple[int, int]:
    """Return two ROS domains that no other process on this machine uses."""
    global _first  # noqa: PLW0603 - this process's, as long as it lives
    if _first is None:
        _first = two_domains()
    return _first, _first + 1


_first: int | None = None

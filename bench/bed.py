"""Processes to measure: talker and listener, with a bridge, the thesis's pipeline, or nothing between them."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).parents[1]
NEAR, FAR = 94, 95
TOPIC = "/bench"
_TICKS = os.sysconf("SC_CLK_TCK")


class Process:
    """A child that answers lines of commands with lines of JSON; None of it is left when the bench ends."""

    def __init__(self, *command: str, log: Path | None = None) -> None:
        """Start it; with `log`, all that it writes goes there, and it cannot be asked."""
        environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        with contextlib.ExitStack() as files:
            output = files.enter_context(log.open("wb")) if log else None
            self._child = subprocess.Popen(
                [sys.executable, *command],
                stdin=subprocess.PIPE,
                stdout=output or subprocess.PIPE,
                stderr=output or subprocess.DEVNULL,
                text=True,
                env=environment,
                cwd=ROOT,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def ask(self, line: str) -> dict[str, float]:
        self.tell(line)
        answer: dict[str, float] = json.loads(self.line())
        return answer

    def tell(self, line: str) -> None:
        """A command that is not waited for."""
        assert self._child.stdin is not None
        self._child.stdin.write(line + "\n")
        self._child.stdin.flush()

    def signal(self, number: int) -> None:
        self._child.send_signal(number)

    def line(self) -> str:
        assert self._child.stdout is not None
        return self._child.stdout.readline()

    @property
    def pid(self) -> int:
        return self._child.pid

    def cpu(self) -> float:
        """Processor time so far, s, all threads."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def memory(self) -> float:
        """Resident memory, MB."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1000

    def descriptors(self) -> int:
        """Open file descriptors."""
        return sum(1 for _ in Path(f"/proc/{self.pid}/fd").iterdir())

    @property
    def running(self) -> bool:
        return self._child.poll() is None

    def stop(self) -> None:
        self._child.terminate()
        try:
            self._child.wait(6)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


@dataclass(slots=True)
class Bed:
    """A talker, a listener, and what stands between them."""

    talker: Process
    listener: Process
    between: list[Process] = field(default_factory=list)

    def send(self, rate: int, seconds: float, size: int) -> Run:
        """Send for a while, wait until no more comes, and say what came."""
        self.listener.ask("reset")
        cpu = sum(process.cpu() for process in self.between)
        count = int(rate * seconds)
        reached = self.talker.ask(f"send {rate} {count} {size}")["rate"]
        report = self._settled(count)
        used = sum(process.cpu() for process in self.between) - cpu
        return Run(count, int(report["count"]), reached, used, report["p50"] / 1e6, report["p99"] / 1e6)

    def _settled(self, count: int) -> dict[str, float]:
        """Wait until all have come, or none has for a second."""
        report = self.listener.ask("report")
        grown = time.monotonic()
        while report["count"] < count and time.monotonic() - grown < 1.0:
            time.sleep(0.1)
            newer = self.listener.ask("report")
            if newer["count"] > report["count"]:
                grown = time.monotonic()
            report = newer
        return report


@dataclass(frozen=True, slots=True)
class Run:
    """One run: messages sent and received, rate reached (Hz), CPU of what is between (s), latencies (ms)."""

    sent: int
    received: int
    rate: float
    cpu: float
    p50: float
    p99: float

    @property
    def lossless(self) -> bool:
        return self.received >= self.sent

    @property
    def cpu_per_message(self) -> float:
        """µs."""
        return self.cpu / self.sent * 1e6


@contextlib.contextmanager
def direct(listener: str = "listen") -> Iterator[Bed]:
    """Nothing between them: one domain."""
    with _ends(NEAR, NEAR, listener) as bed:
        yield ready(bed)


@contextlib.contextmanager
def bridged(protocol: str, client: Callable[[Path], Process] | None = None) -> Iterator[Bed]:
    """Our bridge between them: two processes, encrypted; `client` starts another client than the headless one."""
    with tempfile.TemporaryDirectory() as name, _ends(NEAR, FAR) as bed:
        folder = Path(name)
        (folder / "bench.key").write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        (folder / "bench.key").chmod(0o600)
        port = free_port()
        common = f"name: bench\nserver_ip: 127.0.0.1\nserver_port: {port}\nkey_file: bench.key\n"
        (folder / "server.yaml").write_text(f"role: server\ndomain_id: {FAR}\n{common}")
        (folder / "client.yaml").write_text(
            f"role: client\ndomain_id: {NEAR}\n{common}topics:\n"
            f"  - {{topic: {TOPIC}, direction: transmit, type: std_msgs/msg/String, protocol: {protocol}, qos: 2000}}\n"
        )
        bed.between.append(headless(folder / "server.yaml"))
        bed.between.append((client or headless)(folder / "client.yaml"))
        try:
            yield ready(bed)
        finally:
            for process in bed.between:
                process.stop()


def headless(session: Path, log: Path | None = None) -> Process:
    """One side of our bridge."""
    return Process("-m", "rsb_console", "run", "--no-ui", str(session), log=log)


@contextlib.contextmanager
def thesis() -> Iterator[Bed]:
    """The thesis's pipeline between them."""
    with _ends(NEAR, FAR) as bed:
        port, key = str(free_port()), base64.urlsafe_b64encode(os.urandom(32)).decode()
        for part, domain in (("receive", FAR), ("send", NEAR)):
            bed.between.append(Process("-m", "bench.thesis", part, str(domain), TOPIC, port, key))
            bed.between[-1].line()
        try:
            yield ready(bed)
        finally:
            for process in bed.between:
                process.stop()


@contextlib.contextmanager
def _ends(near: int, far: int, listener: str = "listen") -> Iterator[Bed]:
    bed = Bed(
        Process("-m", "bench.traffic", "talk", str(near), TOPIC),
        Process("-m", "bench.traffic", listener, str(far), TOPIC),
    )
    try:
        yield bed
    finally:
        bed.talker.stop()
        bed.listener.stop()


def ready(bed: Bed) -> Bed:
    """Wait until a message gets through, then warm up."""
    deadline = time.monotonic() + 20
    bed.listener.ask("reset")
    while not bed.listener.ask("report")["count"]:
        if time.monotonic() > deadline:
            raise SystemExit("nothing gets through")
        bed.talker.ask("send 100 10 100")
        time.sleep(0.1)
    bed.send(1000, 1.0, 1000)
    return bed


def free_port() -> int:
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        return int(tcp.getsockname()[1])

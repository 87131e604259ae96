"""Processes of benchmarks on this machine: two bridges between two ROS domains, with a talker and a listener."""

from __future__ import annotations

import base64
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from rsb_bridge.feature_api import EngineError, State, attach
from rsb_extras.bench.benchmark import Bench, BenchmarkStep
from rsb_extras.bench.results import BenchError, Many, Run, Side, Way
from rsb_extras.demo.demo_session import free_port
from rsb_extras.demo.processes import READY_WITHIN, Process, listening, router

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager

    from rsb_bridge.feature_api import RemoteEngine, Snapshot
    from rsb_extras.bench.bench_recording import BenchRecording, KeptRun
    from rsb_extras.bench.results import BenchEnds

TOPIC = "/bench"
TRAFFIC = "rsb_extras.bench.measured_stream"
ZenohPath: TypeAlias = Literal["", "peer", "router"]
"""How two sides meet over Zenoh: not at all, the client connects to the server, or both to a router."""
TRANSPORTS: Mapping[str, ZenohPath] = {"tcp": "", "udp": "", "zenoh": "peer"}
"""The transports that one machine can measure, and how the two sides meet."""
_TYPE = "std_msgs/msg/String"
_DEPTH = 2000  # messages, as in all figures of bench/README.md
_HISTORY = 64 << 20
"""Most bytes that a publisher or a subscription keeps."""
_LEAST_DEPTH = 4  # messages, however large. A round figure
_QUIET = 0.7
"""Seconds without a message after which the wait ends."""
_LOOK_EVERY = 0.05  # s. A round figure, far below `_QUIET`
_ANSWERS_WITHIN = 5.0  # s, as `control.remote_engine.ANSWERS_WITHIN`
_OPENED_WITHIN = 60.0  # s; 500 topics take 0.6 to 1.2 s on a quiet machine (bench/README.md, Opening 500 topics)
_WATCHED_FOR = 3.0  # s, for three messages of each topic
_STATE_EVERY = 0.1  # s. A round figure: a bridge renews its state each 0.25 s


def depth_of(size: int) -> int:
    """Return the number of messages of a size to keep."""
    return max(_LEAST_DEPTH, min(_DEPTH, _HISTORY // max(1, size)))


@dataclass(slots=True)
class Bed:
    """A talker, a listener, and the processes between them.

    Attributes:
        between: the processes between them, in the order in which messages pass.
        topics: the number of the topic for messages of a size; other sizes use the first topic.
        sockets: control sockets of `between`, if any.
        started: start of the first of `between`, in seconds of the monotonic clock.
        listening: seconds until the receiving bridge listened.
        first: seconds until the first message was through.
        transport: a word of the topics in the recording.
        recording: gets the messages of the runs that have a `part`, or None.
    """

    talker: Process
    listener: Process
    between: list[Process] = field(default_factory=list)
    topics: dict[int, int] = field(default_factory=dict)
    sockets: list[Path] = field(default_factory=list)
    started: float = 0.0
    listening: float | None = None
    first: float | None = None
    transport: str = ""
    recording: BenchRecording | None = None

    def send(self, rate: float, seconds: float, size: int, part: str = "") -> Run:
        """Send for a while, wait until no more messages come, and return the counts."""
        count = max(1, int(rate * seconds))
        kept: KeptRun | None = None
        if self.recording is not None and part:
            topic = f"{TOPIC}/{self.transport}/bytes_{size}/{part}_{rate:.0f}_hz"
            kept = self.recording.keep(topic, depth_of(size))
        self.listener.ask("reset" if kept is None else f"reset {size}")
        before = [process.cpu() for process in self.between]
        order = f"send {rate} {count} {size} {self.topics.get(size, 0)}"
        reached = self.talker.ask(order if kept is None else f"{order} {kept.near}")["rate"]
        # At a low rate, two messages may be further apart than `_QUIET`.
        self._settle(count, max(_QUIET, 2 / rate))
        used = [process.cpu() - then for process, then in zip(self.between, before, strict=True)]
        report = self.listener.ask("report" if kept is None else f"report {kept.far}")
        sides = (used[0], sum(used[1:])) if used else (0.0, 0.0)
        p50, p99, p999 = (report[name] / 1e6 for name in ("p50", "p99", "p999"))
        topic = kept.topic if kept is not None and report["kept"] else ""
        return Run(size, count, int(report["count"]), reached, p50, p99, p999, sides, topic=topic)

    def _settle(self, count: int, quiet: float) -> None:
        """Wait until all messages have come, or no message has come for some seconds."""
        come, grown = self.listener.ask("count")["count"], time.monotonic()
        while come < count and time.monotonic() - grown < quiet:
            time.sleep(_LOOK_EVERY)
            newer = self.listener.ask("count")["count"]
            if newer > come:
                grown = time.monotonic()
            come = newer

    def most(self, _: int) -> float:
        return float("inf")

    def wire(self, rate: float, seconds: float, size: int) -> Run:
        """Do as `send`, and count the bytes that the sending bridge handed to its sockets."""
        before = sent_bytes(self.sockets[0])
        run = self.send(rate, seconds, size)
        return replace(run, wire=sent_bytes(self.sockets[0]) - before)

    def sides(self, idle: float) -> tuple[Side, Side]:
        before, began = [process.cpu() for process in self.between], time.monotonic()
        time.sleep(idle)
        passed = time.monotonic() - began
        used = [process.cpu() - then for process, then in zip(self.between, before, strict=True)]
        sending, receiving = (
            Side(process.memory(), 100 * cpu / passed if idle else None, first=self.first)
            for process, cpu in zip(self.between, used, strict=True)
        )
        return sending, Side(receiving.memory, receiving.idle, self.listening, self.first)


def sent_bytes(socket: Path) -> int:
    """Return the bytes that a bridge has handed to the sockets of its links.

    Raises:
        BenchError: it does not answer.
    """
    try:
        with attach(socket, read_only=True) as engine:
            return engine.do(Bench(BenchmarkStep("measure"))).result(_ANSWERS_WITHIN).usage.sent_bytes
    except (EngineError, TimeoutError) as error:
        raise BenchError(f"a bridge on this machine does not answer: {error}") from None


@contextlib.contextmanager
def ends(near: int, far: int, sizes: Sequence[int] = ()) -> Iterator[Bed]:
    """Start a talker and a listener, in two domains or one, with a topic for each size."""
    topics = [f"{topic_of(size)}:{depth_of(size)}" for size in sizes] or [TOPIC]
    with (
        Process("-m", TRAFFIC, "talk", str(near), *topics) as talker,
        Process("-m", TRAFFIC, "listen", str(far), *topics) as listener,
    ):
        yield Bed(talker, listener, topics={size: at for at, size in enumerate(sizes)})


def topic_of(size: int) -> str:
    """Return the name of the topic for messages of a size. Another benchmark on the same machine has other names."""
    return f"{TOPIC}_{os.getpid()}_{size}"


@contextlib.contextmanager
def direct(near: int, sizes: Sequence[int] = ()) -> Iterator[Bed]:
    """Put nothing between talker and listener: one domain."""
    with ends(near, near, sizes) as bed:
        yield ready(bed)


@contextlib.contextmanager
def bridged(
    protocol: str,
    near: int,
    far: int,
    sizes: Sequence[int] = (),
    *,
    zenoh: ZenohPath = "",
    side: Callable[[Path], Process] | None = None,
    client: Callable[[Path], Process] | None = None,
) -> Iterator[Bed]:
    """Put our bridge between a talker and a listener: two processes, encrypted.

    Args:
        protocol: protocol of all topics.
        near: the domain of the talker and the client.
        far: the domain of the listener and the server.
        sizes: message sizes with a topic each, or empty for one topic for all.
        zenoh: how the sides meet over Zenoh.
        side: starts a side, or None for `headless`.
        client: starts the client's side, or None for `side`.
    """
    side = side or headless
    with tempfile.TemporaryDirectory(prefix="rsb-bench-") as name, ends(near, far, sizes=sizes) as bed:
        folder = Path(name)
        names = {topic_of(size): depth_of(size) for size in sizes} or {TOPIC: _DEPTH}
        entries = [
            f"  - {{topic: {topic}, direction: transmit, protocol: {protocol}, type: {_TYPE}, qos: {depth}}}"
            for topic, depth in names.items()
        ]
        port = write_sessions(folder, near, far, entries, zenoh)
        with contextlib.ExitStack() as between:
            if zenoh == "router":
                between.enter_context(router(f"tcp/127.0.0.1:{port}"))
            bed.started = time.monotonic()
            server = between.enter_context(side(folder / "server.yaml"))
            bed.listening = listening(server, port) - bed.started
            sending = between.enter_context((client or side)(folder / "client.yaml"))
            bed.between += [sending, server]
            bed.sockets += [folder / "client.sock", folder / "server.sock"]
            yield ready(bed)


def write_sessions(
    folder: Path, near: int, far: int, entries: Sequence[str], zenoh: ZenohPath = "", *, key: str = "topics"
) -> int:
    """Write the session files of a server and a client in two domains, with these entries; return the port.

    The port is the server's, or the router's if both sides connect to a Zenoh router. `key` is the entries' key.
    """
    key_file = folder / "bench.key"
    key_file.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
    key_file.chmod(0o600)
    port = free_port()
    listens = connects = f"server_ip: 127.0.0.1\nserver_port: {port}\n"
    if zenoh:
        connects = f"server_ip: zenoh\nzenoh: {{connect: [tcp/127.0.0.1:{port}]}}\n"
        listens = connects if zenoh == "router" else connects.replace("connect:", "listen:")
    common = "name: bench\nkey_file: bench.key\n"
    (folder / "server.yaml").write_text(f"role: server\ndomain_id: {far}\n{common}{listens}")
    (folder / "client.yaml").write_text(
        "\n".join([f"role: client\ndomain_id: {near}\n{common}{connects}{key}:", *entries]) + "\n"
    )
    return port


def headless(session: Path, log: Path | None = None) -> Process:
    """Start one side of our bridge. Its socket and its state are in the session's folder, not the user's."""
    folder = session.parent
    apart = {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder)}
    control = ["--control", str(session.with_suffix(".sock"))]
    return Process(
        "-m",
        "rsb_console",
        "run",
        "--no-ui",
        *control,
        str(session),
        log=log or folder / f"{session.stem}.log",
        environ=apart,
    )


def ready(bed: Bed) -> Bed:
    """Wait until a message gets through on each topic, then warm up."""
    deadline = time.monotonic() + READY_WITHIN
    for at in range(max(1, len(bed.topics))):
        bed.listener.ask("reset")
        while not bed.listener.ask("count")["count"]:
            if time.monotonic() > deadline:
                raise BenchError(
                    "no message gets through: check the ROS set-up, and that nothing filters the two domains"
                )
            bed.talker.ask(f"send 100 2 100 {at}")
            time.sleep(_LOOK_EVERY)
        if bed.first is None and bed.between:
            bed.first = time.monotonic() - bed.started
    # The first messages meet empty caches, and are no measure of the others (bench/README.md, Method).
    bed.send(1000, 0.3, 1000)
    return bed


class Loopback:
    """Two domains of this machine.

    Args:
        transports: of `TRANSPORTS`.
        domains: two ROS domains, free of other nodes.
        recording: gets the messages of each run, or None.
    """

    def __init__(
        self, transports: tuple[str, ...], domains: tuple[int, int], recording: BenchRecording | None = None
    ) -> None:
        self._transports = transports
        self._near, self._far = domains
        self._recording = recording

    @property
    def ways(self) -> list[Way]:
        return [Way(transport, "transmit") for transport in self._transports]

    def baseline(self, sizes: list[int]) -> AbstractContextManager[BenchEnds]:
        return direct(self._near, sizes)

    @contextlib.contextmanager
    def open(self, way: Way, sizes: list[int]) -> Iterator[BenchEnds]:
        with bridged(way.transport, self._near, self._far, sizes, zenoh=TRANSPORTS[way.transport]) as bed:
            bed.transport, bed.recording = way.transport, self._recording
            yield bed

    def many(self, count: int) -> Many:
        prefix = f"{TOPIC}_{os.getpid()}/topic_"
        entries = [
            f"  - {{topic: {prefix}{number:03d}, direction: transmit, type: {_TYPE}}}" for number in range(count)
        ]
        with contextlib.ExitStack() as resources:
            folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="rsb-bench-")))
            port = write_sessions(folder, self._near, self._far, entries)
            resources.enter_context(Process("-m", TRAFFIC, "many", str(self._near), prefix, str(count)))
            receiving = resources.enter_context(headless(folder / "server.yaml"))
            listening(receiving, port)
            began = time.monotonic()
            sending = resources.enter_context(headless(folder / "client.yaml"))
            opened = _all_carry(sending, folder / "client.sock", count, began)
            between, watched = (sending, receiving), time.monotonic()
            before = [process.cpu() for process in between]
            time.sleep(_WATCHED_FOR)
            passed = time.monotonic() - watched
            cpu = [100 * (process.cpu() - then) / passed for process, then in zip(between, before, strict=True)]
            return Many(count, opened, (sending.memory(), receiving.memory()), (cpu[0], cpu[1]))


def _all_carry(bridge: Process, socket: Path, count: int, began: float) -> float:
    """Wait until so many topics of a bridge carry messages; return the seconds since its start."""
    deadline = began + _OPENED_WITHIN
    engine: RemoteEngine | None = None
    try:
        while time.monotonic() < deadline and bridge.running:
            if engine is None:
                engine = _attached(socket)
            elif _carrying(engine.snapshot()) >= count:
                return time.monotonic() - began
            time.sleep(_STATE_EVERY)
    finally:
        if engine is not None:
            engine.stop()
    raise BenchError(f"{count} topics are not open within {_OPENED_WITHIN:.0f} s")


def _carrying(snapshot: Snapshot) -> int:
    return sum(1 for route in snapshot.routes if route.ledger.delivered and route.state is State.OK)


def _attached(socket: Path) -> RemoteEngine | None:
    try:
        return attach(socket, read_only=True)
    except EngineError:
        return None  # it has just started


def machine() -> str:
    """Return the processor's name and the number of cores."""
    name = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{name or os.uname().machine}, {os.cpu_count()} cores"


def ros_problem() -> str:
    """Return the reason why no ROS node can run here, or an empty string."""
    found = subprocess.run([sys.executable, "-P", "-c", "import rclpy, std_msgs.msg"], capture_output=True, check=False)
    return "" if found.returncode == 0 else "no ROS here: source its setup file, or install rsb-console[ros]"

"""Prints the cost of pictures: ``python -m rsb_extras.pictures.tests.look_cost [rounds]``, 4 min and 1.5 min a round.

``python -m rsb_extras.pictures.tests.look_cost 3 link`` prints the last part only, and ``... 1 still FILE`` what a
camera costs that sees nothing but a photograph.

Two headless sides between two domains. A node on the client's side has a camera, a point cloud and a map, which are not
bridged, and a topic of 20 Hz, which is. A viewer attaches to the server. It prints

- the CPU time and the wake-ups of both idle sides before a view, and 30 s after the last one has ended;
- the CPU time of the client's side for each picture, the bytes of pictures, and the time until the first one, with and
  without a process that draws already;
- how a view of the camera and the 20 Hz topic share a link of 50 kB/s, by turns with neither view nor camera, with a
  node that subscribes to the camera instead, and with the view. The second turn shows what DDS takes on the robot's
  computer, which no view can save.

Set ``FASTRTPS_DEFAULT_PROFILES_FILE`` for a Fast DDS that is set up for large messages.
"""

from __future__ import annotations

import base64
import os
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from bench import bed
from bench.small import _threads
from tests.support.relay import Relay

from rsb_bridge.control.bridges import running_bridges
from rsb_bridge.control.remote_engine import attach
from rsb_extras.pictures.look_requests import LookAtTopics
from rsb_extras.pictures.picture import Wish

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_extras.pictures.picture import Viewed

ROUNDS = 3
RATE, SIZE = 20.0, 1_000
LINK = 50_000
"""Bytes a second of the slow link."""
_TURN, _DRAWS, _IDLES = 20.0, 8.0, 20.0
_OPENS = 3.0
_AFTER = 30.0
"""s after the last view."""
_COLD_STARTS = 3
_VIEW_ENDS = 8.0
"""s after which a view that nobody looks at has ended."""
_WITHIN = 60.0
_VIEW_RATE = 5.0
_WORKER = "rsb_extras.pictures.worker"
USUAL = Wish(width=80, height=24, webp=True)
_LARGE = Wish(width=120, height=40, webp=True, shape=2.0)
STILL = {
    "no view": None,
    "blocks, 120×40": msgspec.structs.replace(_LARGE, across=2, down=4),
    "pixels, 120×40": msgspec.structs.replace(_LARGE, across=8, down=16),
}
"""What a still camera is looked at with."""
_STILL = 20.0
KINDS = {
    "camera": "640×480 rgb8",
    "large": "1920×1080 rgb8",
    "jpeg": "1920×1080 JPEG",
    "cloud": "100,000 points",
    "map": "1000×1000 grid",
}


def main() -> None:
    rounds, *only = sys.argv[1:] or [str(ROUNDS)]
    if only[:1] == ["still"]:
        report_still(only[1])
    else:
        report(int(rounds), costs=only != ["link"])


def report(rounds: int, *, costs: bool) -> None:
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_RUNTIME_DIR"] = name
        if costs:
            with running(Path(name)) as bridge:
                _print_costs(bridge)
        with running(Path(name), LINK) as bridge:
            _print_slow_link(bridge, rounds)


def report_still(photograph: str) -> None:
    """Print the bytes of a view at 2 Hz of a camera that sees a photograph, beside those of the link without it."""
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_RUNTIME_DIR"] = name
        with running(Path(name)) as bridge:
            bridge.robot.tell(f"photograph {Path(photograph).absolute()}")
            bridge.robot.tell("publish camera")
            for about, wish in STILL.items():
                if wish is None:
                    time.sleep(_OPENS)
                else:
                    bridge.look("/camera", 2.0, _OPENS, about, wish)
                carried, began = bridge.relay.carried, time.monotonic()
                if wish is None:
                    time.sleep(_STILL)
                    seen = []
                else:
                    seen = bridge.look("/camera", 2.0, _STILL, about, wish)
                rate = (bridge.relay.carried - carried) / (time.monotonic() - began) / 1e3
                print(f"{about:<20}{rate:>8.2f} kB/s {len(seen) / _STILL:>8.1f} pictures/s", flush=True)


class Bridge:
    """Two sides, a robot on the client's, and a viewer on the server's."""

    def __init__(
        self, client: bed.Process, server: bed.Process, robot: bed.Process, engine: RemoteEngine, relay: Relay
    ) -> None:
        self.client = client
        self.server = server
        self.relay = relay
        self.robot = robot
        self.engine = engine

    def look(
        self, topic: str, rate: float, seconds: float, viewer: str, wish: Wish = USUAL
    ) -> list[tuple[Viewed, float]]:
        """Look for some time; return the pictures, and how old each was when it came."""
        wish, seen = msgspec.structs.replace(wish, rate=rate), []
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            viewed = self.engine.do(LookAtTopics(viewer, (topic,), wish)).result(_WITHIN)
            if viewed is not None and viewed.picture.content is not None:
                seen.append((viewed, viewed.age or 0.0))
        return seen

    def first(self, topic: str, viewer: str) -> float:
        """Return the s until a viewer's first picture."""
        began = time.monotonic()
        while not self.look(topic, _VIEW_RATE, 0.01, viewer):
            if time.monotonic() - began > _WITHIN:
                raise SystemExit(f"there is no picture of {topic}")
        return time.monotonic() - began

    def cpu(self) -> tuple[float, float]:
        """Return the CPU time of the client's process, and of its drawing process, in s."""
        worker = _worker_of(self.client.pid)
        return _cpu(self.client.pid), 0.0 if worker is None else _cpu(worker)


@contextmanager
def running(folder: Path, bytes_per_second: float = 0.0) -> Iterator[Bridge]:
    """Start both sides, over a link that is limited if a rate is given."""
    port = bed.free_port()
    relay = Relay(("127.0.0.1", port), rate=bytes_per_second or 1e9)
    with relay:
        _write_sessions(folder, port, relay.port)
        with (
            bed.Process("-m", "rsb_extras.pictures.tests.look_robot") as robot,
            bed.headless(folder / "server.yaml", folder / "server.log") as server,
            bed.headless(folder / "client.yaml", folder / "client.log") as client,
            attach(_socket("look-server"), read_only=True) as engine,
        ):
            _until(lambda: any(route.ledger.delivered for route in engine.snapshot().routes), folder)
            yield Bridge(client, server, robot, engine, relay)


def _socket(name: str) -> Path:
    found: list[Path] = []

    def look() -> bool:
        found[:] = [each.path for each in running_bridges() if each.name == name]
        return bool(found)

    _until(look, None)
    return found[0]


def _until(condition: Any, folder: Path | None) -> None:
    ends = time.monotonic() + _WITHIN
    while not condition():
        if time.monotonic() > ends:
            logs = "" if folder is None else "\n".join(each.read_text()[-2000:] for each in folder.glob("*.log"))
            raise SystemExit(f"the bridge does not run:\n{logs}")
        time.sleep(0.1)


def _write_sessions(folder: Path, port: int, relay: int) -> None:
    key = folder / "look.key"
    if not key.exists():
        key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        key.chmod(0o600)
    common = "server_ip: 127.0.0.1\nkey_file: look.key\n"
    (folder / "server.yaml").write_text(
        f"name: look-server\nrole: server\nserver_port: {port}\ndomain_id: {bed.FAR}\nserver_ip: 127.0.0.1\n"
        "clients:\n  - {name: robot1, key_file: look.key}\n"
    )
    (folder / "client.yaml").write_text(
        f"name: robot1\nrole: client\nserver_port: {relay}\ndomain_id: {bed.NEAR}\n{common}"
        "topics:\n  - {topic: /steady, direction: transmit, protocol: tcp, type: std_msgs/msg/String}\n"
    )


def _worker_of(pid: int) -> int | None:
    return next((int(c) for c in _children(pid) if _WORKER in Path(f"/proc/{c}/cmdline").read_text()), None)


def _children(pid: int) -> list[str]:
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += (task / "children").read_text().split()
    return found


def _cpu(pid: int) -> float:
    return sum(thread.cpu for thread in _threads(pid).values())


def _print_costs(bridge: Bridge) -> None:
    bridge.robot.tell("publish")
    time.sleep(_AFTER)
    before = _idle(bridge)
    _print_first(bridge)
    print("\npictures of 80×24 cells at 5 Hz, of messages at 15 Hz; CPU in ms a picture, of the bridge and of the")
    print("process that draws; bytes before compression, and bytes that crossed")
    print(f"{'':<20}{'bridge':>10}{'drawing':>10}{'bytes':>10}{'crossed':>10}{'pictures/s':>12}{'age, s':>10}")
    for topic, about in KINDS.items():
        bridge.robot.tell(f"publish {topic}")
        bridge.look(f"/{topic}", _VIEW_RATE, _OPENS, topic)
        cpu, carried, began = bridge.cpu(), bridge.relay.carried, time.monotonic()
        seen = bridge.look(f"/{topic}", _VIEW_RATE, _DRAWS, topic)
        passed, count = time.monotonic() - began, max(1, len(seen))
        costs = [(b - a) / count * 1e3 for a, b in zip(cpu, bridge.cpu(), strict=True)]
        crossed = (bridge.relay.carried - carried) / count
        encoded, age = _medians(seen)
        print(
            f"{about:<20}{costs[0]:>10.1f}{costs[1]:>10.1f}{encoded:>10.0f}{crossed:>10.0f}"
            f"{len(seen) / passed:>12.1f}{age:>10.2f}",
            flush=True,
        )
    bridge.robot.tell("publish")
    time.sleep(_AFTER)
    after = _idle(bridge)
    print("\nidle sides: CPU in ms a second, and wake-ups a second")
    for name in ("client", "server"):
        print(f"{name:<10}" + "; ".join(f"{when} {idle[name][0]:.2f}, {idle[name][1]:.1f}" for when, idle in (
            ("before a view", before), ("after the last one", after))))  # fmt: skip
    left = _worker_of(bridge.client.pid)
    print("the process that draws " + ("has ended" if left is None else f"still runs: {left}"), flush=True)


def _print_first(bridge: Bridge) -> None:
    cold, warm = [], []
    for number in range(_COLD_STARTS):
        _until(lambda: _worker_of(bridge.client.pid) is None, None)
        bridge.robot.tell("publish camera")
        time.sleep(1.0)
        cold.append(bridge.first("/camera", f"cold{number}"))
        warm.append(bridge.first("/camera", f"warm{number}"))
    for name, times in (("starts", cold), ("runs already", warm)):
        listed = ", ".join(f"{each:.2f}" for each in times)
        print(f"s until the first picture of the camera, if the process that draws {name}: {listed}", flush=True)


def _medians(seen: list[tuple[Viewed, float]]) -> tuple[float, float]:
    """Return the bytes and the age of pictures."""
    if not seen:
        return 0.0, 0.0
    return statistics.median(viewed.encoded for viewed, _ in seen), statistics.median(age for _, age in seen)


def _idle(bridge: Bridge) -> dict[str, tuple[float, float]]:
    """Return the ms of CPU and the wake-ups a second of each side, with its drawing process."""
    sides = {"client": bridge.client.pid, "server": bridge.server.pid}
    before = {name: _used(pid) for name, pid in sides.items()}
    time.sleep(_IDLES)
    used = {name: [b - a for a, b in zip(before[name], _used(pid), strict=True)] for name, pid in sides.items()}
    return {name: (cpu * 1e3 / _IDLES, slept / _IDLES) for name, (cpu, slept) in used.items()}


def _used(pid: int) -> tuple[float, int]:
    worker = _worker_of(pid)
    threads = [each for process in (pid, worker) if process is not None for each in _threads(process).values()]
    return sum(each.cpu for each in threads), sum(each.slept for each in threads)


def _print_slow_link(bridge: Bridge, rounds: int) -> None:
    print(f"\na topic of {SIZE} B at {RATE:g} Hz over a link of {LINK // 1000} kB/s, and the camera at 15 Hz:")
    print("neither, with a node that subscribes to it, and with a view of it at 5 Hz")
    print(
        f"{'':<12}{'received':>10}{'p50, ms':>10}{'p99, ms':>10}{'DDS p99':>10}{'bytes/s':>10}"
        f"{'pictures/s':>12}{'bytes':>8}{'age, s':>8}"
    )
    with bed.Process("-m", "rsb_extras.pictures.tests.look_robot", "listen") as neighbour:
        for number in range(rounds):
            for turn in ("alone", "subscribed", "view"):
                _print_turn(bridge, neighbour, turn, f"slow{number}")


def _print_turn(bridge: Bridge, neighbour: bed.Process, turn: str, viewer: str) -> None:
    """Print one turn; the neighbour is another node on the robot's computer, which hears the steady topic, too."""
    with ExitStack() as stack:
        bridge.robot.tell("publish steady" if turn == "alone" else "publish steady camera")
        if turn == "subscribed":
            stack.enter_context(bed.Process("-m", "rsb_extras.pictures.tests.look_robot", "subscribe")).line()

        def run(seconds: float) -> list[tuple[Viewed, float]]:
            if turn == "view":
                return bridge.look("/camera", _VIEW_RATE, seconds, viewer)
            time.sleep(seconds)
            return []

        run(_OPENS)  # opening costs once, and does not count here
        for process in (bridge.robot, neighbour):
            process.ask("figures")
        carried, began = bridge.relay.carried, time.monotonic()
        seen = run(_TURN)
        passed = time.monotonic() - began
        crossed = (bridge.relay.carried - carried) / passed
        far, near = bridge.robot.ask("figures"), neighbour.ask("figures")
        encoded, age = _medians(seen)
        print(
            f"{turn:<12}{far['received']:>10.1%}{far['p50']:>10.1f}{far['p99']:>10.1f}{near['p99']:>10.1f}"
            f"{crossed:>10.0f}{len(seen) / passed:>12.1f}{encoded:>8.0f}{age:>8.2f}",
            flush=True,
        )
    if turn == "view":
        time.sleep(_VIEW_ENDS)


if __name__ == "__main__":
    main()

"""Prints the cost of pictures: ``python -m bench.look [rounds]``, 2 min a round.

Two headless sides between two domains. A node on the client's side has a camera, a point cloud and a map, which are not
bridged, and a topic of 20 Hz, which is. A viewer attaches to the server. It prints

- how a view of the camera and the 20 Hz topic share a link of 50 kB/s, by turns with and without the view;
- the CPU time of the client's side for each picture, and the bytes of pictures;
- the time until the first picture;
- the CPU time of the idle client before a view, and after it has ended.
"""

from __future__ import annotations

import base64
import os
import statistics
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.small import _threads
from tests.support.slow_relay import SlowRelay

from bench import bed
from rsb_bridge.control.bridges import running_bridges
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.model.pictures import Wish
from rsb_bridge.view.renderer import IDLE_SECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.pictures import Viewed

ROUNDS = 3
RATE, SIZE = 20.0, 1_000
LINK = 50_000
"""Bytes a second of the slow link."""
_TURN, _DRAWS, _IDLES = 15.0, 8.0, 20.0
_WITHIN = 60.0
_VIEW_RATE = 5.0
_WORKER = "rsb_bridge.view.worker"
KINDS = {
    "camera": "640×480 rgb8",
    "large": "1920×1080 rgb8",
    "jpeg": "1920×1080 JPEG",
    "cloud": "100,000 points",
    "map": "1000×1000 grid",
}


def main() -> None:
    report(int(sys.argv[1]) if sys.argv[1:] else ROUNDS)


def report(rounds: int) -> None:
    """Print everything. By itself, a camera delays small topics by 0.5 s with the defaults of Fast DDS."""
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        os.environ.setdefault(variable, str(bed.ROOT / "configs" / "fastdds-large-messages.xml"))
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_RUNTIME_DIR"] = name
        with running(Path(name)) as bridge:
            _print_costs(bridge)
        with running(Path(name), LINK) as bridge:
            _print_slow_link(bridge, rounds)


class Bridge:
    """Two sides, a robot on the client's, and a viewer on the server's."""

    def __init__(self, client: bed.Process, robot: bed.Process, engine: RemoteEngine) -> None:
        self.client = client
        self.robot = robot
        self.engine = engine

    def look(self, topic: str, rate: float, seconds: float, viewer: str) -> list[tuple[Viewed, float]]:
        """Look for some time; return the pictures, and how old each was when it came."""
        wish, seen = Wish(width=80, height=24, rate=rate, webp=True), []
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            viewed = self.engine.look(viewer, (topic,), wish).result(_WITHIN)
            if viewed is not None and viewed.picture.content is not None:
                seen.append((viewed, viewed.age or 0.0))
        return seen

    def cpu(self) -> tuple[float, float]:
        """Return the CPU time of the client's process, and of its drawing process, in s."""
        worker = _worker_of(self.client.pid)
        return _cpu(self.client.pid), 0.0 if worker is None else _cpu(worker)


@contextmanager
def running(folder: Path, bytes_per_second: float = 0.0) -> Iterator[Bridge]:
    """Start both sides, over a link that is limited if a rate is given."""
    port = bed.free_port()
    relay = SlowRelay(port, bytes_per_second or 1e9)
    with relay:
        _write_sessions(folder, port, relay.port)
        with (
            bed.Process("-m", "bench.look_robot") as robot,
            bed.headless(folder / "server.yaml", folder / "server.log"),
            bed.headless(folder / "client.yaml", folder / "client.log") as client,
        ):
            engine = RemoteEngine(_socket("look-server"), read_only=True)
            engine.start()
            try:
                _until(lambda: any(route.ledger.delivered for route in engine.snapshot().routes), folder)
                yield Bridge(client, robot, engine)
            finally:
                engine.stop()


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
        "topics:\n  - {topic: /steady, direction: transmit, protocol: tcp}\n"
    )


def _worker_of(pid: int) -> int | None:
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        if _WORKER in Path(f"/proc/{child}/cmdline").read_text():
            return int(child)
    return next((int(c) for c in _children(pid) if _WORKER in Path(f"/proc/{c}/cmdline").read_text()), None)


def _children(pid: int) -> list[str]:
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += (task / "children").read_text().split()
    return found


def _cpu(pid: int) -> float:
    return sum(thread.cpu for thread in _threads(pid).values())


def _print_costs(bridge: Bridge) -> None:
    time.sleep(5.0)
    idle = _idle(bridge)
    print(
        "pictures of 80×24 cells; CPU in ms a picture of the client's bridge (with the subscription) and of the drawing"
    )
    print(f"{'':<20}{'bridge':>10}{'drawing':>10}{'bytes':>10}{'first, s':>10}{'next, s':>10}{'age, s':>10}")
    for topic, about in KINDS.items():
        bridge.robot.tell(topic)
        time.sleep(IDLE_SECONDS + 3.0 if topic == "camera" else 1.0)
        began = time.monotonic()
        bridge.look(f"/{topic}", _VIEW_RATE, 0.01, topic)
        first = time.monotonic() - began
        began = time.monotonic()
        bridge.look(f"/{topic}", _VIEW_RATE, 0.01, f"{topic}2")
        warm = time.monotonic() - began
        before = bridge.cpu()
        seen = bridge.look(f"/{topic}", _VIEW_RATE, _DRAWS, topic)
        after = bridge.cpu()
        costs = [(b - a) / max(1, len(seen)) * 1e3 for a, b in zip(before, after, strict=True)]
        encoded = statistics.median(viewed.encoded for viewed, _ in seen) if seen else 0
        age = statistics.median(age for _, age in seen) if seen else 0.0
        print(
            f"{about:<20}{costs[0]:>10.1f}{costs[1]:>10.1f}{encoded:>10.0f}{first:>10.2f}{warm:>10.2f}{age:>10.2f}",
            flush=True,
        )
    bridge.robot.tell("none")
    time.sleep(IDLE_SECONDS + 8.0)
    print(f"idle client, CPU in % of a core: {idle:.2f} before any view, {_idle(bridge):.2f} after the last one")


def _idle(bridge: Bridge) -> float:
    before = sum(bridge.cpu())
    time.sleep(_IDLES)
    return (sum(bridge.cpu()) - before) / _IDLES * 100


def _print_slow_link(bridge: Bridge, rounds: int) -> None:
    bridge.robot.tell("camera")
    time.sleep(3.0)
    print(f"\na topic of {SIZE} B at {RATE:g} Hz over a link of {LINK // 1000} kB/s, without and with a view at 5 Hz")
    print(f"{'':<10}{'received':>10}{'p50, ms':>10}{'p99, ms':>10}{'pictures/s':>12}{'bytes':>8}{'age, s':>8}")
    for number in range(rounds):
        for with_view in (False, True):
            if with_view:  # opening a view costs once, and does not count here
                bridge.look("/camera", _VIEW_RATE, 3.0, f"slow{number}")
            bridge.robot.ask("steady")
            if with_view:
                seen = bridge.look("/camera", _VIEW_RATE, _TURN, f"slow{number}")
            else:
                seen = []
                time.sleep(_TURN)
            answer = bridge.robot.ask("steady")
            encoded = statistics.median(viewed.encoded for viewed, _ in seen) if seen else 0
            age = statistics.median(age for _, age in seen) if seen else 0.0
            name = "view" if with_view else "alone"
            print(
                f"{name:<10}{answer['received']:>9.1%} {answer['p50']:>9.1f} {answer['p99']:>9.1f} "
                f"{len(seen) / _TURN:>11.1f} {encoded:>7.0f} {age:>7.2f}",
                flush=True,
            )
            if with_view:
                time.sleep(8.0)


if __name__ == "__main__":
    main()

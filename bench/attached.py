"""Prints what an attached console costs: 500 topics that flow, a headless bridge, and consoles at 2 Hz on it."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed
from bench.console import OVER_SSH, Watched

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

TOPICS, SECONDS = 500, 20.0
IDLE = 0.05  # %


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["XDG_RUNTIME_DIR"] = name
        with (
            bed.Process("-m", "bench.many", str(bed.NEAR), str(TOPICS)),
            bed.headless(_session(folder, "server", bed.FAR, bed.free_port())),
            bed.headless(folder / "client.yaml") as bridge,
        ):
            _flowing()
            print(f"{TOPICS} topics at 1 Hz on a headless bridge; CPU in % of a core, {SECONDS:.0f} s each")
            print(
                f"{'consoles':>9} {'bridge':>7} {'its control thread':>19} {'each console':>13} {'sent kB/s each':>15}"
            )
            quiet = _measure(bridge, 0)
            for consoles in (0, 1, 0, 1, 0, 1, 5):
                now = _measure(bridge, consoles)
                # The thread that has nothing to do without a console. The whole process varies by more than it takes.
                control = max(now.threads.get(tid, 0.0) for tid, used in quiet.threads.items() if used < IDLE)
                print(
                    f"{consoles:>9} {sum(now.threads.values()):>7.1f} {control:>19.2f} {now.console:>13.1f}"
                    f" {now.written:>15.1f}"
                )


class Costs(NamedTuple):
    """CPU in % of a core: of the bridge by thread, and of each console; what each console writes, kB/s."""

    threads: dict[str, float]
    console: float
    written: float


def _session(folder: Path, role: str, domain: int, port: int) -> Path:
    write_key(folder / "bench.key")
    topics = tuple(Topic(f"/bench/topic_{number:03d}", "transmit") for number in range(TOPICS))
    common = {"name": "bench", "server_ip": "127.0.0.1", "server_port": port, "key_file": "bench.key"}
    save(Session(role="server", domain_id=domain, **common), folder / "server.yaml")  # type: ignore[arg-type]
    save(Session(role="client", domain_id=bed.NEAR, topics=topics, **common), folder / "client.yaml")  # type: ignore[arg-type]
    return folder / f"{role}.yaml"


def _flowing() -> None:
    command = ["wait", "--for", "flowing", f"/bench/topic_{TOPICS - 1:03d}", "--timeout", "60"]
    deadline = time.monotonic() + 120
    while os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-m", "rsb_console", *command, "--bridge", "bench-2"]):
        if time.monotonic() > deadline:
            raise SystemExit("nothing flows")


def _measure(bridge: bed.Process, count: int) -> Costs:
    consoles = [Watched("-m", "rsb_console", "attach", "bench-2", environ=OVER_SSH) for _ in range(count)]
    try:
        for each in consoles:
            each.until(lambda c=each: b"/bench/topic_" in c.terminal.output, 30.0)  # type: ignore[misc]
        time.sleep(3.0)
        threads, console, written = _threads(bridge.pid), *_of_all(consoles)
        time.sleep(SECONDS)
        threads_then, console_then, written_then = _threads(bridge.pid), *_of_all(consoles)
    finally:
        for each in consoles:
            each.stop()
    return Costs(
        {tid: 100 * (used - threads.get(tid, 0.0)) / SECONDS for tid, used in threads_then.items()},
        100 * (console_then - console) / SECONDS / max(1, count),
        (written_then - written) / SECONDS / 1e3 / max(1, count),
    )


def _threads(pid: int) -> dict[str, float]:
    """Processor time of each thread so far, s."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return {task.name: int((task / "schedstat").read_text().split()[0]) / 1e9 for task in tasks}


def _of_all(consoles: Sequence[Watched]) -> tuple[float, int]:
    return sum(each.cpu() for each in consoles), sum(each.written for each in consoles)


if __name__ == "__main__":
    main()

"""Prints what attached consoles cost: ``python -m bench.attached [ROUNDS]``, about ten minutes with three rounds.

First what one console adds to a headless bridge of 500 topics: each figure is the difference to the same bridge without
it, measured by turns. Then (`bench.attached_rates`) what consoles do to the messages that a bridge carries.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import attached_rates, bed
from bench.console import OVER_SSH, Watched

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

TOPICS, SECONDS, ROUNDS = 500, 15.0, 3
FIVE = 5
SETTLES = 3.0
AIM_CPU, AIM_LINE = 5.0, 25.0


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    print(f"load average {os.getloadavg()[0]:.1f}; CPU in % of a core\n")
    _costs(rounds)
    print()
    attached_rates.main(rounds)


def _costs(rounds: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Here, the user's own bridges are not seen: with one named `bench`, the client would not be `bench-2`.
        os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = name
        with (
            bed.Process("-m", "rsb_extras.bench.measured_stream", "many", str(bed.NEAR), "/bench/topic_", str(TOPICS)),
            bed.headless(_session(folder, "server", bed.FAR, bed.free_port())),
            bed.headless(folder / "client.yaml") as bridge,
        ):
            _flowing()
            print(f"{TOPICS} topics at 1 Hz on a headless bridge; consoles at 2 Hz; {rounds} x {SECONDS:.0f} s in turn")
            pairs = [(_measure(bridge, 0), _measure(bridge, 1)) for _ in range(rounds)]
            five = _measure(bridge, FIVE)
    ros = pairs[0][0].busiest
    bridge_alone = [none.without(ros) for none, _ in pairs]
    bridge_with = [one.without(ros) for _, one in pairs]
    added = [some - none for none, some in zip(bridge_alone, bridge_with, strict=True)]
    consoles = [one.console for _, one in pairs]
    _row("the bridge, without its ROS thread", added)
    _row("the console", consoles)
    both = [sum(parts) for parts in zip(added, consoles, strict=True)]
    _row("both", both, f"aim: at most {AIM_CPU:g}")
    _row("written to the terminal, kB/s", [one.written for _, one in pairs], f"aim: at most {AIM_LINE:g}")
    each = (five.without(ros) - statistics.median(bridge_alone)) / FIVE
    print(f"with {FIVE} consoles, each: the bridge {each:.2f}, the console {five.console:.2f}")


def _row(name: str, figures: Sequence[float], aim: str = "") -> None:
    ends = f"{min(figures):.2f} to {max(figures):.2f}"
    print(f"  {name:<36} {statistics.median(figures):>6.2f}   ({ends})  {aim}".rstrip(), flush=True)


class Costs(NamedTuple):
    """CPU in % of a core: of the bridge by thread, and of each console; what each console writes, kB/s."""

    threads: dict[str, float]
    console: float
    written: float

    @property
    def busiest(self) -> str:
        """The thread that waits for ROS. It does nothing for a console, and varies by more than one costs."""
        return max(self.threads, key=lambda tid: self.threads[tid])

    def without(self, thread: str) -> float:
        """Return the costs of all threads except one."""
        return sum(used for tid, used in self.threads.items() if tid != thread)


def _session(folder: Path, role: str, domain: int, port: int) -> Path:
    write_key(folder / "bench.key")
    topics = tuple(Topic(f"/bench/topic_{number:03d}", "transmit") for number in range(TOPICS))
    common = {"name": "bench", "server_ip": "127.0.0.1", "server_port": port, "key_file": "bench.key"}
    save(Session(role="server", domain_id=domain, **common), folder / "server.yaml")  # type: ignore[arg-type]
    save(Session(role="client", domain_id=bed.NEAR, topics=topics, **common), folder / "client.yaml")  # type: ignore[arg-type]
    return folder / f"{role}.yaml"


def _flowing() -> None:
    # Both sides have the name `bench`, and the client is the second one.
    waits = ["wait", "--for", "flowing", f"/bench/topic_{TOPICS - 1:03d}", "--timeout", "60", "--bridge", "bench-2"]
    deadline = time.monotonic() + 120
    # `wait` fails at once while the bridge does not run yet.
    while subprocess.run([sys.executable, "-m", "rsb_console", *waits], capture_output=True, check=False).returncode:
        if time.monotonic() > deadline:
            raise SystemExit("nothing flows")


def _measure(bridge: bed.Process, count: int) -> Costs:
    consoles = [Watched("-m", "rsb_console", "attach", "bench-2", environ=OVER_SSH) for _ in range(count)]
    try:
        for each in consoles:
            each.until(lambda c=each: b"/bench/topic_" in c.terminal.output, 30.0)  # type: ignore[misc]
        time.sleep(SETTLES)
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
    return sum(sum(_threads(each.pid).values()) for each in consoles), sum(each.written for each in consoles)


if __name__ == "__main__":
    main()

"""Prints what an attached console costs: 500 topics that flow, a headless bridge, and consoles at 2 Hz on it."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench import bed
from bench.console import OVER_SSH, Watched

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

TOPICS, SECONDS, ROUNDS = 500, 20.0, 3


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
            print(f"{TOPICS} topics at 1 Hz, headless; CPU in % of a core, {ROUNDS} x {SECONDS:.0f} s by turns")
            print(f"{'consoles':>9} {'bridge':>7} {'console':>8} {'added':>6} {'sent kB/s':>10}")
            alone = 0.0
            for _ in range(ROUNDS):
                for consoles in (0, 1):
                    used, theirs, sent = _measure(bridge, consoles)
                    alone = used if not consoles else alone
                    added = used - alone + theirs
                    print(f"{consoles:>9} {used:>7.1f} {theirs:>8.1f} {added:>6.1f} {sent:>10.1f}")


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


def _measure(bridge: bed.Process, count: int) -> tuple[float, float, float]:
    """CPU of the bridge and of the consoles, % of a core; what one console writes, kB/s."""
    consoles: Sequence[Watched] = [
        Watched("-m", "rsb_console", "attach", "bench-2", environ=OVER_SSH) for _ in range(count)
    ]
    try:
        for console in consoles:
            console.until(lambda c=console: b"/bench/topic_" in c.terminal.output, 30.0)  # type: ignore[misc]
        time.sleep(3.0)
        before = bridge.cpu(), sum(each.cpu() for each in consoles), sum(each.written for each in consoles)
        time.sleep(SECONDS)
        after = bridge.cpu(), sum(each.cpu() for each in consoles), sum(each.written for each in consoles)
    finally:
        for console in consoles:
            console.stop()
    used, theirs, written = (b - a for a, b in zip(before, after, strict=True))
    return 100 * used / SECONDS, 100 * theirs / SECONDS, written / SECONDS / 1e3 / max(1, count)


if __name__ == "__main__":
    main()

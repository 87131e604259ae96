"""Prints how fast the console answers keys while a view is open, in 1.5 min: ``python -m`` and this module's name.

The console runs the demo in a terminal of 120×36 and shows the camera of its robot (10 Hz) as pictures at the printed
rate. Keys that zoom come 30 times a second, as a keyboard repeats them. Every half second another key holds the picture
or goes on, and the time until the title shows it is taken. The first line is of the main screen, cursor and help.
"""

from __future__ import annotations

import statistics
import threading
import time
from typing import TYPE_CHECKING

from bench.console import Watched

if TYPE_CHECKING:
    from collections.abc import Callable

KEYS_A_SECOND, SECONDS = 30.0, 15.0
_RATES = (2.0, 5.0, 10.0)
_WITHIN = 60.0


def main() -> None:
    """Print a line for each rate."""
    console = Watched("-m", "rsb_console", "demo", environ={"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    try:
        console.until(lambda: b"/odom" in console.terminal.output, _WITHIN)
        print(f"{'pictures':>9} {'CPU of a core':>14} {'sent':>10} {'key p50':>8} {'key worst':>10}")
        _print(console, "none", "jk", ("?", b"Next line"), ("q", b"STATE"))
        console.terminal.type("V")
        console.until(lambda: b"type to search" in console.terminal.output, _WITHIN)
        console.terminal.type("camera")
        console.until(lambda: b"/camera/image_raw" in console.terminal.output, _WITHIN)
        time.sleep(1.0)
        console.terminal.type("\r")
        console.until(lambda: b"drawn by" in console.terminal.output, _WITHIN)
        for rate in _RATES:
            if rate != _RATES[0]:
                console.terminal.type(">")
            time.sleep(1.0)
            _print(console, f"{rate:g} Hz", "+-", (" ", b"HELD"), (" ", b"drawn by"))
    finally:
        console.stop()


def _print(console: Watched, name: str, keys: str, *asked: tuple[str, bytes]) -> None:
    ended = threading.Event()
    typist = threading.Thread(target=_type, args=(console, keys, ended))
    typist.start()
    try:
        cpu, written, began = console.cpu(), console.written, time.monotonic()
        took: list[float] = []
        # The number of keys is even, so that the picture goes on again at the end.
        while time.monotonic() - began < SECONDS or len(took) % len(asked):
            key, word = asked[len(took) % len(asked)]
            time.sleep(0.5)
            mark = console.written
            console.terminal.type(key)
            took.append(console.until(_shows(console, mark, word), _WITHIN))
        seconds = time.monotonic() - began
        cpu, written = console.cpu() - cpu, console.written - written
    finally:
        ended.set()
        typist.join()
    print(
        f"{name:>9} {100 * cpu / seconds:>12.1f} % {written / seconds / 1e3:>5.1f} kB/s"
        f" {1e3 * statistics.median(took):>5.0f} ms {1e3 * max(took):>7.0f} ms"
    )


def _shows(console: Watched, mark: int, word: bytes) -> Callable[[], bool]:
    return lambda: word in console.terminal.output[mark:]


def _type(console: Watched, keys: str, ended: threading.Event) -> None:
    number = 0
    while not ended.wait(1 / KEYS_A_SECOND):
        console.terminal.type(keys[number % len(keys)])
        number += 1


if __name__ == "__main__":
    main()

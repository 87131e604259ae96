#!/usr/bin/env bash
# Textual's one-shot timer may never call.
#
# textual 8.2.8, from PyPI; earlier ones were not tried. `set_timer(delay, callback)` calls a function after a delay. If
# the process gets no processor for longer than that between the beginning of the timer's task and its first look at the
# clock, the timer takes its only call for one that is missed, skips it, and ends; nothing is logged. (`Timer._run` counts
# a skipped call against `repeat`, and `set_timer` leaves `skip` at its default, True.) asyncio's `call_later` calls.
# Here the timers' clock sleeps when that timer looks at it, so no luck is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple textual==8.2.8

cat >program.py <<'PYTHON'
import asyncio
import time
from importlib.metadata import version

from textual import timer
from textual.app import App

DELAY = 0.05


class OneShot(App[None]):
    called = False
    called_by_asyncio = False

    def begin(self) -> None:
        self.called = self.called_by_asyncio = False
        self.set_timer(DELAY, self.take_call, name="once")
        asyncio.get_running_loop().call_later(DELAY, self.take_asyncio_call)

    def take_call(self) -> None:
        self.called = True

    def take_asyncio_call(self) -> None:
        self.called_by_asyncio = True


class Clock:
    """The clock of Textual's timers, at whose looks the process may stand still."""

    stands_still = False

    def get_time(self) -> float:
        if self.stands_still and asyncio.current_task().get_name() == "once":
            time.sleep(2 * DELAY)
        return time.monotonic()


async def look(stands_still: bool) -> str:
    clock = timer._time = Clock()
    app = OneShot()
    async with app.run_test() as pilot:
        await pilot.pause()
        clock.stands_still = stands_still
        app.begin()
        await asyncio.sleep(20 * DELAY)
        return f"set_timer {app.called}, call_later {app.called_by_asyncio}"


print("textual", version("textual"))
print("called while the process runs:", asyncio.run(look(False)))
print("called if it stands still as the timer begins:", asyncio.run(look(True)))
PYTHON
cat >expected <<'TEXT'
textual 8.2.8
called while the process runs: set_timer True, call_later True
called if it stands still as the timer begins: set_timer False, call_later True
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }

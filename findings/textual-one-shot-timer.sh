#!/bin/sh
# Textual's one-shot timer may never call.
#
# What surprises: `set_timer(delay, callback)` says "call a function after a delay". If the event loop stands still for
# longer than the delay between the moment the timer's task begins and its first look at the clock, or the process gets
# no processor for so long, the timer takes its only call for one that is missed, skips it, and ends. Nothing is logged.
# (Timer._run counts the skipped one against `repeat`, and `set_timer` leaves `skip` at its default, True.)
# asyncio's `call_later` calls in the same place.
#
# Version: textual 8.2.8, the one in locks/run.txt. Since when seen: 2026-11, in 8.2.8; earlier ones were not tried.
# Here the timers' clock sleeps whenever that timer looks at it, as a process does that gets no processor there: no luck
# needed.
#
# Exits 0 while the behaviour is so, and 1 once it has changed or could not be looked at.
set -eu

version=$(sed -n 's/^textual==\([^ ]*\).*/\1/p' "$(dirname "$0")/../locks/run.txt")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv" || exit 1
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check "textual==$version" || exit 1

cat > "$folder/seen.py" <<'PROGRAM'
import asyncio
import sys
import time
from importlib.metadata import version

from textual import timer
from textual.app import App

DELAY = 0.05


class OneShot(App[None]):
    called = False
    called_by_asyncio = False

    def on_mount(self) -> None:
        self.set_timer(DELAY, self.take_call, name="once")
        asyncio.get_running_loop().call_later(DELAY, self.take_asyncio_call)

    def take_call(self) -> None:
        self.called = True

    def take_asyncio_call(self) -> None:
        self.called_by_asyncio = True


class Standing:
    """The clock of Textual's timers, at whose looks the process may stand still."""

    stands_still = False

    def get_time(self) -> float:
        if self.stands_still and asyncio.current_task().get_name() == "once":
            time.sleep(2 * DELAY)
        return time.monotonic()


async def look(stands_still: bool) -> tuple[bool, bool]:
    clock = timer._time = Standing()
    app = OneShot()
    async with app.run_test() as pilot:
        await pilot.pause()
        app.called = app.called_by_asyncio = False
        clock.stands_still = stands_still
        app.on_mount()
        await asyncio.sleep(20 * DELAY)
        return app.called, app.called_by_asyncio


usual, stood = asyncio.run(look(False)), asyncio.run(look(True))
print(f"textual {version('textual')}, Python {sys.version.split()[0]}")
print(f"loop runs: set_timer called {usual[0]}, call_later called {usual[1]}")
print(f"process stands still for {2 * DELAY} s as a timer of {DELAY} s begins: "
      f"set_timer called {stood[0]}, call_later called {stood[1]}")
sys.exit(0 if usual == (True, True) and stood == (False, True) else 1)
PROGRAM
"$folder/venv/bin/python" "$folder/seen.py" || exit 1

#!/usr/bin/env bash
# A Textual worker that ends before it begins leaves its coroutine never awaited.
#
# textual 8.2.8, from PyPI; earlier ones were not tried. `run_worker` takes a coroutine, and its documentation's examples
# give it one. If the worker is cancelled before the event loop has run its task, as by a second one of an exclusive group
# or by the program's end, nobody awaits that coroutine or closes it: Python warns, at whatever runs when it is collected.
# Given a function, as `textual.work` does, the worker has not called it by then, and nothing is left.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple textual==8.2.8

cat >program.py <<'PYTHON'
import asyncio
import gc
import warnings
from importlib.metadata import version

from textual import work
from textual.app import App


class Asking(App[None]):
    asked = 0

    async def ask(self) -> None:
        self.asked += 1

    def by_coroutine(self) -> None:
        self.run_worker(self.ask(), group="asking", exclusive=True)

    def by_function(self) -> None:
        self.run_worker(self.ask, group="asking", exclusive=True)

    @work(group="asking", exclusive=True)
    async def by_decorator(self) -> None:
        self.asked += 1


async def ask_twice(how: str) -> int:
    app = Asking()
    async with app.run_test() as pilot:
        getattr(app, how)()
        getattr(app, how)()
        await pilot.pause(0.2)
        return app.asked


print("textual", version("textual"))
for how in ("by_coroutine", "by_function", "by_decorator"):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        asked = asyncio.run(ask_twice(how))
        gc.collect()
    told = sorted(str(each.message) for each in seen if each.category is RuntimeWarning)
    print(f"{how}: asked {asked} of 2 times, {told}")
PYTHON
cat >expected <<'TEXT'
textual 8.2.8
by_coroutine: asked 1 of 2 times, ["coroutine 'Asking.ask' was never awaited"]
by_function: asked 1 of 2 times, []
by_decorator: asked 1 of 2 times, []
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }

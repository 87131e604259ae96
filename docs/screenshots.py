"""Takes the pictures of the console on the running demos: ``make screenshots``, or those that are named.

SVG needs no terminal: the script's own has 24-bit colours, wherever it runs. PNG are windows of real terminals
(`docs.real_terminals`).
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Awaitable
from html import unescape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.snapshot import State
from rsb_bridge.route import lease
from rsb_console.app import ConsoleApp
from rsb_console.notation.glyphs import STATE_SIGN

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from textual.pilot import Pilot

    Take = Callable[["Album"], Coroutine[Any, Any, None]]

ROOT = Path(__file__).parents[1]
TERMINAL = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
FLOWING = 9  # topics of the demo, its service, and its robot's parameters
DEMOS = 5  # that are begun until one drops nothing
HISTORY = 60  # s: long enough for a curve to be worth a picture
FAULTS_OF_BUSY_MACHINES = {STATE_SIGN[state] for state in (State.SLOW, State.LATE, State.STALE, State.DOWN)}
WIDE, NARROW, LOW = (120, 36), (80, 24), (120, 24)


class Album:
    """The folder of the pictures.

    Args:
        config: a folder for the settings that the console writes.
    """

    def __init__(self, folder: Path, config: Path) -> None:
        self.folder, self.config = folder, config

    async def take(self, pilot: Pilot[Any], name: str, *keys: str, when: Callable[[str], bool]) -> None:
        """Press `keys`, and keep the picture once its words are as they should be."""
        await pilot.press(*keys)
        picture = ""

        def as_meant() -> bool:
            nonlocal picture
            picture = pilot.app.export_screenshot()
            return when(words_of(picture))

        await pilot.pause(1.0)
        await until(as_meant, pilot)
        self.keep(name, picture)

    def keep(self, name: str, picture: str) -> None:
        (self.folder / f"{name}.svg").write_text(picture, encoding="utf-8")


def words_of(picture: str) -> str:
    return unescape(picture).replace("\xa0", " ")


async def until(condition: Callable[[], bool | Awaitable[bool]], pilot: Pilot[Any], seconds: float = 180.0) -> None:
    """Wait for it.

    Raises:
        SystemExit: it does not come; the message has the screen.
    """
    deadline = time.monotonic() + seconds
    while not (await found if isinstance(found := condition(), Awaitable) else found):
        if time.monotonic() > deadline:
            lines = pilot.app.screen._compositor.render_strips()  # Textual's picture has no lines
            screen = "\n".join(line.text.rstrip() for line in lines)
            raise SystemExit(f"the demo does not do what the pictures want:\n{screen}")
        await pilot.pause(0.2)


def states(app: ConsoleApp) -> list[str]:
    """How the topics are."""
    return [route.state.value for route in app.snapshot().routes]


async def leave(app: ConsoleApp, pilot: Pilot[Any]) -> None:
    """Close the dialog; the next key is not for it."""
    await pilot.press("escape")
    await until(lambda: app.screen is app.main, pilot)


class DroppedError(Exception):
    """Messages were dropped: the demo counts them to its end."""


async def of_a_robot(album: Album) -> None:
    """Those of the demo, which begins anew when a busy machine has dropped messages.

    Raises:
        SystemExit: each demo has dropped some.
    """
    for _ in range(DEMOS):
        try:
            await of_one_demo(album)
        except DroppedError:
            continue
        return
    raise SystemExit(f"{DEMOS} demos have dropped messages: take the pictures while the machine is less busy")


async def of_one_demo(album: Album) -> None:
    """Take them of a demo.

    Raises:
        DroppedError: not all of them were taken.
    """
    from rsb_extras.demo.demo_session import running_demo  # noqa: PLC0415 (a feature)

    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=album.config)

        def check_drops() -> None:
            if any(route.ledger.lost for route in app.snapshot().routes):
                raise DroppedError

        def flows() -> bool:
            check_drops()
            return states(app).count("ok") == FLOWING and len(app.snapshot().routes[0].history) > HISTORY

        def shows(*texts: str) -> Callable[[str], bool]:
            def as_meant(words: str) -> bool:
                check_drops()
                return all(text in words for text in texts) and not FAULTS_OF_BUSY_MACHINES.intersection(words)

            return as_meant

        try:
            async with app.run_test(size=WIDE) as pilot:
                await until(flows, pilot)
                demo.robot.mute("/scan")  # the one fault of the pictures, which the lines at the top explain
                await until(lambda: "stopped" in states(app), pilot)
                # The cursor stays on its topic when the table puts the fault on top.
                await until(lambda: app.main.topics.listed[0].topic == "/scan", pilot)
                await album.take(pilot, "main", "g", when=shows("STOPPED"))
                await album.take(pilot, "add-topic", "a", when=shows("/battery_state"))
                await leave(app, pilot)
                await album.take(pilot, "help", "question_mark", when=shows("Next line"))
                await leave(app, pilot)
                await pilot.press("slash", *"set_light", "enter", "C")
                await until(lambda: "data" in app.screen.form.values.get("request", ""), pilot)  # type: ignore[attr-defined]
                await pilot.press("f9", "y")
                await album.take(pilot, "call", when=shows("success: true"))
                await leave(app, pilot)
                await album.take(pilot, "service", when=shows("1 of 10"))
                await pilot.press("escape", "g")
                app.theme = "light"
                await album.take(pilot, "light", when=shows("STOPPED"))
                app.theme = "dark"
                await pilot.resize_terminal(*NARROW)
                await album.take(pilot, "narrow", when=shows("STOPPED"))
                await album.take(pilot, "detail", "enter", when=shows("Ledger"))
        finally:
            await asyncio.to_thread(app.stop)


PARTS = {"robot": of_a_robot}


def parts() -> dict[str, tuple[Path, Take]]:
    """Return the folder of the pictures of each part, and what takes them: of this script, and of features'."""
    found: dict[str, tuple[Path, Take]] = {name: (ROOT / "docs/pictures", take) for name, take in PARTS.items()}
    sys.path.insert(0, str(ROOT))
    for script in ROOT.glob("extras/rsb_extras/*/docs/*.py"):
        module = ".".join(script.relative_to(ROOT / "extras").with_suffix("").parts)
        found |= {name: (script.parent / "pictures", take) for name, take in import_module(module).PARTS.items()}
    return found


def problem_inside(take: Any, folder: Path) -> str:
    """Take a part's pictures of the terminal that this process runs in. Return the problem, or an empty string."""
    with tempfile.TemporaryDirectory() as config:
        try:
            asyncio.run(take.inside(Album(folder, Path(config))))
        except BaseException:  # noqa: BLE001 -- the terminal closes, and nobody reads it
            return traceback.format_exc()
    return ""


def main() -> None:
    """Take the pictures that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    known = parts()
    parser.add_argument("parts", nargs="*", metavar="PART", choices=[*known, []], help=f"of {', '.join(known)}")
    parser.add_argument("--folder", type=Path, help="instead of those of the documentation")
    parser.add_argument("--inside", type=Path, metavar="REPORT", help=argparse.SUPPRESS)  # in the terminal of a picture
    arguments = parser.parse_args()
    # This process draws, drives and bridges: on a busy machine it may stand still for more than a lease's second.
    lease.LASTS = lease.SLOW = 5.0
    if arguments.inside is not None:
        arguments.inside.write_text(problem_inside(known[arguments.parts[0]][1], arguments.folder), encoding="utf-8")
        return
    os.environ.pop("NO_COLOR", None)
    os.environ |= TERMINAL
    for part in arguments.parts or known:
        folder, take = known[part]
        with tempfile.TemporaryDirectory() as config:
            asyncio.run(take(Album(arguments.folder or folder, Path(config))))


if __name__ == "__main__":
    main()

"""Pictures of the console in real terminals, kitty and xterm, on a screen in memory (Xvfb).

The console runs inside the terminal, where a pilot presses its keys. It takes the terminal's window once the console is
as the picture wants it.
"""

from __future__ import annotations

import asyncio
import io
import os
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any

from docs.screenshots import FLOWING, Album, states, until

from rsb_console.app import ConsoleApp
from rsb_console.terminal.driver import terminal_to_itself
from rsb_console.terminal_app import output_path

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Sequence

    from PIL.Image import Image
    from textual.pilot import Pilot

    Show = Callable[["Camera", ConsoleApp, Pilot[Any]], Awaitable[None]]

SCRIPT = Path(__file__).with_name("screenshots.py")
PACKAGES = {"Xvfb": "xvfb", "kitty": "kitty", "xterm": "xterm", "import": "imagemagick", "fc-list": "fonts-dejavu-core"}
"""Debian's and Ubuntu's packages of the programs, and of the font."""
FONT = "DejaVu Sans Mono"
PAPER = "#121212"
"""The background of the terminal, which has rows and columns of pixels beside its characters: the dark theme's."""
SCREEN = "2000x1200x24"
WITHIN = 420
"""s for a picture. The demo takes 20 of them on an idle machine, and driving some more."""
COLOURFUL = 150
"""Colours at least of a view into a room of the demo, in sixels of 256 colours. One of a wall has fewer."""
MOST_BYTES = 250_000
"""Of a picture in the documentation."""
OF_OTHER_TERMINALS = ("TMUX", "COLORTERM", "TERM_PROGRAM", "SSH_CONNECTION", "SSH_TTY", "NO_COLOR", "WAYLAND_DISPLAY")
"""Variables of the terminal that this script was started in."""


def kitty(columns: int, rows: int, *, font_size: int = 10) -> tuple[str, ...]:
    """Return the command of a terminal with kitty's graphics protocol."""
    settings = {
        "initial_window_width": f"{columns}c",
        "initial_window_height": f"{rows}c",
        "remember_window_size": "no",
        "font_family": FONT,
        "font_size": str(font_size),
        "update_check_interval": "0",
        "confirm_os_window_close": "0",
        "background": PAPER,
    }
    return "kitty", "--config", "NONE", *(part for item in settings.items() for part in ("-o", "=".join(item)))


def xterm(columns: int, rows: int, *options: str, font_size: int = 10) -> tuple[str, ...]:
    """Return the command of a terminal with 256 colours, and with sixels if the options say so."""
    font = ("-fa", FONT, "-fs", str(font_size), "-bg", PAPER, "-fg", "white")
    return "xterm", "-geometry", f"{columns}x{rows}+0+0", *font, "+sb", *options, "-e"


SIXEL = ("-ti", "vt340", "-xrm", "XTerm*numColorRegisters: 256")
"""Options of an xterm that shows sixels."""


@dataclass(frozen=True)
class InTerminal:
    """A part of `docs.screenshots.PARTS`: pictures of the demo in a terminal's window.

    Attributes:
        part: its name.
        terminal: the command that runs a command in the terminal.
        show: presses keys, and takes the pictures. It runs inside the terminal.
        settings: the console's console.yaml.
    """

    part: str
    terminal: Sequence[str]
    show: Show
    settings: str = ""

    async def __call__(self, album: Album) -> None:
        """Run `inside` in the terminal."""
        if absent := missing(self.terminal[0]):
            packages = " ".join(PACKAGES[each] for each in absent)
            sys.stderr.write(f"no picture of {self.part}: {', '.join(absent)} missing: apt install {packages}\n")
        elif problem := await asyncio.to_thread(self._run, album.folder):
            raise SystemExit(f"{self.part}: {problem}")

    def _run(self, folder: Path) -> str:
        """Run the terminal until its pictures are taken. Return the problem, or an empty string."""
        with tempfile.TemporaryDirectory() as name, screen() as display:
            report = Path(name, "report")  # a terminal does not tell how its command ended
            script: tuple[str | Path, ...] = (
                sys.executable,
                "-P",
                SCRIPT,
                self.part,
                "--folder",
                folder,
                "--inside",
                report,
            )
            kept = {name: value for name, value in os.environ.items() if name not in OF_OTHER_TERMINALS}
            environment = {**kept, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
            subprocess.run(
                (*self.terminal, *script), env=environment, stdin=subprocess.DEVNULL, timeout=WITHIN, check=True
            )
            return report.read_text(encoding="utf-8") if report.exists() else "the terminal did not start"

    async def inside(self, album: Album) -> None:
        """Show the demo in this terminal, and take the pictures."""
        (album.config / "console.yaml").write_text(self.settings, encoding="utf-8")
        from rsb_extras.demo.demo_session import running_demo  # noqa: PLC0415 (a feature)

        with running_demo() as demo:
            app = ConsoleApp(demo.session, demo.path, theme="dark", config=album.config)
            failed: list[BaseException] = []

            async def show(pilot: Pilot[Any]) -> None:
                try:
                    await until(lambda: states(app).count("ok") >= FLOWING // 2, pilot)  # the rest may be slow
                    await self.show(Camera(album.folder, app), app, pilot)
                except BaseException as error:  # noqa: BLE001 -- raised below, once the terminal is as it was
                    failed.append(error)
                app.exit()

            try:
                with terminal_to_itself(output_path()) as app.terminal:
                    await app.run_async(auto_pilot=show)
            finally:
                await asyncio.to_thread(app.stop)
            for error in failed:
                raise error


def missing(terminal: str) -> list[str]:
    """Return the programs that are missing for pictures of a terminal."""
    absent = [each for each in ("Xvfb", terminal, "import", "fc-list") if which(each) is None]
    if absent:
        return absent
    fonts = subprocess.run(("fc-list", FONT), capture_output=True, text=True, check=False).stdout
    return [] if fonts else ["fc-list"]


@contextmanager
def screen() -> Iterator[str]:
    """Run a screen in memory, and yield its DISPLAY, which Xvfb chooses."""
    reading, writing = os.pipe()
    command = ("Xvfb", "-displayfd", str(writing), "-screen", "0", SCREEN, "-nolisten", "tcp", "-noreset")
    with subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        try:
            with os.fdopen(reading, encoding="ascii") as number:
                if not (found := number.readline().strip()):
                    raise SystemExit("Xvfb does not start")
                yield f":{found}"
        finally:
            server.terminate()


class Camera:
    """Takes the window of the terminal that this process runs in."""

    def __init__(self, folder: Path, app: ConsoleApp) -> None:
        self._folder, self._app = folder, app

    async def photograph(
        self,
        pilot: Pilot[Any],
        name: str,
        *,
        when: Callable[[], bool | Awaitable[bool]],
        good: Callable[[Image], bool] = lambda _: True,
    ) -> None:
        """Keep the first good picture of the window that shows the console as it is when `when` is true."""

        async def taken() -> bool:
            found = when()
            if not (await found if not isinstance(found, bool) else found):
                return False
            if not self._app.writer.is_free:
                return False
            before, picture = await asyncio.to_thread(window), await asyncio.to_thread(window)
            # An image that has just been replaced in part is none.
            if not good(picture) or upper_left(before).tobytes() != upper_left(picture).tobytes():
                return False
            data = await asyncio.to_thread(small, picture)
            (self._folder / f"{name}.png").write_bytes(data)
            return True

        await until(taken, pilot)


def window() -> Image:
    from PIL import Image  # noqa: PLC0415 -- the rest works without

    command = ("import", "-silent", "-window", os.environ["WINDOWID"], "png:-")
    taken = subprocess.run(command, capture_output=True, timeout=30, check=True)
    return Image.open(io.BytesIO(taken.stdout)).convert("RGB")


def colours(picture: Image, *, most: int = 1 << 16) -> int:
    """Return how many different colours a picture has."""
    found = picture.getcolors(most)
    return most if found is None else len(found)


def upper_left(picture: Image) -> Image:
    """Return a part of the first tile, below its title."""
    width, height = picture.size
    return picture.crop((round(0.02 * width), round(0.04 * height), round(0.25 * width), round(0.45 * height)))


def is_whole(picture: Image) -> bool:
    """Whether the image that begins in the window's upper left corner lacks no row, and is in pixels."""
    left, top, right, bottom = (
        round(part * side) for part, side in zip((0.02, 0.04, 0.25, 0.45), picture.size * 2, strict=True)
    )
    view = picture.crop((left, top, right, bottom))
    rows = (view.crop((0, y, view.width, y + 1)) for y in range(view.height))
    return colours(view) > COLOURFUL and all(colours(row) > 1 for row in rows)


def small(picture: Image) -> bytes:
    """Return a picture as PNG, with a palette if it takes too many bytes without."""
    from PIL import Image  # noqa: PLC0415 -- as above

    full = png(picture)
    if len(full) <= MOST_BYTES:
        return full
    for dither in (Image.Dither.FLOYDSTEINBERG, Image.Dither.NONE):
        palette = picture.quantize(256, Image.Quantize.MEDIANCUT, kmeans=1)
        data = png(picture.quantize(palette=palette, dither=dither))
        if len(data) <= MOST_BYTES:
            return data
    return png(picture.quantize(64, Image.Quantize.MEDIANCUT, kmeans=1))


def png(picture: Image) -> bytes:
    file = io.BytesIO()
    picture.save(file, "png", optimize=True)
    return file.getvalue()

"""Prints how much photographs in terminals differ from themselves, beside those of chafa: ``python -m``, and files.

Each terminal runs under Xvfb, shows each photograph as ``look`` draws it and as chafa does, in the same cells, and its
window is taken. The error is the mean distance in Oklab, times 100, after a blur of half a cell's width in light: so
far the eye mixes neighbours. Chafa draws palettes twice, as it does by itself and with errors diffused (``--dither
diffusion -p off``), and the better one counts. Needs Xvfb, ImageMagick, chafa and the terminals; those that are
missing are left out.
"""

from __future__ import annotations

import argparse
import fcntl
import io
import math
import os
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
import time
import tty
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from PIL import Image

from rsb_console.terminal.terminal_facts import TRUE_COLOUR, TerminalFacts
from rsb_extras.pictures.blocks import image_rows, wished_pixels
from rsb_extras.pictures.graphics import bands_of, frame_of
from rsb_extras.pictures.look_command import _encoded
from rsb_extras.pictures.picture import MOST_ACROSS, MOST_DOWN, Pixels, Wish, encode_picture

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    Array = np.ndarray[Any, Any]

_FONT = "DejaVu Sans Mono"
_WITHIN = 60.0  # s
_SCREEN = 1000, 800
_LINE = 2
"""Rows that the picture leaves free."""


class Way(NamedTuple):
    """A way to show images on one terminal.

    Attributes:
        colours: of blocks, or 0 for pixels.
        pixels: the protocol, or empty for blocks.
        sextants: whether blocks of Unicode 13 are used.
    """

    colours: int = 0
    pixels: str = ""
    sextants: bool = False

    @property
    def name(self) -> str:
        colours = "true colour" if self.colours == TRUE_COLOUR else f"{self.colours} colours"
        return f"{self.pixels} pixels" if self.pixels else colours


class Terminal(NamedTuple):
    name: str
    command: tuple[str, ...]
    ways: tuple[Way, ...]


_XTERM = ("xterm", "-fa", _FONT, "-fs", "10", "-b", "0", "-bw", "0", "+sb", "-bg", "black", "-fg", "grey", "-geometry")
_SIZE = "110x40+0+0"
_TRUE = Way(TRUE_COLOUR)
TERMINALS = (
    Terminal("xterm", (*_XTERM, _SIZE, "-e"), (Way(16), Way(256), _TRUE)),
    Terminal(
        "xterm -ti vt340",
        ("xterm", "-ti", "vt340", "-xrm", "XTerm*numColorRegisters: 256", *_XTERM[1:], _SIZE, "-e"),
        (Way(pixels="sixel"),),
    ),
    Terminal(
        "kitty",
        (
            "kitty", "--config", "NONE", "-o", "font_size=10", "-o", f"font_family={_FONT}",
            "-o", "initial_window_width=110c", "-o", "initial_window_height=40c", "-o", "remember_window_size=no",
            "-o", "window_padding_width=0", "-o", "background=#000000",
        ),
        (Way(pixels="kitty"), Way(TRUE_COLOUR, sextants=True), Way(256, sextants=True)),
    ),
    Terminal(
        "urxvt",
        ("urxvt", "-fn", f"xft:{_FONT}:size=10", "-b", "0", "-w", "0", "+sb", "-bg", "black", "-geometry", _SIZE, "-e"),
        (Way(16), Way(256)),
    ),
    Terminal(
        "tmux in xterm", (*_XTERM, _SIZE, "-e", "tmux", "-u", "-L", "{socket}", "-f", "/dev/null", "new"), (Way(256),)
    ),
)  # fmt: skip


# -- in the terminal --------------------------------------------------------------------------------------------------


def show(asked: Path, done: Path) -> None:
    """Show the files whose names come through a pipe, and tell when the terminal has taken each."""
    tty.setcbreak(0)
    rows, columns, width, height = struct.unpack("4H", fcntl.ioctl(0, termios.TIOCGWINSZ, bytes(8)))
    done.write_text(f"{columns} {rows} {width} {height}\n")
    for line in asked.open():
        sys.stdout.buffer.write(b"\x1b[m\x1b[2J\x1b[3J\x1b[H\x1b[?25l" + Path(line.strip()).read_bytes() + b"\x1b[c")
        sys.stdout.buffer.flush()
        answer = b""
        while not answer.endswith(b"c") and select.select([0], [], [], _WITHIN)[0]:
            answer += os.read(0, 100)
        done.write_text("shown\n")


class Window:
    """A terminal's window on a display of its own.

    Attributes:
        cell: pixels of a cell in width and height.
    """

    def __init__(self, terminal: Terminal, folder: Path, display: str) -> None:
        self._display = display
        self._folder = folder
        self._asked, self._done = folder / "asked", folder / "done"
        for pipe in (self._asked, self._done):
            os.mkfifo(pipe)
        script = [sys.executable, "-m", __spec__.name, "--show", str(self._asked), str(self._done)]
        command = [each.format(socket=folder.name) for each in terminal.command] + script
        environ = {**os.environ, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
        environ.pop("TMUX", None)
        self.process = subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL, start_new_session=True)
        columns, rows, width, height = map(int, self._answer().split())
        self.columns, self.rows = columns, rows
        self.cell = width // columns, height // rows
        self._pipe = self._asked.open("w", buffering=1)

    def _answer(self) -> str:
        # Opened without waiting, since a terminal that ends would never open the other end.
        with os.fdopen(os.open(self._done, os.O_RDONLY | os.O_NONBLOCK)) as pipe:
            if not select.select([pipe], [], [], _WITHIN)[0]:
                raise TimeoutError(f"the terminal does not answer within {_WITHIN:g} s")
            text, deadline = "", time.monotonic() + _WITHIN
            while not text.endswith("\n") and time.monotonic() < deadline:
                text += pipe.read() or ""
            return text

    def shown(self, data: bytes) -> Array:
        """Return what the window shows after some output, when it changes no more."""
        file = self._folder / "data"
        file.write_bytes(data)
        print(file, file=self._pipe)
        self._answer()
        before, deadline = b"", time.monotonic() + _WITHIN
        while (taken := self._taken()) != before and time.monotonic() < deadline:
            before = taken
        return np.asarray(Image.open(io.BytesIO(taken)).convert("RGB"))

    def _taken(self) -> bytes:
        command = ["import", "-display", self._display, "-window", "root", "-depth", "8", "ppm:-"]
        return subprocess.run(command, capture_output=True, check=True, timeout=_WITHIN).stdout

    def close(self) -> None:
        self._pipe.close()
        self.process.terminate()
        self.process.wait(_WITHIN)


@contextmanager
def _display() -> Iterator[str]:
    """Run an X server, and give its name."""
    read, write = os.pipe()
    size = f"{_SCREEN[0]}x{_SCREEN[1]}x24"
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", size, "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as answer:
            yield f":{answer.readline().strip()}"
    finally:
        server.terminate()
        server.wait(_WITHIN)


# -- pictures ---------------------------------------------------------------------------------------------------------


def ours(photo: Image.Image, way: Way, window: Window) -> tuple[bytes, int, tuple[int, int], tuple[float, float]]:
    """Return our output, the bytes that cross a link for it, and its size in whole cells, and exactly."""
    # urxvt, which is setgid, leaves its programs no LD_LIBRARY_PATH, so that those in it find no ROS.
    from sensor_msgs.msg import Image as ImageMessage

    from rsb_extras.pictures.tests.samples import drawn

    across, down = window.cell if way.pixels else wished_pixels(way.colours, sextants=way.sextants)
    wish = Wish(
        width=window.columns, height=window.rows - _LINE, webp=True, across=min(across, MOST_ACROSS),
        down=min(down, MOST_DOWN), shape=window.cell[1] / window.cell[0],
    )  # fmt: skip
    message = ImageMessage(encoding="rgb8", width=photo.width, height=photo.height, step=3 * photo.width)
    message.data = photo.tobytes()  # rclpy takes bytes, too
    picture = drawn(wish, message)
    content = picture.content
    assert isinstance(content, Pixels), picture.problem
    link = len(encode_picture(picture))
    if way.pixels:
        frame = frame_of(content, wish)
        bands = bands_of(content, frame, window.cell, way.pixels, 1, (0, 0, 0))  # type: ignore[arg-type]
        data = "".join(f"\x1b[{band.top + 1};1H{band.sequence}" for band in bands)
        return data.encode(), link, (frame.columns, frame.rows), (frame.width, frame.height)
    rows = image_rows(content, wish, colours=way.colours, sextants=way.sextants)
    text = "\r\n".join(_encoded(row, TerminalFacts(colours=way.colours), ascii_only=False) for row in rows)
    size = sum(len(part.text) for part in rows[0]), len(rows)
    return text.encode(), link, size, (content.width / across, content.height / down)


def of_chafa(file: Path, way: Way, size: tuple[int, int], window: Window) -> list[bytes]:
    """Return chafa's output in the same cells, as it is, and in few colours with errors diffused.

    There is none in sixels, whose size chafa takes from the terminal that it runs in.
    """
    if way.pixels == "sixel":
        return []
    command = ["chafa", "-f", way.pixels or "symbols", "--stretch"]
    command += ["--size", "x".join(map(str, size)), "--font-ratio", f"{window.cell[0]}/{window.cell[1]}", str(file)]
    if not way.pixels:
        command += ["-c", "full" if way.colours == TRUE_COLOUR else str(way.colours)]
    more = [[], ["--dither", "diffusion", "-p", "off"]] if way.colours in (16, 256) else [[]]
    outputs = (subprocess.run([*command, *each], capture_output=True, check=True, timeout=_WITHIN) for each in more)
    return [each.stdout.rstrip(b"\n") for each in outputs]


# -- errors -----------------------------------------------------------------------------------------------------------


def error(shown: Array, photo: Image.Image, size: tuple[float, float], cell: tuple[int, int]) -> float:
    """Return the mean perceptual error of a window's upper left corner, which a photograph fills."""
    width, height = round(size[0] * cell[0]), round(size[1] * cell[1])
    expected = np.asarray(photo.resize((width, height), Image.Resampling.LANCZOS))
    found, wished = (_oklab(_blurred(_light(each), cell[0] / 2)) for each in (shown[:height, :width], expected))
    return 100 * float(np.sqrt(((found - wished) ** 2).sum(-1)).mean())


def _light(rgb: Array) -> Array:
    share = rgb.astype(np.float32) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _blurred(light: Array, sigma: float) -> Array:
    reach = round(3 * sigma)
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / 2 / sigma**2)
    weights = (weights / weights.sum()).astype(np.float32)
    for axis in (0, 1):
        padded = np.pad(light, [(reach, reach) if each == axis else (0, 0) for each in range(3)], mode="edge")
        length = light.shape[axis]
        light = sum(weight * padded.take(range(at, at + length), axis=axis) for at, weight in enumerate(weights))
    return light


def _oklab(light: Array) -> Array:
    """Return lightness and two colours (Ottosson, 2020)."""
    to_cones = np.array(
        [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
         [0.0883024619, 0.2817188376, 0.6299787005]]
    )  # fmt: skip
    to_lab = np.array(
        [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
         [0.0259040371, 0.7827717662, -0.8086757660]]
    )  # fmt: skip
    lab: Array = np.cbrt(light @ to_cones.T) @ to_lab.T
    return lab


# -- all together -----------------------------------------------------------------------------------------------------


def measured(terminal: Terminal, files: Sequence[Path], folder: Path, kept: Path | None) -> Iterator[str]:
    """Give a line for each way in which a terminal shows images."""
    with ExitStack() as stack:
        window = Window(terminal, folder, stack.enter_context(_display()))
        stack.callback(window.close)
        for way in terminal.ways:
            results = []
            for file in files:
                photo = Image.open(file).convert("RGB")
                data, link, size, exact = ours(photo, way, window)
                shown = window.shown(data)
                others = [(math.nan, 0, np.zeros_like(shown))]
                for chafa in of_chafa(file, way, size, window):
                    other = window.shown(chafa)
                    others.append((error(other, photo, size, window.cell), len(chafa), other))
                theirs, sent_by_chafa, other = min(others[1:] or others, key=lambda each: each[0])
                results.append((error(shown, photo, exact, window.cell), theirs, len(data), sent_by_chafa, link))
                if kept is not None:
                    width, height = size[0] * window.cell[0], size[1] * window.cell[1]
                    both = np.concatenate([each[:height, :width] for each in (shown, other)], axis=1)
                    Image.fromarray(both).save(kept / f"{terminal.name}-{way.name}-{file.stem}.png".replace(" ", "-"))
            mine, theirs, sent, sent_by_chafa, link = np.mean(results, axis=0)
            yield (
                f"| {terminal.name}, {way.name} | {mine:.1f} | {theirs:.1f} | {sent / 1000:,.0f} | "
                f"{sent_by_chafa / 1000:,.0f} | {link / 1000:.1f} |"
            )


def main() -> None:
    """Print a table of all terminals that are there, or show files in a terminal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for pictures of the windows, ours at the left")
    parser.add_argument("--only", default="", help="name of one terminal")
    parser.add_argument("--show", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.show:
        show(*arguments.show)
        return
    print("| terminal | error | chafa's | kB to the terminal | chafa's | kB over the link |\n|---|---|---|---|---|---|")
    for terminal in TERMINALS:
        needed = terminal.command[0], *(["tmux"] if "tmux" in terminal.command else [])
        if not all(map(shutil.which, needed)) or arguments.only not in ("", terminal.name):
            continue
        with tempfile.TemporaryDirectory() as folder:
            for line in measured(terminal, arguments.files, Path(folder), arguments.keep):
                print(line, flush=True)


if __name__ == "__main__":
    main()

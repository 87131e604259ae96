"""Images in terminals that show pixels, by kitty's graphics protocol or as sixels.

The protocols: sw.kovidgoyal.net/kitty/graphics-protocol, and DEC STD 070, chapter 9.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import os
import re
import select
import struct
import sys
import termios
import time
import tty
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

from rsb_console.look.picture_rows import rgb_of
from rsb_console.session.picture_files import png

if TYPE_CHECKING:
    from rsb_bridge.model.pictures import Pixels

Protocol = Literal["kitty", "sixel", "blocks"]
DETAIL = 6
"""Pixels across a cell to ask for: about half of what fonts have, for a fourth of the bytes."""
_ANSWERS_WITHIN = 1.0
"""s: over a slow line, too. All terminals answer the second question, most of them at once."""
_QUESTION = b"\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\\x1b[c"
"""Whether a pixel could be shown, and then the terminal's primary device attributes (DA1)."""
_DEVICE = re.compile(rb"\x1b\[\?([0-9;]*)c")
_SIXEL_ATTRIBUTE = b"4"
_DEFINED = re.compile(r"#([0-9]+);2;[0-9]+;[0-9]+;[0-9]+")
"""The definition of a colour, which in xterm does not select it, too. textual-image 0.13 and newer does select it."""
_IMAGE = 1
"""The number of the image, always the same, so that a terminal keeps one image and not all of them."""
_CHUNK = 4096
"""Bytes that the protocol allows in one sequence."""
_USUAL_CELL = 10.0, 20.0
"""Pixels of a cell, for terminals that do not tell theirs: most fonts are twice as high as wide."""
_FINEST = 1200
"""Pixels in each direction of an image in sixels, which are large and slow to draw."""


def why_not(protocol: Protocol) -> str:
    """Return the reason why this program cannot show images in a way, or an empty string."""
    lacks = protocol == "sixel" and not all(find_spec(each) for each in ("textual_image", "PIL"))
    return "--graphics sixel needs textual-image and Pillow: pip install 'rsb-console[look]'" if lacks else ""


def protocol_of_terminal() -> Protocol:
    """Ask the terminal for the way in which it shows images. Call this before anything else reads standard input."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return "blocks"
    answer = asked(sys.stdin.fileno(), sys.stdout.fileno())
    if b"_Gi=31;OK" in answer:
        return "kitty"
    device = _DEVICE.search(answer)
    has_sixel = device is not None and _SIXEL_ATTRIBUTE in device[1].split(b";")
    return "sixel" if has_sixel and not why_not("sixel") else "blocks"


def asked(read_from: int, write_to: int) -> bytes:
    """Return what a terminal answers to `_QUESTION`, without the keys typed before."""
    before = termios.tcgetattr(read_from)
    answer, deadline = b"", time.monotonic() + _ANSWERS_WITHIN
    try:
        # This drops the keys typed before, which would be taken for the answer.
        tty.setcbreak(read_from)
        os.write(write_to, _QUESTION)
        while _DEVICE.search(answer) is None and (left := deadline - time.monotonic()) > 0:
            if select.select([read_from], [], [], left)[0]:
                answer += os.read(read_from, 1024)
    finally:
        # FLUSH drops the unread rest of an answer, which the shell would take for keys.
        termios.tcsetattr(read_from, termios.TCSAFLUSH, before)
    return answer


class ImagePrinter:
    """Prints images, each over the one before.

    Args:
        protocol: ``kitty`` or ``sixel``.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol

    def printed(self, pixels: Pixels, width: int, height: int) -> str:
        """Return the sequence that shows an image at the cursor, as large as an area allows.

        Args:
            width: cells of the area.
            height: cells of the area.

        Raises:
            UnreadableError: the other side's image is damaged.
        """
        across, down = _cell_size()
        factor = min(width * across / pixels.width, height * down / pixels.height)
        if self._protocol == "kitty":
            columns = max(1, min(width, round(pixels.width * factor / across)))
            rows = max(1, min(height, round(pixels.height * factor / down)))
            return _kitty(png(pixels), columns, rows)
        least = max(1, height - 1) * down  # bands of 6 pixels: one that leaves the area would scroll the screen
        factor = min(factor, least / pixels.height, _FINEST / pixels.width, _FINEST / pixels.height)
        return _sixels(pixels, max(1, int(pixels.width * factor)), max(1, int(pixels.height * factor)))

    def closed(self) -> str:
        """Return the sequence that frees the terminal's memory."""
        return f"\x1b_Ga=d,d=I,i={_IMAGE},q=2\x1b\\" if self._protocol == "kitty" else ""


def _kitty(image: bytes, columns: int, rows: int) -> str:
    """Return the sequence that transmits a PNG file and displays it; one of the same id replaces the one before."""
    encoded = base64.b64encode(image).decode()
    chunks = [encoded[at : at + _CHUNK] for at in range(0, len(encoded), _CHUNK)]
    # C=1 leaves the cursor where it is. q=2 keeps the terminal from answers, which would be read as keys.
    keys = f"a=T,f=100,i={_IMAGE},p=1,c={columns},r={rows},C=1,q=2,"
    parts = []
    for number, chunk in enumerate(chunks, 1):
        parts.append(f"\x1b_G{keys}m={int(number < len(chunks))};{chunk}\x1b\\")
        keys = ""  # only the first chunk may have them
    return "".join(parts)


def _sixels(pixels: Pixels, width: int, height: int) -> str:
    from PIL import Image  # noqa: PLC0415 -- optional
    from textual_image._sixel import image_to_sixels  # noqa: PLC0415 -- its public modules ask the terminal

    image = Image.frombytes("RGB", (pixels.width, pixels.height), rgb_of(pixels))
    return _DEFINED.sub(r"\g<0>#\1", image_to_sixels(image.resize((width, height))))


def _cell_size() -> tuple[float, float]:
    """Return the width and height of a cell in pixels, as the terminal says, or usual ones."""
    with contextlib.suppress(OSError):
        rows, columns, width, height = struct.unpack("4H", fcntl.ioctl(sys.stdout, termios.TIOCGWINSZ, bytes(8)))
        if rows and columns and width and height:
            return width / columns, height / rows
    return _USUAL_CELL

"""The command ``look``: draws pictures of a topic's messages, which the side that publishes it renders.

Terminals that show pixels get images by kitty's graphics protocol (sw.kovidgoyal.net/kitty/graphics-protocol) or as
sixels (DEC STD 070, chapter 9).
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import math
import os
import re
import secrets
import select
import shutil
import struct
import sys
import termios
import time
import tty
from concurrent.futures import wait
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

import msgspec
from rich.console import COLOR_SYSTEMS, Console
from rich.style import Style

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import replace_file
from rsb_bridge.model.text import escape_text, single_cells
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, OK, print_line, shows_ascii
from rsb_console.command.target import UsageError, attached, done, failed, other_side
from rsb_console.notation import formats
from rsb_console.notation.glyphs import to_ascii
from rsb_extras.pictures.blocks import COLOURS, QUADRANTS, UnreadableError, reads_webp, rgb_of, wished_pixels
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import (
    MOST_COLUMNS,
    MOST_ROWS,
    Picture,
    Pixels,
    Wish,
    in_cells,
    in_full,
    in_square_pixels,
)
from rsb_extras.pictures.picture_files import FORMATS, picture_file, png
from rsb_extras.pictures.picture_rows import picture_rows

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_extras.pictures.blocks import Row
    from rsb_extras.pictures.picture import Viewed

Graphics = Literal["kitty", "sixel", "blocks"]
_ANSWERED_WITHIN = 60.0  # s, as the help of --timeout says
_TRIED_AGAIN_AFTER = 1.0  # s. A round figure
_REDRAWN_AFTER = 1.0  # s; the age in sight is wrong by so much at most
_ENDED_WITHIN = 5.0  # s; a view ends 5 s after its console was killed (docs/look.md): a longer wait would gain nothing
_SETTLE_SECONDS = 2.0
"""s after the first picture of several topics. A round figure: a rare transform may still be missing then."""
_STYLES = {
    "dim": "bright_black", "strong": "bold", "axis": "bright_black", "ok": "green", "warning": "yellow",
    "error": "bold red", "robot": "bold bright_cyan", "path": "cyan", "scan": "magenta", "occupied": "",
    "free": "bright_black", "goal": "bold bright_yellow",
}  # fmt: skip
"""The styles of pictures on a terminal, without a theme."""
_HOME, _CLEAR_REST, _CLEAR_LINE = "\x1b[H", "\x1b[J", "\x1b[K"
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_DETAIL = 6
"""Pixels across a cell to ask for: about half of what fonts have, for a fourth of the bytes."""
_TERMINAL_ANSWERS_WITHIN = 1.0
"""s: over a slow line, too. All terminals answer the second question, most of them at once."""
_QUESTION = b"\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\\x1b[c"
"""Whether a pixel could be shown, and then the terminal's primary device attributes (DA1)."""
_DEVICE = re.compile(rb"\x1b\[\?([0-9;]*)c")
_SIXEL_ATTRIBUTE = b"4"
_DEFINED_COLOUR = re.compile(r"#([0-9]+);2;[0-9]+;[0-9]+;[0-9]+")
"""The definition of a colour, which in xterm does not select it, too. textual-image 0.13 and newer does select it."""
_NEXT_LINE, _KEEP_CURSOR, _TO_KEPT_CURSOR = "\n", "\x1b7", "\x1b8"
_CHUNK = 4096
"""Bytes that kitty's protocol allows in one sequence."""
_USUAL_CELL = 10.0, 20.0
"""Pixels of a cell, for terminals that do not tell theirs: most fonts are twice as high as wide."""
_FINEST = 1200
"""Pixels in each direction of an image in sixels, which are large and slow to draw."""


class LookText(Wording):
    """Texts of the command."""

    NOTHING_CAME = "no picture of {topic} within {seconds:g} s"
    UNKNOWN_FORMAT = "{file}: write a picture to one of {known}"
    WRITTEN = "written: {file}"
    NOT_WRITTEN = "{file} cannot be written: {error}"
    AGE = "{age} old"
    NO_MESSAGE = "no message yet"


def look(arguments: Namespace) -> int:
    file = arguments.output
    if file is not None and file.suffix not in FORMATS:
        raise UsageError(LookText.UNKNOWN_FORMAT(file=file, known=", ".join(FORMATS)))
    arguments.ascii |= shows_ascii()
    once = arguments.once or file is not None or not sys.stdout.isatty()
    if file is not None or arguments.json or (arguments.graphics == "auto" and arguments.ascii):
        arguments.graphics = "blocks"
    elif arguments.graphics == "auto":
        arguments.graphics = graphics_of_terminal()
    elif problem := why_no_graphics(arguments.graphics):
        raise UsageError(problem)
    viewer = secrets.token_hex(8)
    with attached(arguments, read_only=True) as engine:
        try:
            return (_one if once else many)(engine, viewer, arguments)
        finally:
            _end(engine, viewer)


def _end(engine: RemoteEngine, viewer: str) -> None:
    """End the view, so that the next command finds room for its own."""
    with contextlib.suppress(EngineError, TimeoutError):
        engine.do(EndLook(viewer)).result(_ENDED_WITHIN)


def _one(engine: RemoteEngine, viewer: str, arguments: Namespace) -> int:
    """Print one picture, or write it to a file."""
    wish = _wish(arguments)
    seconds = _ANSWERED_WITHIN if arguments.timeout is None else arguments.timeout
    viewed = _first(engine, viewer, arguments, wish, seconds)
    if viewed is None or viewed.picture.content is None:
        picture = Picture() if viewed is None else viewed.picture
        nothing = LookText.NOTHING_CAME(topic=arguments.topics[0], seconds=seconds)
        text = picture.problem or ": ".join(part for part in (nothing, picture.waiting) if part)
        return failed(arguments, escape_text(text), FAILURE)
    if arguments.output is None:
        _print(viewed, wish, arguments)
        return OK
    try:
        replace_file(arguments.output, picture_file(viewed.picture.content, arguments.output.suffix))
    except (OSError, ValueError) as error:
        return failed(arguments, LookText.NOT_WRITTEN(file=arguments.output, error=error), FAILURE)
    if not arguments.json:
        print_line(LookText.WRITTEN(file=arguments.output))
    return done(arguments, file=str(arguments.output))


def _first(engine: RemoteEngine, viewer: str, arguments: Namespace, wish: Wish, seconds: float) -> Viewed | None:
    """Return the first picture, or the reason why it is missing.

    Several topics come one after another: of them, return the last picture of some time, and wait for what they add,
    such as the transforms of `/tf`, before there is a picture.
    """
    newest, came, several = None, 0.0, len(arguments.topics) > 1
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0:
        try:
            viewed = engine.do(LookAtTopics(viewer, tuple(arguments.topics), wish, arguments.link)).result(left)
        except TimeoutError:
            break
        if viewed is None:
            continue
        if viewed.picture.content is None and not viewed.picture.problem:
            if newest is None or newest.picture.waiting:
                newest = viewed  # for its reason, if none comes
            continue
        drawn = viewed.picture.content is not None
        if not several or (drawn and (newest is None or newest.picture.content is None)):
            deadline = min(deadline, time.monotonic() + (_SETTLE_SECONDS if several else 0.0))
        if drawn or newest is None or newest.picture.content is None:
            newest, came = viewed, time.monotonic()
    return None if newest is None else _named(engine, _aged(newest, came))


def _named(engine: RemoteEngine, viewed: Viewed) -> Viewed:
    """Return a picture with the name of the side that drew it, instead of its link's."""
    return msgspec.structs.replace(viewed, where=other_side(engine, viewed.where)) if viewed.where else viewed


def _aged(viewed: Viewed, came: float) -> Viewed:
    """Return a picture that came at a time on the monotonic clock, with its age now."""
    if viewed.age is None:
        return viewed
    return msgspec.structs.replace(viewed, age=viewed.age + time.monotonic() - came)


def _print(viewed: Viewed, wish: Wish, arguments: Namespace) -> None:
    picture = viewed.picture
    if arguments.graphics != "blocks" and isinstance(picture.content, Pixels):
        try:
            sys.stdout.write(inline(arguments.graphics, picture.content, wish.width, wish.height))
        except UnreadableError as error:
            raise EngineError(str(error)) from None
        print_line(_status(viewed))
        return
    console, rows = _console(arguments), _rows(viewed, wish, arguments)
    if arguments.json:
        print_line(
            json_line(
                {
                    "ok": True,
                    "side": viewed.where or "here",
                    "type": picture.type_name,
                    "age": viewed.age,
                    "messages": picture.messages,
                    "size": picture.size,
                    "encoded": viewed.encoded,
                    "notes": picture.notes,
                    "problem": picture.problem,
                    "rows": ["".join(part.text for part in row) for row in rows],
                }
            )
        )
        return
    for row in rows:
        sys.stdout.write(f"{_encoded(console, row, ascii_only=arguments.ascii)}\n")
    print_line(_status(viewed))


def many(engine: RemoteEngine, viewer: str, arguments: Namespace) -> int:
    """Draw pictures until an interrupt."""
    console = _console(arguments)
    printer = None if arguments.graphics == "blocks" else ImagePrinter(arguments.graphics)
    sys.stdout.write(_ENTER)
    try:
        viewed: Viewed | None = None
        came, asked, drawn = 0.0, None, None
        while True:
            problem, lines, painted = "", [], ""
            wish = _wish(arguments)
            if asked is None:
                asked = engine.do(LookAtTopics(viewer, tuple(arguments.topics), wish, arguments.link))
            wait((asked,), _REDRAWN_AFTER)  # without a new picture, the age of the last one goes on
            try:
                if asked.done():
                    answer, asked = asked, None
                    newer = answer.result()
                    if newer is not None and (viewed is None or viewed.picture.waiting or not newer.picture.waiting):
                        viewed, came = newer, time.monotonic()
            except EngineError as error:
                problem = str(error)
            try:
                content = None if viewed is None else viewed.picture.content
                image = content if printer is not None and isinstance(content, Pixels) else None
                # Each image is sent once, since it is large, and stays on the screen.
                if printer is not None and image is not None and image is not drawn:
                    drawn, painted = image, printer.printed(image, wish.width, wish.height)
                elif viewed is not None and image is None:
                    lines = [
                        _encoded(console, _cut(row, wish.width), ascii_only=arguments.ascii)
                        for row in _rows(viewed, wish, arguments)
                    ]
            except (EngineError, UnreadableError) as error:  # the picture is damaged
                problem = problem or str(error)
            shown = None if viewed is None else _named(engine, _aged(viewed, came))
            status = problem or (LookText.NO_MESSAGE() if shown is None else _status(shown))
            last = f"{single_cells(escape_text(status))[: wish.width]}{_CLEAR_LINE}"
            if image is not None:
                sys.stdout.write(f"{_HOME}{painted}\x1b[{wish.height + 1};1H{last}")
            else:
                rows = "".join(f"{line}{_CLEAR_LINE}\r\n" for line in lines[: wish.height])
                sys.stdout.write(f"{_HOME}{rows}{last}{_CLEAR_REST}")
            sys.stdout.flush()
            # A refusal comes at once: without a pause, this loop would take a whole core.
            if problem:
                time.sleep(_TRIED_AGAIN_AFTER)
    finally:
        if printer is not None:
            sys.stdout.write(printer.closed())
        sys.stdout.write(_LEAVE)
        sys.stdout.flush()


def _wish(arguments: Namespace) -> Wish:
    size = shutil.get_terminal_size((80, 24))
    wish = Wish(
        width=max(1, min(MOST_COLUMNS, arguments.width or size.columns)),
        height=max(1, min(MOST_ROWS, arguments.height or size.lines - 1)),
        rate=arguments.rate,
        how=arguments.how,
        fields=tuple(arguments.field),
        zoom=arguments.zoom,
        tilt=arguments.tilt,
        frame=arguments.frame,
        colour=arguments.colour,
        seconds=arguments.seconds,
        match=arguments.match,
        webp=reads_webp(),
    )
    is_file = arguments.output is not None and arguments.output.suffix == ".png"
    if is_file and not (arguments.detail or arguments.width or arguments.height):
        return in_full(wish)
    across, down = _cell_size()
    if is_file or arguments.graphics != "blocks":
        return in_square_pixels(wish, arguments.detail or _DETAIL, down / across)
    return in_cells(wish, *wished_pixels(_colours(arguments), QUADRANTS), down / across)


def _rows(viewed: Viewed, wish: Wish, arguments: Namespace) -> list[Row]:
    content = viewed.picture.content
    if content is None:
        return []
    try:
        return picture_rows(content, wish.width, wish.height, colours=_colours(arguments))
    except UnreadableError as error:
        raise EngineError(str(error)) from None


def _cut(row: Row, width: int) -> Row:
    """Return a row without the cells beyond a width, which a terminal would wrap."""
    parts, left = [], width
    for part in row:
        parts.append(part._replace(text=part.text[:left]))
        left = max(0, left - len(part.text))
    return tuple(parts)


def _console(arguments: Namespace) -> Console:
    """Return rich's idea of this terminal, which changes colours to ones that it has."""
    if arguments.ascii or "NO_COLOR" in os.environ or not sys.stdout.isatty():
        return Console(color_system=None)
    return Console()


def _colours(arguments: Namespace) -> int:
    return COLOURS[_console(arguments).color_system]


def _encoded(console: Console, row: Row, *, ascii_only: bool) -> str:
    """Return a row with escape sequences for the terminal's colours."""
    system = None if console.color_system is None else COLOR_SYSTEMS[console.color_system]
    ascii_only |= not (sys.stdout.encoding or "").lower().startswith("utf")
    parts = []
    for text, style, background in row:
        shown = to_ascii(text) if ascii_only else text
        if system is None:
            parts.append(shown)
            continue
        fore = _STYLES.get(style, style)
        look = Style.parse(f"{fore} on {background}" if background else fore or "none")
        parts.append(look.render(shown, color_system=system))
    return "".join(parts)


def _status(viewed: Viewed) -> str:
    picture = viewed.picture
    where = viewed.where or "this side"
    age = LookText.AGE(age=formats.age(viewed.age)) if viewed.age is not None else ""
    parts = (where, age, " · ".join(picture.notes), picture.problem or picture.waiting)
    return escape_text("  ".join(part for part in parts if part))


def why_no_graphics(protocol: Graphics) -> str:
    """Return the reason why this program cannot show images in a way, or an empty string."""
    lacks = protocol == "sixel" and not all(find_spec(each) for each in ("textual_image", "PIL"))
    return "--graphics sixel needs textual-image and Pillow: pip install 'rsb-console[look]'" if lacks else ""


def graphics_of_terminal() -> Graphics:
    """Ask the terminal for the way in which it shows images. Call this before anything else reads standard input."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return "blocks"
    answer = terminal_answer(sys.stdin.fileno(), sys.stdout.fileno())
    if b"_Gi=31;OK" in answer:
        return "kitty"
    device = _DEVICE.search(answer)
    has_sixel = device is not None and _SIXEL_ATTRIBUTE in device[1].split(b";")
    return "sixel" if has_sixel and not why_no_graphics("sixel") else "blocks"


def terminal_answer(read_from: int, write_to: int) -> bytes:
    """Return what a terminal answers to `_QUESTION`, without the keys typed before."""
    before = termios.tcgetattr(read_from)
    answer, deadline = b"", time.monotonic() + _TERMINAL_ANSWERS_WITHIN
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
        image_id: kitty's number of the image. A terminal keeps one image of each number, and not all that were sent.
    """

    def __init__(self, protocol: Graphics, image_id: int = 1) -> None:
        self._protocol = protocol
        self._id = image_id

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
            return _kitty(png(pixels), self._id, columns, rows)
        least = max(1, height - 1) * down  # bands of 6 pixels: one that leaves the area would scroll the screen
        factor = min(factor, least / pixels.height, _FINEST / pixels.width, _FINEST / pixels.height)
        return _sixels(pixels, max(1, int(pixels.width * factor)), max(1, int(pixels.height * factor)))

    def closed(self) -> str:
        """Return the sequence that frees the terminal's memory."""
        return f"\x1b_Ga=d,d=I,i={self._id},q=2\x1b\\" if self._protocol == "kitty" else ""


def inline(protocol: Graphics, pixels: Pixels, width: int, height: int) -> str:
    """Return the sequence that shows an image among the lines of a shell, and goes on below it.

    Raises:
        UnreadableError: the other side's image is damaged.
    """
    across, down = _cell_size()
    rows = max(1, min(height, math.ceil(pixels.height * width * across / pixels.width / down)))
    image_id = secrets.randbelow(1 << 31) + 1  # the images of former commands stay on the screen
    image = ImagePrinter(protocol, image_id).printed(pixels, width, rows)
    # The lines come first: at the end of the screen, they scroll it, which the image would not, or not enough.
    return f"{_NEXT_LINE * rows}\x1b[{rows}A{_KEEP_CURSOR}{image}{_TO_KEPT_CURSOR}\x1b[{rows}B"


def _kitty(image: bytes, image_id: int, columns: int, rows: int) -> str:
    """Return the sequence that transmits a PNG file and displays it; one of the same id replaces the one before."""
    encoded = base64.b64encode(image).decode()
    chunks = [encoded[at : at + _CHUNK] for at in range(0, len(encoded), _CHUNK)]
    # C=1 leaves the cursor where it is. q=2 keeps the terminal from answers, which would be read as keys.
    keys = f"a=T,f=100,i={image_id},p=1,c={columns},r={rows},C=1,q=2,"
    parts = []
    for number, chunk in enumerate(chunks, 1):
        parts.append(f"\x1b_G{keys}m={int(number < len(chunks))};{chunk}\x1b\\")
        keys = ""  # only the first chunk may have them
    return "".join(parts)


def _sixels(pixels: Pixels, width: int, height: int) -> str:
    from PIL import Image  # noqa: PLC0415 -- optional
    from textual_image._sixel import image_to_sixels  # noqa: PLC0415 -- its public modules ask the terminal

    image = Image.frombytes("RGB", (pixels.width, pixels.height), rgb_of(pixels))
    return _DEFINED_COLOUR.sub(r"\g<0>#\1", image_to_sixels(image.resize((width, height))))


def _cell_size() -> tuple[float, float]:
    """Return the width and height of a cell in pixels, as the terminal says, or usual ones."""
    with contextlib.suppress(OSError):
        rows, columns, width, height = struct.unpack("4H", fcntl.ioctl(sys.stdout, termios.TIOCGWINSZ, bytes(8)))
        if rows and columns and width and height:
            return width / columns, height / rows
    return _USUAL_CELL

"""The command ``look``: draws pictures of a topic's messages, which the side that publishes it renders."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import sys
import time
from concurrent.futures import wait
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
from rich.console import COLOR_SYSTEMS
from rich.style import Style

from rsb_bridge.feature_api import EngineError, Wording, escape_text, replace_file
from rsb_bridge.model.text import single_cells
from rsb_console.command.shell import shows_ascii
from rsb_console.command.target import other_side
from rsb_console.feature_console import FAILURE, OK, UsageError, attached, done, failed, json_line, print_line
from rsb_console.notation import formats
from rsb_console.notation.ascii_signs import to_ascii
from rsb_console.terminal.terminal_facts import ask, facts_before_answers
from rsb_extras.pictures.blocks import image_rows, wished_pixels
from rsb_extras.pictures.graphics import USUAL_CELL, Painter, bands_of, frame_of, protocol_of, why_no_graphics
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.paper import Paper
from rsb_extras.pictures.picture import Picture, Pixels, Wish, in_full, sized
from rsb_extras.pictures.picture_files import FORMATS, picture_file
from rsb_extras.pictures.picture_rows import UnreadableError, has_pillow, picture_rows

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_console.terminal.terminal_facts import Pixels as Protocol
    from rsb_console.terminal.terminal_facts import TerminalFacts
    from rsb_extras.pictures.graphics import Band
    from rsb_extras.pictures.picture import Viewed
    from rsb_extras.pictures.picture_rows import Row

_ANSWERED_WITHIN = 60.0  # s, as the help of --timeout says
_TRIED_AGAIN_AFTER = 1.0  # s. A round figure
_REDRAWN_AFTER = 1.0  # s; the age in sight is wrong by so much at most
_ENDED_WITHIN = 5.0  # s; a view ends 5 s after its console was killed (docs/look.md): a longer wait would gain nothing
_SETTLE_SECONDS = 2.0
"""s after the first picture of several topics. A round figure: a rare transform may still be missing then."""
_STYLES = {
    "dim": "bright_black", "strong": "bold", "axis": "bright_black", "ok": "green", "warning": "yellow",
    "error": "bold red", "robot": "bold bright_cyan", "path": "cyan", "scan": "bright_magenta", "curve": "magenta",
    "occupied": "", "free": "bright_black", "goal": "bold bright_yellow", "lethal": "red",
}  # fmt: skip
"""The styles of pictures on a terminal, without a theme."""
_INK = "#d0d0d0"
_PAPER = Paper.of("#121212", _INK)
_HOME, _CLEAR_REST, _CLEAR_LINE = "\x1b[H", "\x1b[J", "\x1b[K"
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_NEXT_LINE = "\n"


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
    arguments.ascii |= shows_ascii(sys.stdout) or not (sys.stdout.encoding or "").lower().startswith("utf")
    once = arguments.once or file is not None or not sys.stdout.isatty()
    facts = facts_before_answers(os.environ, 1)
    if sys.stdin.isatty() and sys.stdout.isatty() and file is None and not arguments.json and not arguments.ascii:
        facts = ask(facts, os.environ, 0, 1)  # before anything else reads standard input
    if arguments.ascii or "NO_COLOR" in os.environ or not sys.stdout.isatty():
        facts = replace(facts, colours=0)
    arguments.facts = facts
    if file is not None or arguments.json or (arguments.graphics == "auto" and arguments.ascii):
        arguments.graphics = "blocks"
    elif arguments.graphics == "auto":
        arguments.graphics = protocol_of(facts) or "blocks"
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
            sys.stdout.write(ImagePrinter(arguments.graphics, arguments.facts).inline(picture.content, wish))
        except UnreadableError as error:
            raise EngineError(str(error)) from None
        print_line(_status(viewed))
        return
    rows = _rows(viewed, wish, arguments)
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
        sys.stdout.write(f"{_encoded(row, arguments.facts, ascii_only=arguments.ascii)}\n")
    print_line(_status(viewed))


def many(engine: RemoteEngine, viewer: str, arguments: Namespace) -> int:
    """Draw pictures until an interrupt."""
    printer = None if arguments.graphics == "blocks" else ImagePrinter(arguments.graphics, arguments.facts)
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
                    drawn, painted = image, printer.printed(image, wish)
                elif viewed is not None and image is None:
                    lines = [
                        _encoded(_cut(row, wish.width), arguments.facts, ascii_only=arguments.ascii)
                        for row in _rows(viewed, wish, arguments)
                    ]
            except (EngineError, UnreadableError) as error:  # the picture is damaged
                problem = problem or str(error)
            shown = None if viewed is None else _named(engine, _aged(viewed, came))
            status = problem or (LookText.NO_MESSAGE() if shown is None else _status(shown))
            last = single_cells(escape_text(status))[: wish.width]
            last = f"{to_ascii(last) if arguments.ascii else last}{_CLEAR_LINE}"
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
        rate=arguments.rate,
        how=arguments.how or ("plot" if arguments.field else ""),
        fields=tuple(arguments.field),
        zoom=arguments.zoom,
        tilt=arguments.tilt,
        frame=arguments.frame,
        colour=arguments.colour,
        seconds=arguments.seconds,
        match=arguments.match,
        webp=has_pillow(),
    )
    is_file = arguments.output is not None and arguments.output.suffix == ".png"
    facts = arguments.facts
    shape = facts.shape
    if is_file:
        across, down, shape = 6, 12, 2.0  # a file has no cells, and square pixels
    elif arguments.graphics != "blocks":
        across, down = (round(each) for each in facts.cell or USUAL_CELL)
    else:
        across, down = wished_pixels(facts.colours, sextants=facts.draws_sextants)
    if arguments.detail and (is_file or arguments.graphics != "blocks"):
        # Characters show what they can; more would cross the link for nothing.
        across, down = arguments.detail, round(arguments.detail * shape)
    width, height = arguments.width or size.columns, arguments.height or size.lines - 1
    wish = sized(wish, width, height, across, down, shape)
    return in_full(wish) if is_file and not (arguments.width or arguments.height or arguments.detail) else wish


def _rows(viewed: Viewed, wish: Wish, arguments: Namespace) -> list[Row]:
    content = viewed.picture.content
    if content is None:
        return []
    try:
        if isinstance(content, Pixels):
            sextants = arguments.facts.draws_sextants
            return image_rows(content, wish, colours=arguments.facts.colours, sextants=sextants)
        return picture_rows(content, wish.width, wish.height, colours=arguments.facts.colours)
    except UnreadableError as error:
        raise EngineError(str(error)) from None


def _cut(row: Row, width: int) -> Row:
    """Return a row without the cells beyond a width, which a terminal would wrap."""
    parts, left = [], width
    for part in row:
        parts.append(part._replace(text=part.text[:left]))
        left = max(0, left - len(part.text))
    return tuple(parts)


def _encoded(row: Row, facts: TerminalFacts, *, ascii_only: bool) -> str:
    """Return a row with escape sequences for a terminal's colours."""
    system = COLOR_SYSTEMS[facts.colour_system] if facts.colours else None
    parts = []
    for text, style, background in row:
        shown = to_ascii(text) if ascii_only else text
        if system is None:
            parts.append(shown)
            continue
        parts.append(Style.parse(_look(style, background)).render(shown, color_system=system))
    return "".join(parts)


def _look(style: str, background: str) -> str:
    """Return rich's words for the style of a part."""
    fore = _PAPER.colour(style[1:]) or _PAPER.own if style.startswith("@") else _STYLES.get(style, style)
    if background.startswith("@"):  # a map's ground, on which the terminal's own foreground may be unreadable
        background = _PAPER.colour(background[1:]) or _PAPER.own
        fore = fore or _INK
    return f"{fore} on {background}" if background else fore or "none"


def _status(viewed: Viewed) -> str:
    picture = viewed.picture
    where = viewed.where or "this side"
    age = LookText.AGE(age=formats.age(viewed.age)) if viewed.age is not None else ""
    parts = (where, age, " · ".join(picture.notes), picture.problem or picture.waiting)
    return escape_text("  ".join(part for part in parts if part))


class ImagePrinter:
    """Prints images, each over the one before."""

    def __init__(self, protocol: Protocol, facts: TerminalFacts) -> None:
        self._protocol = protocol
        self._cell = facts.cell or USUAL_CELL
        self._bands: list[Band] = []
        self._painter = Painter(protocol)

    def printed(self, pixels: Pixels, wish: Wish) -> str:
        """Return the sequence that shows an image in the upper left corner.

        Raises:
            UnreadableError: the other side's image is damaged.
        """
        frame = frame_of(pixels, wish)
        self._bands = bands_of(
            pixels, frame, self._cell, self._protocol, self._painter.first_id, _PAPER.background, self._bands
        )
        return self._painter.painted(self._bands, (0, 0), ())

    def inline(self, pixels: Pixels, wish: Wish) -> str:
        """Return the sequence that shows an image among the lines of a shell, and goes on below it.

        Raises:
            UnreadableError: the other side's image is damaged.
        """
        frame = frame_of(pixels, wish)
        rows = frame.rows
        bands = bands_of(pixels, frame, self._cell, self._protocol, self._painter.first_id, _PAPER.background)
        # The lines come first: at the end of the screen, they scroll it, which the image would not, or not enough.
        image = "".join(f"\x1b8{_down(band.top)}{band.sequence}" for band in bands)
        return f"{_NEXT_LINE * rows}\x1b[{rows}A\x1b7{image}\x1b8\x1b[{rows}B"

    def closed(self) -> str:
        """Return the sequence that frees the terminal's memory."""
        return self._painter.taken_away()


def _down(rows: int) -> str:
    return f"\x1b[{rows}B" if rows else ""

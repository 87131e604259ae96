"""The command ``look``: draws pictures of a topic's messages, which the side that publishes it renders."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import sys
import time
from concurrent.futures import wait
from typing import TYPE_CHECKING

import msgspec
from rich.console import COLOR_SYSTEMS, Console
from rich.style import Style

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import replace_file
from rsb_bridge.model.commands import EndLook
from rsb_bridge.model.pictures import MOST_COLUMNS, MOST_ROWS, Pixels, Wish
from rsb_bridge.model.text import escape_text, single_cells
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line
from rsb_console.command.graphics import DETAIL, ImagePrinter, protocol_of_terminal, why_not
from rsb_console.command.shell import FAILURE, OK, print_line
from rsb_console.command.target import UsageError, attached, done, failed, other_side
from rsb_console.look import formats
from rsb_console.look.glyphs import to_ascii
from rsb_console.look.picture_rows import COLOURS, UnreadableError, picture_rows, reads_webp
from rsb_console.session.picture_files import FORMATS, picture_file

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.pictures import Viewed
    from rsb_console.look.picture_rows import Row

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


class LookText(Wording):
    """Texts of the command."""

    NOTHING_CAME = "no picture of {topic} within {seconds:g} s"
    UNKNOWN_FORMAT = "{file}: write a picture to one of {known}"
    WRITTEN = "written: {file}"
    NOT_WRITTEN = "{file} cannot be written: {error}"
    AGE = "{age} old"
    NO_MESSAGE = "no message yet"


def _look(arguments: Namespace) -> int:
    file = arguments.output
    if file is not None and file.suffix not in FORMATS:
        raise UsageError(LookText.UNKNOWN_FORMAT(file=file, known=", ".join(FORMATS)))
    once = arguments.once or file is not None or not sys.stdout.isatty()
    if arguments.graphics == "auto":
        arguments.graphics = "blocks" if once or arguments.ascii else protocol_of_terminal()
    elif problem := why_not(arguments.graphics):
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
        problem = viewed.picture.problem if viewed is not None else ""
        text = problem or LookText.NOTHING_CAME(topic=arguments.topics[0], seconds=seconds)
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
            viewed = engine.next_picture(viewer, tuple(arguments.topics), wish, arguments.link).result(left)
        except TimeoutError:
            break
        if viewed is None or (viewed.picture.content is None and not viewed.picture.problem):
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
    console, rows = _console(arguments), _rows(viewed, wish, arguments)
    if arguments.json:
        picture = viewed.picture
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
        sys.stdout.write(f"{_encoded(console, row)}\n")
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
                asked = engine.next_picture(viewer, tuple(arguments.topics), wish, arguments.link)
            wait((asked,), _REDRAWN_AFTER)  # without a new picture, the age of the last one goes on
            try:
                if asked.done():
                    answer, asked = asked, None
                    if (newer := answer.result()) is not None:
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
                    lines = [_encoded(console, _cut(row, wish.width)) for row in _rows(viewed, wish, arguments)]
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
    return Wish(
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
        detail=_detail(arguments),
    )


def _detail(arguments: Namespace) -> int:
    if arguments.graphics == "blocks" and (arguments.output is None or arguments.output.suffix != ".png"):
        # Characters show one pixel across a cell; more would cross the link for nothing.
        return 1
    return arguments.detail or (1 if arguments.graphics == "blocks" else DETAIL)


def _rows(viewed: Viewed, wish: Wish, arguments: Namespace) -> list[Row]:
    content = viewed.picture.content
    if content is None:
        return []
    try:
        return picture_rows(content, wish.width, wish.height, colours=COLOURS[_console(arguments).color_system])
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


def _encoded(console: Console, row: Row) -> str:
    """Return a row with escape sequences for the terminal's colours."""
    system = None if console.color_system is None else COLOR_SYSTEMS[console.color_system]
    ascii_only = not (sys.stdout.encoding or "").lower().startswith("utf")
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
    parts = (where, age, " · ".join(picture.notes), picture.problem)
    return escape_text("  ".join(part for part in parts if part))


COMMANDS = {"look": _look}

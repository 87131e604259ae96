"""The private parts of libraries that the program relies on are there, and do what is relied upon.

A test that fails after an update names the version with which it last passed. Mend the part's module, in
``python_internals`` or ``library_internals``, and write the new version here.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import selectors
import socket
import subprocess
import sys
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING, Any

import pytest
from rich.color import ColorSystem
from rich.console import Console
from rich.style import Style
from textual import events
from textual.containers import Vertical
from textual.content import Content
from textual.drivers.linux_driver import LinuxDriver
from textual.widgets import Input, Label

from rsb_bridge.python_internals.asyncio_internals import ObservedLoop, poll_of, reader_of
from rsb_console.library_internals import argparse_internals, rich_internals, textual_internals

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType
    from textual.app import ComposeResult
    from textual.screen import Screen

SEEN = {"python": "3.11.7", "rich": "15.0.0", "textual": "8.2.8", "textual-image": "0.12.0"}


@contextmanager
def seen(library: str) -> Iterator[None]:
    """Name the versions where a part of a library does not hold."""
    here = sys.version.split()[0] if library == "python" else metadata.version(library)
    try:
        yield
    except Exception as error:
        error.add_note(f"This held with {library} {SEEN[library]}; here is {here}.")
        raise


# --- Python


@seen("python")
def test_loop_waits_only_while_it_runs_and_has_nothing_to_do() -> None:
    loop = ObservedLoop()
    found = [loop.waits]
    loop.call_soon(lambda: found.append(loop.waits))
    loop.call_soon(loop.stop)  # which waits for the first one
    loop.run_forever()
    for debug in (False, True):
        loop.set_debug(debug)
        loop.call_later(0.0, lambda: found.append(loop.waits))
        loop.call_later(0.01, loop.stop)
        loop.run_forever()
    loop.close()
    assert found == [False, False, True, False]


@seen("python")
def test_epoll_and_reader_of_a_socket_are_found() -> None:
    selector, (here, there) = selectors.EpollSelector(), socket.socketpair()
    heard: list[int] = []
    loop = asyncio.SelectorEventLoop(selector)
    with here, there:
        loop.add_reader(here, heard.append, 1)
        there.send(b"x")
        assert (here.fileno(), selectors.EVENT_READ) in poll_of(selector)(-1, 2)
        reader_of(selector.get_key(here))()
        loop.remove_reader(here)
    loop.close()
    assert heard == [1]


@seen("python")
def test_call_comes_before_the_wait_for_threads() -> None:
    program = (
        "import threading\n"
        "from rsb_bridge.python_internals.threading_internals import before_waiting_for_threads\n"
        "end = threading.Event()\n"
        "before_waiting_for_threads(end.set)\n"
        "threading.Thread(target=end.wait).start()\n"
    )
    assert subprocess.run((sys.executable, "-P", "-c", program), timeout=60, check=False).returncode == 0


@seen("python")
def test_parsers_arguments_commands_and_defaults_are_found() -> None:
    parser = argparse.ArgumentParser(prog="x", add_help=False)
    assert argparse_internals.commands_of(parser) is None
    option, word = parser.add_argument("-a", "--all"), parser.add_argument("word")
    assert [*argparse_internals.actions_of(parser)] == [option, word]
    assert argparse_internals.options_of(parser) == {"-a": option, "--all": option}
    parser.set_defaults(all="set")
    parser.set_defaults(all=argparse.SUPPRESS)
    argparse_internals.forget_default(parser, "all")
    commands = parser.add_subparsers()
    made = {name: commands.add_parser(name, help=name) for name in ("b", "a")}
    assert argparse_internals.commands_of(parser) == made
    argparse_internals.put_in_order(commands, ["a", "b"])
    assert [*commands.choices] == ["a", "b"]
    text = parser.format_help()
    assert text.index("  a ") < text.index("  b ")
    assert vars(parser.parse_args(["w", "a"])) == {"word": "w"}


# --- rich and textual-image


@seen("rich")
def test_bits_of_a_style_and_colours_of_a_console_are_found() -> None:
    bits = rich_internals.attributes_of
    assert [bits(Style(bold=True)), bits(Style(dim=True, bold=False)), bits(Style())] == [1, 2, 0]
    console = Console(color_system=None)
    assert rich_internals.colours_of(console) is ColorSystem.TRUECOLOR
    rich_internals.use_colours(console, ColorSystem.EIGHT_BIT)
    assert (rich_internals.colours_of(console), console.color_system) == (ColorSystem.EIGHT_BIT, "256")


@seen("textual-image")
def test_image_becomes_sixels_without_a_terminal() -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("textual_image")
    from rsb_console.library_internals.textual_image_internals import sixels_of

    sixels = sixels_of(image.new("RGB", (4, 6)))
    assert sixels.startswith("\x1bP")
    assert sixels.endswith("\x1b\\")


# --- Textual


class Drawn(textual_internals.OpenApp[None]):
    """An app with a field before a label, which notes what is written and how it ends."""

    def __init__(self) -> None:
        super().__init__()
        self.field, self.label = Placed(Input()), Label("x")
        self.drew: list[bool] = []
        self.errors = 0

    def compose(self) -> ComposeResult:
        yield from (self.field, self.label)

    def write_drawn(self, screen: Screen[Any], renderable: RenderableType | None) -> None:
        self.drew.append(self.draws)
        super().write_drawn(screen, renderable)

    def failed(self) -> None:
        self.errors += 1
        super().failed()


class Placed(Vertical, textual_internals.HasPlace):
    position = 7


@seen("textual")
def test_keys_wait_after_escape_until_it_is_ended() -> None:
    reader = textual_internals.KeyReader()
    assert [*reader.feed("\x1b")] == []
    assert reader.waits
    reader.wait_no_longer()
    assert [*reader.tick()] == []
    reader.end_escape()
    keys = [*reader.feed("a")]
    assert [each.key for each in keys if isinstance(each, events.Key)] == ["escape", "a"]
    assert [each.key for each in reader.keys_of("\x1b[A", alt=False)] == ["up"]
    [*reader.feed("\x1b")]
    reader.end_escape()
    reader.drop_keys()
    assert [each.key for each in reader.feed("b") if isinstance(each, events.Key)] == ["b"]


@seen("textual")
def test_driver_reads_with_what_its_module_names() -> None:
    assert {"XTermParser", "getincrementaldecoder"} <= {*LinuxDriver.run_input_thread.__code__.co_names}


@seen("textual")
def test_key_of_a_character_has_its_name() -> None:
    assert [textual_internals.key_of(each) for each in "a?"] == ["a", "question_mark"]


@seen("textual")
def test_driver_has_the_modes_that_are_set_again() -> None:
    async def use() -> None:
        app, file = Drawn(), io.StringIO()
        async with app.run_test():
            driver = textual_internals.TerminalDriver(app, file)
            driver.write = file.write  # type: ignore[method-assign, assignment]
            assert driver.terminal_size() > (0, 0)
            assert (driver.writer, driver.can_synchronize, driver.resumes, driver.mouse) == (None, False, False, True)
            driver.mouse = False
            driver.set_mouse()
            assert file.getvalue().endswith("\x1b[?1006l")
            driver.set_text_modes()
            assert "\x1b[?2004h" in file.getvalue()
            driver.tells_size_among_keys = driver.mouse_in_pixels = True
            assert driver.tells_size_among_keys
            assert driver.mouse_in_pixels

    asyncio.run(use())


@seen("textual")
def test_app_tells_when_it_draws_waits_and_fails() -> None:
    async def use() -> None:
        app = Drawn()
        assert not app.draws
        async with app.run_test() as pilot:
            await pilot.pause()
            assert any(app.drew)
            assert app.driver_now is not None
            assert textual_internals.is_idle(app.label)
            assert not textual_internals.has_messages(app.label)
            assert not textual_internals.holds_message(app.label)
            app.label.post_message(events.Click(app.label, 0, 0, 0, 0, 1, False, False, False))
            assert textual_internals.has_messages(app.label)
            with app.batch_update():
                assert not app.draws
            assert app.field._focus_sort_key == (7, 0)
            assert app.field.styles.width is not None
            textual_internals.entitle(app.field, Content("title"))
            assert str(app.field.border_title) == "title"
            textual_internals.crash(app, ValueError("on purpose"))
        assert app.errors == 1

    with pytest.raises(ValueError, match="on purpose"):
        asyncio.run(use())

"""Images as pixels of the terminal: the question to the terminal, and the sequences for kitty and sixel."""

from __future__ import annotations

import base64
import contextlib
import io
import os
import pty
import re
import threading
from collections.abc import Iterator
from typing import TextIO, cast

import pytest
from PIL import Image
from tests.support import surroundings

from rsb_extras.pictures.look_command import ImagePrinter, graphics_of_terminal, terminal_answer, why_no_graphics
from rsb_extras.pictures.picture import Pixels
from rsb_extras.pictures.tests import picture_places

RED = Pixels(4, 2, b"\xff\0\0" * 8)
_CELL = (10.0, 20.0)
_COMMAND = re.compile(r"\x1b_G([^;\x1b]*)(?:;([^\x1b]*))?\x1b\\")


class Terminal:
    def __init__(self, answer: bytes) -> None:
        self._master, self.slave = pty.openpty()
        self._answer = answer
        self.asked = b""
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self.asked.endswith(b"\x1b[c"):
            try:
                self.asked += os.read(self._master, 100)
            except OSError:
                return
        os.write(self._master, self._answer)

    def close(self) -> None:
        os.close(self.slave)
        self._thread.join()
        os.close(self._master)


@pytest.fixture
def answering() -> Iterator[list[Terminal]]:
    """Standard input and output are the terminal that the test adds."""
    terminals: list[Terminal] = []
    yield terminals
    for each in terminals:
        each.close()


def protocol(answer: bytes, terminals: list[Terminal], monkeypatch: pytest.MonkeyPatch) -> str:
    terminal = Terminal(answer)
    terminals.append(terminal)
    with open(terminal.slave, "r+b", buffering=0, closefd=False) as stream:
        surroundings.set_stdin(monkeypatch, stream)
        picture_places.TERMINAL_ANSWERS_WITHIN.set(monkeypatch, 60.0)  # the answer comes from a thread of this process
        try:
            with contextlib.redirect_stdout(cast("TextIO", stream)):
                return graphics_of_terminal()
        finally:
            monkeypatch.undo()


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (b"\x1b_Gi=31;OK\x1b\\\x1b[?62;c", "kitty"),
        (b"typed\x1b_Gi=31;OK\x1b\\\x1b[?62;4c", "kitty"),
        (b"\x1b[?62;4;22c", "sixel"),
        (b"\x1b[?62;14;24c", "blocks"),
        (b"\x1b_Gi=31;ENOTSUPPORTED:no\x1b\\\x1b[?1;2c", "blocks"),
    ],
)
def test_a_terminal_is_asked(
    answer: bytes, expected: str, answering: list[Terminal], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert protocol(answer, answering, monkeypatch) == expected


def test_a_terminal_that_does_not_answer(answering: list[Terminal], monkeypatch: pytest.MonkeyPatch) -> None:
    picture_places.TERMINAL_ANSWERS_WITHIN.set(monkeypatch, 0.2)
    terminal = Terminal(b"")
    answering.append(terminal)
    assert terminal_answer(terminal.slave, terminal.slave) == b""


def test_without_a_terminal_nothing_is_asked() -> None:
    assert graphics_of_terminal() == "blocks"


def test_sixel_without_its_library(monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "textual_image", "PIL")
    assert why_no_graphics("sixel")
    assert why_no_graphics("kitty") == why_no_graphics("blocks") == ""


def test_kitty_gets_a_png_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    picture_places.CELL_SIZE.set(monkeypatch, lambda: _CELL)
    noise = Pixels(100, 80, os.urandom(24_000))
    commands = _COMMAND.findall(ImagePrinter("kitty").printed(noise, 50, 10))
    assert len(commands) > 2
    assert all(len(payload) <= picture_places.GRAPHICS_CHUNK.value for _, payload in commands)
    first = dict(pair.split("=") for pair in commands[0][0].split(","))
    assert (first["a"], first["f"], first["c"], first["r"], first["m"]) == ("T", "100", "25", "10", "1")
    assert [keys for keys, _ in commands[1:]] == ["m=1"] * (len(commands) - 2) + ["m=0"]
    image = Image.open(io.BytesIO(base64.b64decode("".join(payload for _, payload in commands))))
    assert image.size == (100, 80)
    assert image.convert("RGB").tobytes() == noise.data
    assert _COMMAND.fullmatch(ImagePrinter("kitty").closed())


def test_sixels_select_each_colour_that_they_define(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some terminals select it with its definition, xterm does not."""
    picture_places.CELL_SIZE.set(monkeypatch, lambda: _CELL)
    printed = ImagePrinter("sixel").printed(RED, 10, 11)
    size = re.match(r'\x1bP[0-9;]*q"1;1;([0-9]+);([0-9]+)', printed)
    assert size is not None
    assert (int(size[1]), int(size[2])) == (100, 50)
    assert re.search(r"#([0-9]+);2;100;0;0(#\1)+!", printed)
    assert printed.endswith("\x1b\\")
    assert ImagePrinter("sixel").closed() == ""

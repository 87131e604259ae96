"""A command that gets the terminal: an interrupt before it has the keys is for it, and not for the console."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from typing import TYPE_CHECKING, Any, cast

from rsb_extras.own_commands.interactive import run_in_terminal

if TYPE_CHECKING:
    from collections.abc import Iterator


class Console:
    """Ctrl+C is pressed as soon as the terminal's own keys are back."""

    def __init__(self) -> None:
        self.terminal = os.open(os.devnull, os.O_RDWR)

    @contextlib.contextmanager
    def suspend(self) -> Iterator[None]:
        os.kill(os.getpid(), signal.SIGINT)
        yield


def test_interrupt_before_the_command_has_the_keys_is_for_it() -> None:
    ended: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: ended.append(number))  # as a console's, which would end
    console = Console()
    try:
        assert asyncio.run(run_in_terminal(cast("Any", console), "exec sleep 5")) == -signal.SIGINT
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
        os.close(console.terminal)
    assert ended == [signal.SIGINT], "only the one that comes after it"

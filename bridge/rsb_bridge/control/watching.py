"""Watches an engine in a few figures: for a screen of many, each of which costs one task and some hundred bytes."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.control import protocol
from rsb_bridge.control.features import hello
from rsb_bridge.control.folders import ControlError
from rsb_bridge.control.protocol import ProtocolError
from rsb_bridge.model.robot_summary import SUMMARY_BYTES

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

    from rsb_bridge.control.ways import Connection, Way

ANSWERS_WITHIN = 5.0
_HELD_FOR = 0.25
_SILENT_FOR = 3 * protocol.SIGN_OF_LIFE_EVERY


async def watch(way: Way, may_open: asyncio.Semaphore | None = None) -> AsyncGenerator[bytes, None]:
    """An engine's figures, as they change, on the running loop; whoever stops to iterate closes it (`aclose`).

    Args:
        way: leads to the engine.
        may_open: held while the connection is made, for 0.25 s at most, or None.

    Yields:
        The content of each `rsb_bridge.control.protocol.Summary`. It is the engine's word, and not checked yet.

    Raises:
        ControlError: it cannot be watched, or not any more, and this is why.
    """
    try:
        connection = await _open(way, may_open)
        with contextlib.ExitStack() as leaving:
            leaving.callback(connection.abort)
            connection.write(protocol.encode(hello(read_only=True)))
            connection.write(protocol.encode(protocol.Watch()))
            frames = protocol.frames_to_console(protocol.TO_WATCHER_LIMIT)
            while True:
                async with asyncio.timeout(_SILENT_FOR):
                    data = await connection.read()
                if not data:
                    raise ControlError(f"{way.text}: the bridge's process has ended, or has closed the connection")
                for message in frames.feed(data):
                    if isinstance(message, protocol.Summary) and len(message.content) <= SUMMARY_BYTES:
                        yield message.content
                    elif isinstance(message, (protocol.Goodbye, protocol.Refused)):
                        raise ControlError(f"{way.text}: {message.reason}")
                    elif not isinstance(message, protocol.Welcome):
                        raise ControlError(f"{way.text}: an answer to what nobody has asked")
    except TimeoutError:
        raise ControlError(f"{way.text}: the bridge does not answer") from None
    except ProtocolError as error:
        raise ControlError(f"{way.text}: {error}") from None
    except OSError as error:
        raise ControlError(f"{way.text}: {error.strerror or error}") from None


async def _open(way: Way, may_open: asyncio.Semaphore | None) -> Connection:
    """Connect; engines that do not answer, which strangers may announce, soon give place to others."""
    async with may_open or contextlib.nullcontext():
        opening = asyncio.create_task(way.open(ANSWERS_WITHIN))
        try:
            await asyncio.wait([opening], timeout=_HELD_FOR)
        except asyncio.CancelledError:
            opening.cancel()
            raise
    try:
        return await opening
    except asyncio.CancelledError:
        opening.cancel()
        raise

"""Has an engine do what a console asks for: the other end of `rsb_bridge.control.client.RemoteEngine`."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from rsb_bridge.control import commands
from rsb_bridge.model.benchmark import Outcome
from rsb_bridge.model.history import HistoryReport
from rsb_bridge.model.snapshot import PeekedMessage, Reloaded, TopicInfo

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.commands import Command

T = TypeVar("T")
Answer: TypeAlias = str | tuple[TopicInfo, ...] | PeekedMessage | Reloaded | HistoryReport | Outcome | None


async def perform(
    command: Command, engine: EngineApi, *, step: Callable[[str], None], stop_process: Callable[[], None]
) -> Answer:
    """Have the engine do it.

    Args:
        command: what to do.
        engine: does it.
        step: is told each step of a restart, on the engine's thread.
        stop_process: does what `rsb_bridge.control.commands.Stop` asks for.

    Raises:
        EngineError: it does not.
    """
    match command:
        case commands.AddTopic():
            return await _done(engine.add_topic(command.topic, command.link))
        case commands.EditTopic():
            return await _done(engine.edit_topic(command.key, command.topic, drop_arm=command.drop_arm))
        case commands.RemoveTopic():
            await _done(engine.remove_topic(command.key, drop_arm=command.drop_arm))
        case commands.Pause():
            await _done(engine.pause(command.key, command.paused))
        case commands.Acknowledge():
            await _done(engine.acknowledge(command.key, command.acknowledged, link=command.link))
        case commands.ArmTopic():
            await _done(engine.arming.arm(command.key))
        case commands.DisarmTopic():
            await _done(engine.arming.disarm(command.key))
        case commands.KeepArmed():
            await _done(engine.arming.keep(pressed=command.pressed))
        case commands.ReleaseArmed():
            await _done(engine.arming.release())
        case commands.AddClient():
            await _done(engine.add_client(command.client))
        case commands.ChangeClient():
            await _done(engine.change_client(command.client))
        case commands.RemoveClient():
            await _done(engine.remove_client(command.name))
        case commands.Retry():
            await _done(engine.retry(command.link))
        case commands.ShutDown():
            await _done(engine.shut_down())
        case commands.Topics():
            found = await _done(engine.topics(command.link))
            return tuple(found)
        case commands.Peek():
            return await asyncio.wrap_future(engine.peek(command.key, kept=command.kept))
        case commands.Describe():
            return await asyncio.wrap_future(engine.describe(command.key))
        case commands.Template():
            return await asyncio.wrap_future(engine.template(command.key, command.lane))
        case commands.Call():
            return await asyncio.wrap_future(engine.call(command.key, command.request, command.lane))
        case commands.History():
            return await _done(engine.history(command.seconds))
        case commands.Bench():
            return await _done(engine.bench(command.order))
        case commands.Restart():
            await _done(engine.restart(step))
        case commands.Reload():
            return await _done(engine.reload(dry_run=command.dry_run))
        case commands.Stop():
            engine.told_to_stop()
            stop_process()
    return None


async def _done(future: Future[T]) -> T:
    """Wait for the engine, which finishes what it has begun even if nobody waits any more."""
    return await asyncio.shield(asyncio.wrap_future(future))

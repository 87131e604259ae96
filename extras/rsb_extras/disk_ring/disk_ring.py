"""The engine's part: gives the ring on disk what passes, and has it keep stretches."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EnginePart, EventCode, LinkError, operator, sanitize_text, state_folder
from rsb_extras.disk_ring.also_topics import AlsoTopics
from rsb_extras.disk_ring.keep_stretch import NOTE_LENGTH, KeepStretch, StretchAnswer
from rsb_extras.disk_ring.ring_codes import RingProblem
from rsb_extras.disk_ring.ring_files import RingClocks, RingPlace
from rsb_extras.disk_ring.ring_writer import RingWriter
from rsb_extras.disk_ring.stretches import NOTE, Occasion
from rsb_extras.recording import RECORD, record_limits
from rsb_extras.recording.passing_messages import passing_messages, recorded_topic

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.feature_api import Bridge, Context, Event, Snapshot, TopicSpec
    from rsb_extras.disk_ring.stretches import Reason
    from rsb_extras.recording import RecordLimits

REASONS: Mapping[str, Reason] = {
    EventCode.ROUTE_FAULT: "fault",
    EventCode.ROUTE_STALE: "fault",
    EventCode.LINK_PATH_FAULT: "fault",
    EventCode.LINK_LOST: "link",
    EventCode.ROUTE_DISARMED: "disarm",
    EventCode.OPERATOR_DISARMED: "disarm",
}
"""Events that keep a stretch, and as what."""


class DiskRing(EnginePart):
    """Answers `KeepStretch`, and keeps stretches by itself. Without `record.disk` it does nothing, and has no thread.

    Attributes:
        writer: the ring, or None while there is none.
    """

    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._context: Context = bridge.context
        self._passing = passing_messages(bridge)
        self._also = AlsoTopics(bridge, self._passing)
        self._limits: RecordLimits | None = None
        self.writer: RingWriter | None = None
        self._seen = 0
        self._asking: set[asyncio.Task[None]] = set()
        self._last: RingWriter | None = None
        self.handlers = {KeepStretch: self._keep}
        self.by_key = (((RECORD.name,), self._switch),)

    def open(self) -> None:
        self._switch()

    def tick(self, snapshot: Snapshot) -> None:
        if self.writer is None or self._limits is None:
            return
        self._also.look()
        for event in self._context.events.after(self._seen):
            self._seen = event.number
            reason = REASONS.get(event.code)
            if reason is not None and reason in self._limits.keep_on:
                self.writer.keep(self._occasion(event, reason))

    async def close(self) -> None:
        self._set(None)
        if self._last is not None:
            await asyncio.to_thread(self._last.join)
        for task in self._asking:
            task.cancel()

    def _switch(self) -> None:
        limits = record_limits(self._context.session)
        limits = None if limits is None or not limits.disk else limits
        if limits != self._limits:
            self._set(limits)

    def _set(self, limits: RecordLimits | None) -> None:
        if self.writer is not None:
            self._also.follow(())
            self._passing.end(self.writer.put)
            self.writer.stop(has_next=limits is not None)
        self._limits, self.writer = limits, None
        if limits is None:
            return
        context = self._context
        place = RingPlace(state_folder(os.environ), context.session.name, context.session.role)
        clocks = RingClocks(context.now, context.wall)
        self._seen = context.events.last
        self.writer = writer = RingWriter(place, limits, clocks, context.events, self._describe)
        writer.start(self._last)
        self._last = writer
        self._passing.give(writer.put)
        self._also.follow(limits.also)

    def _describe(self, topic: TopicSpec) -> None:
        """Find out what a file says of a topic. Called on the thread that writes."""

        async def ask(writer: RingWriter) -> None:
            writer.described(topic, await recorded_topic(self._context, topic))

        def begin() -> None:
            if self.writer is not None:
                task = self._context.loop.create_task(ask(self.writer))
                self._asking.add(task)
                task.add_done_callback(self._asking.discard)

        self._context.call(begin)

    # --- stretches

    def _occasion(self, event: Event, reason: Reason) -> Occasion:
        ago = min(max(0.0, self._context.wall() - event.time), 60.0)  # the wall clock may have been set meanwhile
        return Occasion(self._context.now() - ago, event.time, reason, event.text, event.topic or event.link)

    async def _keep(self, command: KeepStretch) -> StretchAnswer:
        if self.writer is None or self._limits is None:
            raise LinkError(RingProblem.OFF())
        ago, note = min(command.ago, self._limits.before), sanitize_text(command.note, NOTE_LENGTH)
        now, wall = self._context.now(), self._context.wall()
        occasion = Occasion(now - ago, wall - ago, NOTE, note, operator())
        path = await asyncio.wrap_future(self.writer.keep(occasion))
        return StretchAnswer(str(path), os.uname().nodename, self._limits.before, self._limits.after)

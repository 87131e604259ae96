"""The engines of a fleet over Zenoh, through the summaries that each engine sends to an operator."""

from __future__ import annotations

import asyncio
import contextlib
import random
import threading
import time
from concurrent.futures import Future
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.control.summaries import watch
from rsb_bridge.feature_api import RobotState, RobotSummary, attach, sanitize_text
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.robot_summary import WHY_LENGTH, decode
from rsb_extras.operators.zenoh_fleet import FleetConnector, FleetPresence

if TYPE_CHECKING:
    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.operators.fleet_file import FleetFile
    from rsb_extras.operators.zenoh_fleet import Member

_ENDED_WITHIN = 5.0  # s; the thread is a daemon, so that a longer wait would only hold up the exit
_FIRST_HEARD_WITHIN = 10.0
"""Seconds that `ZenohFleet.wait` waits at most for the first report of each engine. All of 201 engines have reported
after 3 to 7 s (bench/README.md, A fleet); a shorter wait would leave the last ones out of a group."""
MOST = 2000
"""Engines that are watched, and rows; anybody in the network may announce any number of engines."""
_KEPT = 1.0
"""s for which the row of an engine that left is kept: where the router is lost, Zenoh says first that all have left."""
_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 30.0
"""s between attempts to watch an engine. Round figures: one that refuses for a while is asked again so late at most."""
_AT_ONCE = 64
"""Connections that begin at a time: 200 handshakes would take a core for a moment. A round figure."""


class ZenohFleet:
    """Fulfils `rsb_extras.fleet.fleet.FleetSource`: one robot for each engine that announces itself.

    While the router is out of reach, those from before stay.

    Args:
        file: fleet file with the fleet and the operator.
    """

    kind = "fleet"
    gone = "it has left the Zenoh network"
    empty = "no bridge announces itself; set `zenoh` and this fleet's name in a session."

    def __init__(self, file: FleetFile) -> None:
        self.name = file.zenoh.fleet
        self.way = f" --fleet {file.path}"
        self._file = file
        self._robots: dict[str, RobotSummary] = {}
        self._presence: FleetPresence | None = None
        self._watches: dict[str, asyncio.Task[None]] = {}
        self._names: dict[str, str] = {}  # of rows, by address
        self._called: dict[str, str] = {}  # what the engine of a row calls itself
        self._silent: set[str] = set()  # addresses of engines whose state has not come yet
        self._may_connect = asyncio.Semaphore(_AT_ONCE)
        self._random = random.Random()  # noqa: S311 -- jitter
        # Other threads call into the loop, so that it exists before the runner.
        self._loop = asyncio.new_event_loop()
        self._started: Future[None] = Future()
        self._ends = asyncio.Event()
        self._news = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="rsb-fleet", daemon=True)

    # --- from any thread

    @property
    def problem(self) -> str:
        presence = self._presence
        return presence.problem if presence is not None else "not in the Zenoh network"

    def start(self) -> None:
        self._thread.start()
        self._started.result()

    def wait(self) -> None:
        heard = asyncio.run_coroutine_threadsafe(self._all_heard(), self._loop)
        with contextlib.suppress(TimeoutError):
            heard.result(_FIRST_HEARD_WITHIN)
        # Without this, it would wait on for an engine that may never speak.
        heard.cancel()

    def stop(self) -> None:
        with contextlib.suppress(RuntimeError):  # it has ended by itself
            self._loop.call_soon_threadsafe(self._ends.set)
        if self._thread.is_alive():
            self._thread.join(_ENDED_WITHIN)

    def robots(self) -> list[RobotSummary]:
        return list(self._robots.values())

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        return attach(FleetConnector(self._file, self._called.get(robot, robot)), read_only=read_only)

    # --- on its thread

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._main())

    async def _main(self) -> None:
        presence = FleetPresence(self._file)
        presence.changed = self._changed
        try:
            await presence.join()
        except OSError as error:
            presence.close()
            self._started.set_exception(ControlError(str(error)))
            return
        self._presence = presence
        self._started.set_result(None)
        try:
            await self._ends.wait()
        finally:
            presence.changed = _ignore  # else engines that come meanwhile are watched by nobody who ends that
            for watch in tuple(self._watches.values()):
                watch.cancel()
            await asyncio.gather(*self._watches.values(), return_exceptions=True)
            presence.close()

    async def _all_heard(self) -> None:
        """Wait for the first report of every engine present."""
        while self._silent:
            self._news.clear()
            await self._news.wait()

    def _changed(self, member: Member, comes: bool) -> None:
        self._loop.call_later(_KEPT, self._forget_left)
        if not comes:
            name = self._names.pop(member.address, None)
            self._has_spoken(member)  # or `wait` would wait for one that has gone
            if watch := self._watches.pop(member.address, None):
                watch.cancel()
            if name is not None:
                why = "out of reach: this console has lost its Zenoh router" if self.problem else self.gone
                self._gone(name, why, RobotState.MISSING)
                if name == member.name:
                    self._hand_on(name)
        elif len(self._watches) < MOST:
            name = self._names[member.address] = self._free_name(member.name)
            self._called[name] = member.name
            self._silent.add(member.address)
            if name not in self._robots:
                if len(self._robots) >= MOST:
                    self._forget_one()
                self._robots[name] = RobotSummary(
                    name=name, version=member.version, why="connecting", since=time.time()
                )
            self._watches[member.address] = self._loop.create_task(self._watch(member, name))

    def _hand_on(self, name: str) -> None:
        """Give the row of an engine that left to another one of the same name, which then needs no number."""
        assert self._presence is not None
        heir = next((address for address, row in self._names.items() if self._called[row] == name), None)
        if heir is not None:
            row = self._names.pop(heir)
            self._watches.pop(heir).cancel()
            del self._robots[row], self._called[row]
            self._changed(self._presence.members[heir], comes=True)

    def _forget_left(self) -> None:
        """Drop the rows of engines that have left: `RobotFleet` remembers them, and an operator may dismiss them."""
        for name in () if self.problem else self._robots.keys() - self._names.values():
            del self._robots[name], self._called[name]

    def _forget_one(self) -> None:
        """Make room for a row: drop one whose engine has left, preferably one that never reported a state."""
        gone = self._robots.keys() - self._names.values()
        name = min(gone, key=lambda name: (self._robots[name].seen is not None, self._robots[name].since))
        del self._robots[name], self._called[name]

    def _free_name(self, name: str) -> str:
        """Return a unique name for a row; two engines of one name are both shown."""
        taken, number = set(self._names.values()), 1
        free = name
        while free in taken:
            number += 1
            free = f"{name} ({number})"
        return free

    async def _watch(self, member: Member, name: str) -> None:
        """Read an engine's reports until cancelled."""
        assert self._presence is not None
        way = self._presence.sealed(member)
        backoff = Backoff(_FIRST_PAUSE, _LONGEST_PAUSE, self._random)
        while True:
            try:
                async with contextlib.aclosing(watch(way, self._may_connect)) as contents:
                    async for content in contents:
                        self._receive(name, decode(content))
                        self._has_spoken(member)
                        backoff.reset()
            except (ControlError, ValueError) as error:
                self._gone(name, str(error).removeprefix(f"{member.name}: "), RobotState.FAULT)
                self._has_spoken(member)
            await asyncio.sleep(backoff.next())

    def _has_spoken(self, member: Member) -> None:
        """Stop waiting for an engine's first report."""
        self._silent.discard(member.address)
        self._news.set()

    def _receive(self, name: str, summary: RobotSummary) -> None:
        now = time.time()
        before, why, state = self._robots[name], summary.why, summary.state
        # What the engine says of times is by its clock, which nobody has set by this one: only their ages are known.
        ahead = 0.0 if summary.seen is None else summary.seen - now
        since = min(now, summary.since - ahead)
        if name != summary.name:  # only an engine with one of this operator's keys can cause this
            why, state = f"another engine is named {summary.name}, too: rename one of them", RobotState.WARN
            since = before.since if (before.state, before.why) == (state, why) else now
        if (battery := summary.battery) is not None:
            battery = battery._replace(time=min(now, battery.time - ahead))
        self._robots[name] = msgspec.structs.replace(
            summary, name=name, why=why, state=state, seen=now, since=since, battery=battery
        )

    def _gone(self, name: str, why: str, state: RobotState) -> None:
        why = sanitize_text(why, WHY_LENGTH)  # it may be the engine's
        before = self._robots[name]
        if (before.state, before.why) != (state, why):
            self._robots[name] = RobotSummary(
                name=name, group=before.group, role=before.role, state=state, why=why, since=time.time(),
                seen=before.seen, host=before.host, version=before.version, links=before.links, routes=before.routes,
            )  # fmt: skip


def _ignore(_: Member, __: bool) -> None:
    """Ignore engines that come or go."""

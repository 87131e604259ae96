"""Lists recordings of both sides, and gets those of the other side: each fetch goes on until it is done or given up.

Fetches live in folders of their own, so that they outlive this process; one at a time of each link is under way.
"""

from __future__ import annotations

import asyncio
import errno
import os
import shutil
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from rsb_bridge.feature_api import (
    TEXT_LENGTH,
    EnginePart,
    Level,
    LinkError,
    Wording,
    file_stem,
    link_named,
    operator,
    sanitize_text,
    state_folder,
    why_not_written,
)
from rsb_extras.courier import RECORDINGS_KEY
from rsb_extras.courier.completed_recording import AskedCompletion, CompletedName, CompletedRecording
from rsb_extras.courier.completion_spool import METADATA_WITHIN, CompletionSpool, completed_in
from rsb_extras.courier.courier_records import LATEST, ListedRecording, Wanted, called
from rsb_extras.courier.courier_requests import (
    LISTED_WITHIN,
    CancelFetch,
    FetchRecording,
    FetchReport,
    FetchState,
    ListFetches,
    ListRecordings,
    NewestRecordings,
    ReadCompleted,
    RecordingGroup,
)
from rsb_extras.courier.fetch_spool import GONE, SPOOL, AskedFetch, FetchSpool, Spool, load_asked
from rsb_extras.courier.fetched_folder import FolderFullError, make_room
from rsb_extras.courier.kept_recordings import FetchError, KeptRecordings
from rsb_extras.courier.link_courier import CourierCode, LinkCourier
from rsb_extras.courier.live_parts import named, overlapping, own_files, parts_of
from rsb_extras.courier.pieces import PieceError
from rsb_extras.recording.mcap_file import McapError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Link, Snapshot
    from rsb_extras.courier.live_parts import LivePart

MOST_FETCHES = 16
"""Under way or waiting. A round figure: one of a link comes after the other."""
_REMEMBERED = 16
"""Fetches that have ended, which are still reported."""
_AGAIN_AFTER, _DISK_AGAIN_AFTER, _LONGEST_PAUSE = 2.0, 30.0, 60.0
"""s until a fetch is tried again: after the other side did not give it, twice as long each time; after the disk took
nothing; and at most. Round figures."""
_RATE_OVER = 30.0
"""s over which the rate is reckoned: some pieces at 1 Mbit/s. A round figure."""


_BOUNDED_EACH = 64 << 20
"""Bytes that come before the size of the folder is looked at again. A round figure."""


class FetchProblem(Wording):
    """The reason why there is no fetch."""

    UNKNOWN = "{link} lists no recording {name}: see rsb-console record list {link}"
    SEVERAL = "{link} has several recordings {name}: give its id, one of {ids}"
    NO_TOPIC = "recording {name} has no topic {topic} that this side may read; it has {topics}"
    TOO_MANY_TOPICS = "recording {name} has more topics than cross at once: name those to get"
    NO_TOPICS = "recording {name} has no topic that this side may read{problem}"
    SPAN = "recording {name} has nothing in this span: it has {seconds:.0f} s"
    TOO_MANY = "{most} fetches are under way: cancel one of them, or wait"
    NO_FETCH = "there is no fetch {name} under way"
    NOT_READ = "{name} cannot be read: {reason}"
    NOT_COMPLETED = "{name} completes no recording: see rsb-console record get --complete"
    NOT_WRITTEN = "{path} is not written: {reason}"
    NO_LINK = "waits for {link}: {reason}"
    NEXT = "waits for another fetch of {link}"
    GONE = "this session has no link {link} now"
    CANCELLED = "given up by {who}"
    STOPS = "the bridge stops"
    NONE = "recording {name} is not got: {reason}"
    REMOVED = "{path} was the oldest that was fetched, and is removed: recordings.fetched is {most:g} GB"


class _Progress(NamedTuple):
    at: float
    taken: int
    share: float


class Fetch:
    """A fetch of this process.

    Attributes:
        reason: why it waits, or has failed.
        again_at: s, before which it is not tried again.
        pause: s from the last attempt to that.
    """

    def __init__(self, spool: Spool, now: float) -> None:
        self.spool = spool
        self.state = FetchState.WAITING
        self.reason = ""
        self.again_at, self.pause = now, _AGAIN_AFTER / 2
        self.messages = 0
        self.task: asyncio.Task[None] | None = None
        self._progress = deque([_Progress(now, spool.taken, spool.share)])

    @property
    def asked(self) -> AskedFetch:
        return self.spool.asked

    @property
    def is_over(self) -> bool:
        return self.state in (FetchState.DONE, FetchState.FAILED)

    def count(self, now: float) -> None:
        """Remember how far it is at `now` (s)."""
        self._progress.append(_Progress(now, self.spool.taken, self.spool.share))
        while self._progress[0].at < now - _RATE_OVER:
            self._progress.popleft()

    def report(self, now: float) -> FetchReport:
        first, share, taken = self._progress[0], self.spool.share, self.spool.taken
        seconds, is_done = now - first.at, self.state is FetchState.DONE
        runs = self.state is FetchState.FETCHING and seconds > 0
        gained = share - first.share
        return FetchReport(
            self.asked.name, self.asked.link, self.asked.listed.name, self.state, 1.0 if is_done else share, taken,
            rate=max(0.0, (taken - first.taken) / seconds) if runs else 0.0,
            rest=min((1.0 - share) / gained * seconds, 1e9) if runs and gained > 0 else None,
            messages=self.messages, path=str(self.spool.path) if is_done else "", reason=sanitize_text(self.reason),
            completed=self.spool.completed if is_done else None, completes=self.asked.completes is not None,
        )  # fmt: skip


class CourierPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._context = bridge.context
        self._kept = bridge.context.shared(KeptRecordings)
        self._fetches: dict[str, Fetch] = {}
        self._stopping = False
        self._loading: asyncio.Task[None] | None = None
        self._bounding: asyncio.Task[None] | None = None
        self._bounded_at = 0  # bytes of all fetches when the folder was looked at last
        self._asking = asyncio.Lock()
        self.handlers = {
            ListRecordings: self._list,
            NewestRecordings: self._newest,
            FetchRecording: self._fetch_or_tell,
            ListFetches: self._reports,
            ReadCompleted: self._completed,
            CancelFetch: self._cancel,
        }
        self.by_key = (((RECORDINGS_KEY.name,), lambda: None),)  # it is read whenever it is needed

    @property
    def _owner(self) -> str:
        session = self._context.session
        return f"{session.role} {session.name}"

    def open(self) -> None:
        if any(next(self._kept.fetched.glob(f".*{end}"), None) is not None for end in (SPOOL, GONE)):
            self._loading = self._context.loop.create_task(self._load())

    async def _load(self) -> None:
        """Take up the fetches of this session that a bridge before has left."""
        for spool in await asyncio.to_thread(_spools, self._kept.fetched, self._owner, lambda: self._stopping):
            self._fetches.setdefault(spool.asked.name, Fetch(spool, self._context.now()))

    # --- lists

    async def _list(self, command: ListRecordings) -> tuple[RecordingGroup, ...]:
        if command.link:
            return (await self._of_link(link_named(command.link, self._bridge.links())),)
        own = () if command.there else (RecordingGroup(recordings=tuple(await self._kept.all(None))),)
        others = () if command.here else self._bridge.links()
        groups = (*own, *await asyncio.gather(*map(self._of_link, others)))
        return tuple(group for group in groups if group.recordings or group.problem)

    async def _of_link(self, link: Link) -> RecordingGroup:
        try:
            return RecordingGroup(link.name, await link.extensions.find(LinkCourier).recordings())
        except LinkError as error:
            return RecordingGroup(link.name, problem=sanitize_text(str(error)))

    async def _newest(self, command: NewestRecordings) -> tuple[RecordingGroup, ...]:
        here = await self._kept.newest(command.most)
        there = (
            link.extensions.find(LinkCourier).newest_kept(command.most)
            for link in self._bridge.links()
            if command.link in ("", link.name)
        )
        return (RecordingGroup(recordings=tuple(here)), *there)

    async def _completed(self, command: ReadCompleted) -> CompletedRecording:
        return await asyncio.to_thread(self._read_completed, sanitize_text(command.recording, TEXT_LENGTH))

    def _read_completed(self, name: str) -> CompletedRecording:
        try:
            found = completed_in(named(self._kept.of_this_side(), name).beginning(METADATA_WITHIN))
        except OSError as error:
            raise LinkError(FetchProblem.NOT_READ(name=name, reason=error.strerror)) from None
        if found is None:
            raise LinkError(FetchProblem.NOT_COMPLETED(name=name))
        return found

    # --- fetches

    async def _fetch_or_tell(self, command: FetchRecording) -> str:
        """Begin a fetch, or log why there is none: nobody may wait for the answer by then."""
        began = self._context.now()
        try:
            return await self._fetch(command)
        except LinkError as error:
            if self._context.now() - began >= LISTED_WITHIN:
                text = FetchProblem.NONE(name=sanitize_text(command.recording, TEXT_LENGTH), reason=error)
                self._bridge.log.add(CourierCode.FAILED, text, level=Level.WARNING, link=command.link)
            raise

    async def _fetch(self, command: FetchRecording) -> str:
        link = link_named(command.link, self._bridge.links())
        if self._loading is not None:
            await asyncio.shield(self._loading)
        async with self._asking:  # names are given one after the other
            listed = _chosen(command, await link.extensions.find(LinkCourier).recordings())
            if command.completes:
                completes, wanted = _completed(command, link, listed)
            else:
                completes, wanted = None, _wanted(command, listed)
            for fetch in self._fetches.values():
                asked = fetch.asked
                is_same = (asked.link, asked.wanted, _timeless(asked.completes)) == (
                    link.name, wanted, _timeless(completes),
                )  # fmt: skip
                if is_same and not fetch.is_over:
                    return fetch.asked.name
            if sum(not each.is_over for each in self._fetches.values()) >= MOST_FETCHES:
                raise LinkError(FetchProblem.TOO_MANY(most=MOST_FETCHES))
            try:
                await self._make_room()
            except (FolderFullError, OSError) as error:
                raise LinkError(str(error)) from None
            parts: Sequence[LivePart] = ()
            if completes is not None:
                parts = await asyncio.to_thread(self._live, command, listed, completes)
            who = sanitize_text(operator(), TEXT_LENGTH)
            asked = AskedFetch("", self._owner, link.name, listed, wanted, who, completes)
            spool = await self._new_spool(asked, parts)
            name = spool.asked.name
            self._fetches[name] = Fetch(spool, self._context.now())
        self._log(CourierCode.ASKED, spool.asked, f"asked for by {spool.asked.who}")
        over = [name for name, each in self._fetches.items() if each.is_over]
        for each in over[:-_REMEMBERED]:
            del self._fetches[each]
        self._go_on()
        return name

    def _live(self, command: FetchRecording, listed: ListedRecording, completes: AskedCompletion) -> Sequence[LivePart]:
        """Return what came live of a span, on any thread; raises LinkError."""
        if command.live:
            return parts_of(named(self._kept.of_this_side(), command.live), command.live)
        behind = round((completes.ahead or 0.0) * 1e9)
        own = (each for each in self._kept.own() if each.id != listed.id)
        files = own_files(state_folder(os.environ), self._context.session, own)
        names = [each.here for each in completes.topics]
        return overlapping(files, names, completes.begin - behind, completes.end - behind)

    async def _new_spool(self, asked: AskedFetch, parts: Sequence[LivePart]) -> Spool:
        folder = self._kept.fetched
        try:
            return await asyncio.to_thread(_new_spool, folder, asked, parts)
        except OSError as error:
            reason = why_not_written(error, folder)
            raise LinkError(FetchProblem.NOT_WRITTEN(path=error.filename or folder, reason=reason)) from None

    async def _reports(self, command: ListFetches) -> tuple[FetchReport, ...]:
        now = self._context.now()
        return tuple(each.report(now) for each in self._fetches.values() if command.link in ("", each.asked.link))

    async def _cancel(self, command: CancelFetch) -> None:
        fetch = self._fetches.get(command.name)
        if fetch is None or fetch.is_over or command.link not in ("", fetch.asked.link):
            raise LinkError(FetchProblem.NO_FETCH(name=sanitize_text(command.name, TEXT_LENGTH)))
        fetch.state, fetch.reason = FetchState.FAILED, FetchProblem.CANCELLED(who=operator())
        if fetch.task is not None:
            fetch.task.cancel()
            await asyncio.wait((fetch.task,))
        await asyncio.to_thread(fetch.spool.remove)
        self._log(CourierCode.CANCELLED, fetch.asked, fetch.reason)
        self._go_on()

    def tick(self, snapshot: Snapshot) -> None:
        self._go_on()
        is_bounding = self._bounding is not None and not self._bounding.done()
        if not is_bounding and abs(self._taken - self._bounded_at) >= _BOUNDED_EACH:
            self._bounding = self._context.loop.create_task(self._bound())

    @property
    def _taken(self) -> int:
        """Bytes of all fetches that are known."""
        return sum(fetch.spool.taken for fetch in self._fetches.values())

    async def _bound(self) -> None:
        """Have fetches wait while there is no room for them."""
        try:
            await self._make_room()
        except (FolderFullError, OSError) as error:
            for fetch in self._fetches.values():
                if fetch.task is not None and fetch.state is FetchState.FETCHING:
                    fetch.task.cancel()
                    self._wait(fetch, str(error), _DISK_AGAIN_AFTER)

    async def _make_room(self) -> None:
        """Remove the oldest files that were fetched, as far as the session's bound demands; raises as `make_room`."""
        self._bounded_at = self._taken
        most = RECORDINGS_KEY.of(self._context.session).fetched
        for path in await asyncio.to_thread(make_room, self._kept.fetched, most):
            self._bridge.log.add(CourierCode.REMOVED, FetchProblem.REMOVED(path=path, most=most))

    def _go_on(self) -> None:
        """Begin what can begin: of each link the oldest fetch."""
        links = {link.name: link for link in self._bridge.links()}
        busy = set()
        now = self._context.now()
        for fetch in self._fetches.values():
            if fetch.is_over:
                continue
            fetch.count(now)
            name = fetch.asked.link
            if fetch.task is not None:
                busy.add(name)
            elif (link := links.get(name)) is None:
                fetch.reason = FetchProblem.GONE(link=name)
            elif name in busy:
                fetch.reason = FetchProblem.NEXT(link=name)
            elif now >= fetch.again_at and not self._stopping:
                busy.add(name)
                fetch.task = self._context.loop.create_task(self._attempt(fetch, link))

    async def _attempt(self, fetch: Fetch, link: Link) -> None:
        """Get as much as comes, and write the file once all is there."""
        courier, spool, taken = link.extensions.find(LinkCourier), fetch.spool, fetch.spool.taken

        def stop() -> bool:
            return self._stopping or fetch.is_over

        try:
            while (row := await asyncio.to_thread(spool.next_row, stop)) is not None:
                fetch.state, fetch.reason = FetchState.FETCHING, ""
                await self._make_room()
                await courier.receive(row)
            fetch.state, fetch.reason = FetchState.WRITING, ""
            fetch.messages = await asyncio.to_thread(spool.write, stop)
        except LinkError as error:
            fetch.pause = _AGAIN_AFTER if spool.taken > taken else min(2 * fetch.pause, _LONGEST_PAUSE)
            self._wait(fetch, str(error), fetch.pause)
        except FolderFullError as error:
            self._wait(fetch, str(error), _DISK_AGAIN_AFTER)
        except InterruptedError:
            self._wait(fetch, FetchProblem.STOPS(), _AGAIN_AFTER)
        except OSError as error:
            reason = str(error) if error.errno == errno.ENOSPC else why_not_written(error, spool.folder)
            self._wait(fetch, FetchProblem.NOT_WRITTEN(path=spool.path, reason=reason), _DISK_AGAIN_AFTER)
        except (FetchError, PieceError, McapError) as error:
            await self._fail(fetch, str(error))
        else:
            fetch.state, fetch.reason = FetchState.DONE, spool.damage
            self._log(CourierCode.DONE, fetch.asked, f"{fetch.messages:,} messages written to {spool.path}")
        finally:
            fetch.task = None
            if not any(each.asked.link == link.name and not each.is_over for each in self._fetches.values()):
                courier.end()

    def _wait(self, fetch: Fetch, reason: str, seconds: float) -> None:
        fetch.state, fetch.reason = FetchState.WAITING, reason
        fetch.again_at = self._context.now() + seconds

    async def _fail(self, fetch: Fetch, reason: str) -> None:
        await asyncio.to_thread(fetch.spool.remove)
        fetch.state, fetch.reason = FetchState.FAILED, reason
        self._log(CourierCode.FAILED, fetch.asked, reason, Level.WARNING)

    def _log(self, code: CourierCode, asked: AskedFetch, text: str, level: Level = Level.INFO) -> None:
        self._bridge.log.add(
            code, f"recording {asked.listed.name} of {asked.link}: {text}", level=level, link=asked.link
        )

    async def close(self) -> None:
        self._stopping = True
        running = (self._loading, self._bounding, *(fetch.task for fetch in self._fetches.values()))
        tasks = [each for each in running if each is not None]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        for fetch in self._fetches.values():
            await asyncio.to_thread(fetch.spool.close)


def _chosen(command: FetchRecording, listed: tuple[ListedRecording, ...]) -> ListedRecording:
    name = command.recording.rstrip("/")
    found = called(name, listed)
    if len(found) > 1:
        ids = ", ".join(each.id for each in found)
        raise LinkError(FetchProblem.SEVERAL(link=command.link, name=name, ids=ids))
    if not found:
        raise LinkError(FetchProblem.UNKNOWN(link=command.link, name=sanitize_text(name, TEXT_LENGTH)))
    return found[0]


def _wanted(command: FetchRecording, listed: ListedRecording) -> Wanted:
    known = [each.name for each in listed.topics]
    for topic in command.topics:
        if topic not in known and not listed.more_topics:
            named = ", ".join(known) or "none"
            raise LinkError(FetchProblem.NO_TOPIC(name=listed.name, topic=topic, topics=named))
    if not command.topics and listed.more_topics:
        raise LinkError(FetchProblem.TOO_MANY_TOPICS(name=listed.name))
    if not (topics := tuple(sorted({*command.topics})) or tuple(known)):
        problem = listed.problem and f": {listed.problem}"
        raise LinkError(FetchProblem.NO_TOPICS(name=listed.name, problem=problem))
    if command.begin > command.end or command.begin > listed.end or command.end < listed.begin:
        raise LinkError(FetchProblem.SPAN(name=listed.name, seconds=(listed.end - listed.begin) / 1e9))
    return Wanted(listed.id, listed.stamp, topics, command.begin, command.end)


def _completed(command: FetchRecording, link: Link, listed: ListedRecording) -> tuple[AskedCompletion, Wanted]:
    """Return what completes what came live: topics that the recording has not are looked for on this side only."""
    routes = [route for route in link.routes.values() if route.purpose.is_shown]
    far_names = {route.local_topic: route.far_topic for route in routes}
    near_names = {route.far_topic: (route.local_topic, not route.outgoing) for route in routes}
    there = [far_names.get(topic, topic) for topic in command.topics] or [each.name for each in listed.topics]
    if not command.topics:
        _wanted(command, listed)  # with the reason why there are none, or too many
    topics = [CompletedName(topic, *near_names.get(topic, (topic, True))) for topic in dict.fromkeys(there)]
    begin = command.begin or listed.begin
    end = listed.end or LATEST if command.end == LATEST else command.end
    if begin > end or (listed.end and begin > listed.end) or end < listed.begin:
        raise LinkError(FetchProblem.SPAN(name=listed.name, seconds=(listed.end - listed.begin) / 1e9))
    ahead = link.clock.offset
    wanted = Wanted(listed.id, listed.stamp, tuple(each.there for each in topics), begin, end, heads=True)
    is_open = bool(command.live) and (command.begin, command.end) == (0, LATEST)
    return AskedCompletion(tuple(topics), begin, end, is_open, ahead, command.live), wanted


def _timeless(completes: AskedCompletion | None) -> AskedCompletion | None:
    """Return what is completed without what a link measures anew all the time."""
    return completes and replace(completes, ahead=None)


def _new_spool(folder: Path, asked: AskedFetch, parts: Sequence[LivePart]) -> Spool:
    """Return a new spool by a name that nothing has yet."""
    end = "" if asked.completes is None else "-completed"
    name = asked.listed.name.removesuffix(".mcap").removesuffix(".db3")
    stem = file_stem(f"{asked.link}-{name}") + end
    for number in range(1, 1000):
        name = stem if number == 1 else f"{stem}-{number}"
        if not (folder / f"{name}.mcap").exists() and not _spool_folder(folder, name).exists():
            asked = replace(asked, name=name)
            if asked.completes is None:
                return FetchSpool(_spool_folder(folder, name), asked).make()
            return CompletionSpool(_spool_folder(folder, name), asked, parts).make()
    raise FileExistsError(errno.EEXIST, "has too many files of this name: move or remove some", str(folder / stem))


def _spool_folder(folder: Path, name: str) -> Path:
    return folder / f".{name}{SPOOL}"


def _spools(folder: Path, owner: str, stop: Callable[[], bool]) -> list[Spool]:
    found: list[Spool] = []
    for each in folder.glob(f".*{GONE}"):  # of a bridge that was killed meanwhile
        shutil.rmtree(each, ignore_errors=True)
    for each in sorted(folder.glob(f".*{SPOOL}")):
        asked = load_asked(each)
        if asked is not None and asked.owner == owner and not stop():
            spool = FetchSpool(each, asked) if asked.completes is None else CompletionSpool(each, asked)
            if not spool.is_made:
                spool.remove()
                continue
            spool.rows[0].load(stop)
            found.append(spool)
    return found

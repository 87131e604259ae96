"""The process that draws: ``python -m rsb_extras.pictures.worker``.

It reads a `Task` from standard input, and writes its `Picture` to standard output, each as four bytes of length,
big-endian, and MessagePack. It ends with its input. `rsb_extras.pictures.renderer` starts it, and kills it if it takes
too long; it limits its own memory and rights.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import msgspec

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import DescriptionError, read_description
from rsb_bridge.feature_api import Wording, sanitize_text
from rsb_extras.pictures.confinement import confine
from rsb_extras.pictures.drawing import VIEWS, TakenMessage, UndrawableError, number, package_of_view, view_class
from rsb_extras.pictures.picture import PICTURE_LIMIT, Picture, Wish

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message
    from rsb_bridge.cdr.description import TypeDescription
    from rsb_extras.pictures.drawing import View

MEMORY_LIMIT = 1 << 30
"""Bytes of address space that drawing may add to that of the started process: a round figure."""
VIEWS_AT_MOST = 64
"""Views whose messages are remembered: a round figure, as are the next two."""
TYPES_AT_MOST = 64
"""Descriptions that are remembered."""
_ELEMENTS, _STEPS = 100_000, 500_000
"""Messages in an array, and values, that are read from one message at most."""
_ENCAPSULATION, _CONTENT_AT = 4, 12
"""Bytes before a message's first field, and before the second one of a header, which begins with the stamp."""
_NICE = 10
"""On a busy core, the bridge's messages come before pictures."""
_SECONDS = 60
"""s, more than the renderer waits: the process ends, even if the process that started it is gone."""
_LENGTH_BYTES = 4


class Undrawable(Wording):
    """The reason why there is no picture."""

    LIBRARY_MISSING = "{library} is not installed where {topic} is published: pip install 'rsb-console[look]' there"
    MODULE_MISSING = (
        "the view of {how} by the package {package} needs the Python module {module}, which is missing where {topic} "
        "is published: install that there, or remove {package}"
    )
    TOO_LARGE = "the picture has {size:,} bytes; at most {limit:,} are sent: make the window smaller"
    FAILED = "the message cannot be drawn: {error}"
    UNKNOWN_HOW = "there is no view {how!r}: choose one of {known}"


class TakenSample(msgspec.Struct, frozen=True, array_like=True):
    """A message as it was taken from DDS.

    Attributes:
        payload: serialized, with its encapsulation header.
        stamp: ns since the epoch, when DDS received it.
        author: full name of the node that published it, or empty if unknown.
        is_asked: whether the viewer named the topic (`TakenMessage.is_asked`).
    """

    topic: str
    type_name: str
    payload: bytes
    stamp: int
    author: str = ""
    is_asked: bool = True


class Task(msgspec.Struct, frozen=True, array_like=True):
    """A picture to draw.

    Attributes:
        view: number of the view, whose earlier messages are remembered.
        type_name: of its first topic.
        samples: messages since the last task, oldest first.
        seen: messages that the view's topics had so far, including the ones left out.
        size: bytes of the newest message.
        descriptions: texts that describe the types (`rsb_bridge.cdr.description`), with their names and hashes.
        now: ns since the epoch, on the clock of the samples' stamps, or 0.
        ended: whether the view is over: forget it, and answer nothing.
    """

    view: int
    type_name: str
    wish: Wish
    samples: tuple[TakenSample, ...] = ()
    seen: int = 0
    size: int = 0
    descriptions: tuple[tuple[str, str, str], ...] = ()
    now: int = 0
    ended: bool = False


class _Newest(NamedTuple):
    """The newest message that a view took.

    Attributes:
        taken, stamp, changed: as in `Picture`.
    """

    taken: int = 0
    stamp: int = 0
    changed: int = 0
    payload: bytes = b""

    def followed_by(self, sample: TakenSample, stamp: int) -> _Newest:
        begins = _CONTENT_AT if stamp else _ENCAPSULATION
        is_same = memoryview(self.payload)[begins:] == memoryview(sample.payload)[begins:]
        if is_same and stamp and stamp == self.stamp:
            return self
        taken = max(self.taken, sample.stamp)
        return _Newest(taken, stamp, self.changed if is_same else taken, sample.payload)

    def noted_on(self, picture: Picture) -> Picture:
        return msgspec.structs.replace(picture, taken=self.taken, stamp=self.stamp, changed=self.changed)


class Artist:
    """Draws the pictures of all views."""

    def __init__(self) -> None:
        self._types: dict[tuple[str, str], TypeDescription] = {}
        self._views: dict[int, tuple[str, View]] = {}
        self._newest: dict[int, _Newest] = {}

    def do(self, task: Task) -> Picture | None:
        """Draw a picture, or return None if the task only ends a view."""
        if task.ended:
            self._views.pop(task.view, None)
            self._newest.pop(task.view, None)
            return None
        about = Picture(messages=task.seen, size=task.size, type_name=sanitize_text(task.type_name, 255))
        about = self._newest.get(task.view, _Newest()).noted_on(about)
        try:
            picture = self._draw(task, about)
        except MemoryError:
            # The messages that it has gathered may take the memory.
            self._views.pop(task.view, None)
            return _failed(about, "a picture of this message needs too much memory")
        except ModuleNotFoundError as error:
            return _failed(about, _missing(error.name or str(error), task))
        except UndrawableError as error:
            return _failed(about, str(error))
        except Exception as error:  # noqa: BLE001 -- a message that breaks one picture must not break the next
            return _failed(about, Undrawable.FAILED(error=f"{type(error).__name__}: {error}"))
        if (size := len(msgspec.msgpack.encode(picture))) > PICTURE_LIMIT:
            return _failed(about, Undrawable.TOO_LARGE(size=size, limit=PICTURE_LIMIT))
        return picture

    def _draw(self, task: Task, about: Picture) -> Picture:
        types = {name: self._type(name, text, type_hash) for name, text, type_hash in task.descriptions}
        problem = ""
        for sample in task.samples:
            decoded = decode(types[sample.type_name], sample.payload, items=_ELEMENTS, steps=_STEPS, raw=True)
            if decoded.problem:
                problem = f"a message of {sample.type_name} cannot be read: {decoded.problem}"
                continue
            try:
                time = sample.stamp / 1e9
                self._view(task).receive(
                    TakenMessage(sample.topic, sample.type_name, decoded.message, time, sample.author, sample.is_asked)
                )
                if sample.is_asked:  # a picture is as old as what the viewer asked for
                    newest = self._newest.get(task.view, _Newest())
                    self._newest[task.view] = newest.followed_by(sample, _stamp_of(decoded.message))
            except UndrawableError as error:
                problem = str(error)
        try:
            view = self._view(task)
            if not task.seen:  # a view's own words would be about messages, and hold up who waits for the first one
                return about
            view.now = task.now / 1e9
            drawn = view.draw(task.wish)
        except UndrawableError:
            if problem:  # why nothing could be taken says more than that nothing is there
                raise UndrawableError(problem) from None
            raise
        return msgspec.structs.replace(
            self._newest.get(task.view, _Newest()).noted_on(about),
            content=drawn.content,
            notes=tuple(sanitize_text(each, 255) for each in drawn.notes[:16]),  # docs/picture-protocol.md
            problem=sanitize_text(problem or drawn.problem),
            numbers=drawn.numbers,
        )

    def _type(self, name: str, text: str, type_hash: str) -> TypeDescription:
        known = self._types.get((name, type_hash))
        if known is None:
            try:
                known = read_description(text, type_hash)
            except DescriptionError as error:
                raise UndrawableError(f"the type's description cannot be read: {error}") from None
            if len(self._types) >= TYPES_AT_MOST:
                self._types.clear()
            self._types[name, type_hash] = known
        return known

    def _view(self, task: Task) -> View:
        """Return the view of a task; a wish for another kind begins a new one."""
        how = _how(task)
        known = self._views.get(task.view)
        if known is not None and how == known[0]:
            self._views[task.view] = self._views.pop(task.view)  # the one unused for longest is forgotten first
            return known[1]
        found = view_class(how) or (None if task.wish.how else view_class("tree"))
        if found is None:
            raise UndrawableError(Undrawable.UNKNOWN_HOW(how=how, known=", ".join(k for k in VIEWS if "/" not in k)))
        view = found()
        while len(self._views) >= VIEWS_AT_MOST:
            oldest = next(iter(self._views))
            del self._views[oldest]
            self._newest.pop(oldest, None)
        self._views[task.view] = how, view
        return view


def _how(task: Task) -> str:
    return task.wish.how or task.type_name


def _missing(module: str, task: Task) -> str:
    """Return the problem that a module cannot be found, with the remedy for the package whose view needs it."""
    how, topic = _how(task), task.samples[0].topic if task.samples else "the topic"
    if package := package_of_view(how):
        return Undrawable.MODULE_MISSING(how=how, package=package, module=module, topic=topic)
    return Undrawable.LIBRARY_MISSING(library=_LIBRARIES.get(module, module), topic=topic)


def _failed(about: Picture, problem: str) -> Picture:
    return msgspec.structs.replace(about, problem=sanitize_text(problem))


_LIBRARIES = {"PIL": "Pillow", "numpy": "numpy"}


def _stamp_of(message: Message) -> int:
    """Return a message's own time stamp in ns since the epoch, or 0."""
    seconds, nanoseconds = number(message, "header.stamp.sec"), number(message, "header.stamp.nanosec")
    return int(seconds) * 10**9 + int(nanoseconds) if seconds > 0 else 0


def read_frame(stream: BinaryIO) -> bytes | None:
    """Return the next frame, or None at the end of the stream."""
    head = stream.read(_LENGTH_BYTES)
    if len(head) < _LENGTH_BYTES:
        return None
    body = stream.read(length := int.from_bytes(head, "big"))
    return body if len(body) == length else None


def frame(message: Task | Picture) -> bytes:
    """Return a message with its length before it."""
    body = msgspec.msgpack.encode(message)
    return len(body).to_bytes(_LENGTH_BYTES, "big") + body


def _limit_resources() -> None:
    with open("/proc/self/statm", encoding="ascii") as statm:  # noqa: PTH123 -- Path costs an import
        used = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_LIMIT, used + MEMORY_LIMIT))
    for limit in (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE):
        resource.setrlimit(limit, (0, 0))


def main() -> None:
    """Draw until the input ends."""
    os.nice(_NICE)
    # Before `confine`, which leaves no /proc to read.
    _limit_resources()
    confine()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy's: one a core, which no view needs, or may be refused
    artist, tasks = Artist(), msgspec.msgpack.Decoder(Task)
    while (body := read_frame(sys.stdin.buffer)) is not None:
        signal.alarm(_SECONDS)
        picture = artist.do(tasks.decode(body))
        signal.alarm(0)
        if picture is not None:
            sys.stdout.buffer.write(frame(picture))
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()

"""The command ``record``: has the bridge write the last seconds to a file."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from pathlib import Path
from typing import IO, TYPE_CHECKING

from msgspec.structs import asdict, replace

from rsb_bridge.config.files import whole_file
from rsb_bridge.config.state_folder import searched_folders
from rsb_bridge.feature_api import EngineError, Wording, typed_path, why_not_written
from rsb_console.feature_console import UsageError, attached, done, result
from rsb_console.notation.formats import byte_count
from rsb_extras.recording.keep_last import LARGEST, RECORDINGS, KeepLast

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from rsb_extras.recording.keep_last import KeptRecording


class RecordedText(Wording):
    """What an operator reads of a recording."""

    WRITTEN = "{messages:,} messages of {topics} topics, {seconds:.0f} s, {size}: {path}"
    WRITTEN_THERE = "{messages:,} messages of {topics} topics, {seconds:.0f} s, {size}: {path} on {host}"
    UNDESCRIBED = "without the types of {topics}, which nobody describes: most programs cannot read these topics"
    TOO_LARGE = "without {count:,} messages that alone exceed record.megabytes"
    SECONDS = "--seconds {value:g}: give a number above 0"
    ELSEWHERE = "the recording is {path} on {host}: fetch it from there, without --output"
    OTHER_FOLDER = "it is not in {folders}"
    NO_RECORDING = "it is not a plain file of the bridge's user, or too large"
    NOT_MOVED = "{target} is not written: {reason}; the recording is {path}"


def lines_about(kept: KeptRecording, *, here: bool) -> Iterator[str]:
    """Yield what was written, and what is missing; `here` says whether this machine's file has that path."""
    text = RecordedText.WRITTEN if here else RecordedText.WRITTEN_THERE
    figures = {"messages": kept.messages, "topics": kept.topics, "seconds": kept.seconds, "size": byte_count(kept.size)}
    yield text(path=kept.path, host=kept.host, **figures)
    if kept.undescribed:
        yield RecordedText.UNDESCRIBED(topics=", ".join(kept.undescribed))
    if kept.too_large:
        yield RecordedText.TOO_LARGE(count=kept.too_large)


def record(arguments: Namespace) -> int:
    if arguments.seconds is not None and not arguments.seconds > 0:
        raise UsageError(RecordedText.SECONDS(value=arguments.seconds))
    with attached(arguments) as engine:
        kept, uid, here = result(engine.do(KeepLast(arguments.seconds))), engine.uid, engine.trusted
    if arguments.output is not None:
        target = typed_path(arguments.output).absolute()
        if uid is None:
            raise EngineError(RecordedText.ELSEWHERE(path=kept.path, host=kept.host))
        _move(Path(kept.path), uid, target)
        kept, here = replace(kept, path=str(target)), True
    return done(arguments, *lines_about(kept, here=here), **asdict(kept))


def _move(source: Path, uid: int, target: Path) -> None:
    """Move a recording to a path where nothing is yet; root copies it.

    The bridge names the file, so it has to be a recording of the bridge's own user: an answer that names another file
    would have this user's files moved.

    Args:
        uid: the user as whom the bridge runs, as the kernel says.
    """
    try:
        with _opened(source, uid) as (folder, file):
            with whole_file(target) as copy:
                shutil.copyfileobj(file, copy)
            if os.geteuid():  # root may do more than the bridge's user, and that user may have changed the name's file
                os.unlink(source.name, dir_fd=folder)
    except OSError as error:
        reason = why_not_written(error, target)
        raise EngineError(RecordedText.NOT_MOVED(target=target, reason=reason, path=source)) from None


@contextlib.contextmanager
def _opened(path: Path, uid: int) -> Iterator[tuple[int, IO[bytes]]]:
    """The folder, and the content, of a recording that a user's bridge has written.

    Raises:
        OSError: it is none, or cannot be read.
    """
    folders = [each / RECORDINGS for each in searched_folders(os.environ)]
    if path.parent not in folders:
        raise OSError(errno.EPERM, RecordedText.OTHER_FOLDER(folders=", ".join(map(str, folders))))
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        # Without waiting for the other end of a FIFO.
        handle = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
        with os.fdopen(handle, "rb") as file:
            status = os.fstat(handle)
            is_its_own = os.fstat(folder).st_uid == uid == status.st_uid and status.st_nlink == 1
            if not is_its_own or not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST:
                raise OSError(errno.EPERM, RecordedText.NO_RECORDING())
            yield folder, file
    finally:
        os.close(folder)

"""The command ``record``: has the bridge write the last seconds to a file."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import asdict, replace

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import owner_only, typed_path, why_not_written
from rsb_bridge.model.wording import Wording
from rsb_console.command.target import UsageError, attached, done, result
from rsb_extras.recording.keep_last import KeepLast

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from rsb_extras.recording.keep_last import KeptRecording


class RecordedText(Wording):
    """What an operator reads of a recording."""

    WRITTEN = "{messages:,} messages of {topics} topics, {seconds:.0f} s, {size:.1f} MB: {path}"
    WRITTEN_THERE = "{messages:,} messages of {topics} topics, {seconds:.0f} s, {size:.1f} MB: {path} on {host}"
    UNDESCRIBED = "without {topics}: nobody describes their types"
    TOO_LARGE = "without {count:,} messages that alone exceed record.megabytes"
    SECONDS = "--seconds {value:g}: give a number above 0"
    ELSEWHERE = "the recording is {path} on {host}: fetch it from there, without --output"
    NOT_MOVED = "{target} is not written: {reason}; the recording is {path}"


def lines_about(kept: KeptRecording) -> Iterator[str]:
    """Yield what was written, and what is missing."""
    text = RecordedText.WRITTEN if is_here(kept) else RecordedText.WRITTEN_THERE
    figures = {"messages": kept.messages, "topics": kept.topics, "seconds": kept.seconds, "size": kept.size / 1e6}
    yield text(path=kept.path, host=kept.host, **figures)
    if kept.undescribed:
        yield RecordedText.UNDESCRIBED(topics=", ".join(kept.undescribed))
    if kept.too_large:
        yield RecordedText.TOO_LARGE(count=kept.too_large)


def is_here(kept: KeptRecording) -> bool:
    """Whether the file is on this machine, as far as its name says."""
    return kept.host == os.uname().nodename


def record(arguments: Namespace) -> int:
    if arguments.seconds is not None and not arguments.seconds > 0:
        raise UsageError(RecordedText.SECONDS(value=arguments.seconds))
    with attached(arguments) as engine:
        kept = result(engine.do(KeepLast(arguments.seconds)))
    if arguments.output is not None:
        kept = replace(kept, path=str(_moved(kept, typed_path(arguments.output).absolute())))
    return done(arguments, *lines_about(kept), **asdict(kept))


def _moved(kept: KeptRecording, target: Path) -> Path:
    """Move a recording to a path where nothing is yet, and return that."""
    source = Path(kept.path)
    if not is_here(kept):
        raise EngineError(RecordedText.ELSEWHERE(path=source, host=kept.host))
    try:
        with source.open("rb") as file:
            handle = owner_only(str(target), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
            try:
                with os.fdopen(handle, "wb") as copy:
                    shutil.copyfileobj(file, copy)
            except BaseException:
                target.unlink()
                raise
        source.unlink()
    except OSError as error:
        reason = why_not_written(error, target)
        raise EngineError(RecordedText.NOT_MOVED(target=target, reason=reason, path=source)) from None
    return target

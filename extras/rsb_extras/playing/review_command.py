"""The command ``review``: looks at a recording."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import UsageError
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import RecordingError, UnreadableRecording

if TYPE_CHECKING:
    from argparse import Namespace

_SECOND = 1_000_000_000


class NoReview(Wording):
    NO_TERMINAL = "review needs a terminal: `play` publishes the recording instead"
    NO_TOPIC = "{path} has no topic {topic}"


def review(arguments: Namespace) -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError(NoReview.NO_TERMINAL())
    path = arguments.file
    try:
        recording = OpenRecording(path)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    summary = recording.summary
    if not summary.messages:
        raise UsageError(UnreadableRecording.EMPTY(path=path, cut=summary.cut and f": {summary.cut}"))
    if arguments.topic and arguments.topic not in summary.topics:
        raise UsageError(NoReview.NO_TOPIC(path=path, topic=arguments.topic))
    from rsb_extras.playing.review_app import run_review  # noqa: PLC0415 -- Textual takes 0.3 s to import

    at = None if arguments.at is None else summary.begin + round(arguments.at * _SECOND)
    return run_review(
        recording,
        arguments.topic,
        at,
        ascii_only=arguments.ascii,
        theme=arguments.theme,
        mouse=not arguments.no_mouse,
    )

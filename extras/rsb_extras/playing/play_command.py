"""The command ``play``: publishes the messages of a recording."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError, RosError, escape_text, join_first
from rsb_bridge.ros.node import RosNode
from rsb_console.feature_console import (
    FAILURE,
    INTERRUPTED,
    OK,
    UsageError,
    agreed,
    json_line,
    print_error,
    print_line,
    redraw_line,
)
from rsb_extras.playing.latched_room import LATCHED_BYTES
from rsb_extras.playing.play_keys import play_keys
from rsb_extras.playing.played_topics import PlayedPublishers, PlayText, check_number, choose
from rsb_extras.playing.player import SECOND, Player, PlaySpan
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import RecordingError, UnreadableRecording

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Collection, Iterable

    from rsb_extras.playing.play_keys import PlayKeys
    from rsb_extras.playing.player import PlayState
    from rsb_extras.recording.reading.stored_message import StoredChannel

_NAMED = 5  # topics and nodes in one line


def play(arguments: Namespace) -> int:
    say = _quiet if arguments.json else _say
    try:
        recording = OpenRecording(arguments.file)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    channels = _chosen(recording, arguments, say)
    node = RosNode(arguments.domain, "play")
    node.node_name = f"_play_{node.instance_id}"  # not as a bridge's, which others would wait for and ask
    try:
        check_number(channels)
        node.start()
        try:
            return _play(recording, node, channels, arguments, say)
        finally:
            node.stop()
    except RosError as error:
        raise EngineError(str(error)) from None


def _say(lines: Iterable[str]) -> None:
    for line in lines:
        print_line(escape_text(line))


def _quiet(_: Iterable[str]) -> None:
    """Programs read the result only."""


def _chosen(
    recording: OpenRecording, arguments: Namespace, say: Callable[[Iterable[str]], None]
) -> list[StoredChannel]:
    """Return the channels to play, and say what is left out."""
    summary, path = recording.summary, arguments.file
    if not summary.messages:
        raise UsageError(UnreadableRecording.EMPTY(path=path, cut=summary.cut and f": {summary.cut}"))
    for pattern in arguments.topics:
        if not any(pattern.match(topic) is not None for topic in summary.topics):
            raise UsageError(PlayText.NO_TOPIC(pattern=pattern.text))
    seconds = (summary.end - summary.begin) / SECOND
    say([PlayText.RECORDING(path=path, messages=summary.messages, topics=len(summary.topics), seconds=seconds)])
    if summary.cut:
        say([PlayText.CUT(path=path, reason=summary.cut)])
    choice = choose(recording.channels, arguments.topics, has_clock=arguments.clock is not None)
    say(dict.fromkeys(choice.left_out))
    channels = choice.channels
    if choice.moving and arguments.arm:
        topics = join_first(_names(choice.moving), _NAMED)
        if agreed(PlayText.ASK(topics=topics, domain=arguments.domain), "--topics", ask=not arguments.json):
            return [*channels, *choice.moving]
    say(dict.fromkeys(PlayText.MOTION(topic=each.topic, type=each.type_name) for each in choice.moving))
    return channels


def _names(channels: Iterable[StoredChannel]) -> list[str]:
    return [*dict.fromkeys(each.topic for each in channels)]


def _play(
    recording: OpenRecording,
    node: RosNode,
    channels: Collection[StoredChannel],
    arguments: Namespace,
    say: Callable[[Iterable[str]], None],
) -> int:
    publishers = PlayedPublishers(node, channels)
    say(dict.fromkeys(publishers.left_out))
    if not publishers.topics:
        raise EngineError(PlayText.NOTHING())
    say([PlayText.PLAYS(topics=len(publishers.topics), domain=arguments.domain)])
    span = _span(recording, arguments)
    player = Player(recording, node, publishers, span, is_paused=arguments.paused)
    shown = _Shown(span, is_shown=sys.stdout.isatty() and not arguments.json)
    began, is_interrupted = time.monotonic(), False
    with play_keys() as keys:
        try:
            if not _waits(keys, arguments.delay):
                say(_beside(node, publishers.topics, arguments.domain))
                began = time.monotonic()
                player.play(keys, shown.tell)
                player.settle()
        except KeyboardInterrupt:
            is_interrupted = True
        finally:
            shown.end()
    code = _result(player, time.monotonic() - began, recording.summary.cut, arguments, say)
    return INTERRUPTED if is_interrupted else code


def _waits(keys: PlayKeys, seconds: float) -> bool:
    """Wait until nodes have found the publishers, and return whether a key has ended that."""
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0:
        if "end" in keys.wait(left):
            return True
    return False


def _beside(node: RosNode, topics: Iterable[str], domain: int) -> Iterable[str]:
    for topic in sorted(topics):
        if nodes := sorted({each.node for each in node.publishers(topic)}):
            yield PlayText.BESIDE(topic=topic, domain=domain, nodes=join_first(nodes, _NAMED))


def _span(recording: OpenRecording, arguments: Namespace) -> PlaySpan:
    first, last = recording.summary.begin, recording.summary.end
    begin = first if arguments.at_from is None else min(first + round(arguments.at_from * SECOND), last)
    end = last if arguments.at_to is None else max(begin, min(first + round(arguments.at_to * SECOND), last))
    return PlaySpan(begin, end, arguments.rate, arguments.loop, arguments.clock or 0.0)


class _Shown:
    """The line of state at a terminal."""

    def __init__(self, span: PlaySpan, *, is_shown: bool) -> None:
        self._span = span
        self._is_shown = is_shown

    def tell(self, state: PlayState) -> None:
        if self._is_shown:
            at, all_of_it = ((each - self._span.begin) / SECOND for each in (state.position, self._span.end))
            what = "paused " if state.is_paused else "playing"
            heard = f"{state.messages:,} messages, {state.subscriptions} subscriptions"
            redraw_line(f"{what} {at:.1f} / {all_of_it:.1f} s  {heard}")

    def end(self) -> None:
        if self._is_shown:
            redraw_line("")


def _result(
    player: Player, seconds: float, cut: str, arguments: Namespace, say: Callable[[Iterable[str]], None]
) -> int:
    late = sorted(player.late)
    p50, p99 = (late[int(len(late) * part)] * 1000 if late else 0.0 for part in (0.5, 0.99))
    say([PlayText.PLAYED(messages=player.messages, seconds=seconds, p50=p50, p99=p99)])
    for (topic, reason), count in player.failed.items():
        print_error(escape_text(PlayText.FAILED(count=count, topic=topic, reason=reason)))
    for topic, count in player.room.left_out.items():
        print_error(escape_text(PlayText.NO_ROOM(count=count, topic=topic, limit=LATCHED_BYTES >> 20)))
    if player.error:
        print_error(escape_text(PlayText.DAMAGED(path=arguments.file, reason=player.error)))
    is_whole = not (player.error or player.failed or player.room.left_out)
    if arguments.json:
        figures = {"messages": player.messages, "seconds": seconds, "late_ms_p50": p50, "late_ms_p99": p99}
        print_line(json_line({"ok": is_whole, **figures, "error": player.error, "cut": cut}))
    return OK if is_whole else FAILURE

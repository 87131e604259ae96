"""What is played arrives as it was recorded, and what may move a robot only if an operator says so."""

from __future__ import annotations

import json
import signal
import struct
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from tests.support.waiting import eventually, holds
from tests.support.wording import says

from rsb_extras.playing.played_topics import PlayedPublishers, PlayText
from rsb_extras.playing.player import Player, PlaySpan, clock_message
from rsb_extras.playing.tests.playing_places import LATCHED_BYTES
from rsb_extras.playing.tests.recorded import BEGIN, LATCHED, ODD, ODD_HASH, ODD_TYPE, Recorded, odd, string
from rsb_extras.recording.reading.open_recording import OpenRecording

if TYPE_CHECKING:
    from rsb_extras.playing.tests.conftest import Hearing

LEFT, RIGHT = "\x1b[D", "\x1b[C"


def words(recorded: Recorded, hearing: Hearing, *options: str) -> tuple[str, ...]:
    return "play", str(recorded.path), "--domain", str(hearing.domain), "--delay", "0", *options


def payloads(heard: list[Any]) -> list[bytes]:
    return [each.payload for each in heard]


def test_all_messages_arrive_as_recorded(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    """Of types that are installed, or nowhere; a late joiner gets what is latched."""
    recorded.topic("/text")
    recorded.topic("/odd", ODD_TYPE, ODD)
    recorded.topic("/map", profiles=LATCHED)
    recorded.topic("/odd_json", "x/msg/Y", encoding="json")
    for number in range(50):
        recorded.add("/text", number * 0.01, string(f"text {number}"))
        recorded.add("/odd", number * 0.01 + 0.001, odd(number))
        if number % 25 == 0:
            recorded.add("/map", number * 0.01 + 0.002, string(f"map {number}"))
    recorded.add("/odd_json", 0.1, b"{}")
    recorded.done()
    heard = {"/text": hearing.hear("/text"), "/odd": hearing.hear("/odd", ODD_TYPE, ODD_HASH)}
    player = at_terminal(*words(recorded, hearing, "--paused", "--loop"))
    hearing.wait_for(player)
    player.press(" ")
    for topic, messages in heard.items():
        eventually(lambda messages=messages: len(messages) >= 50)
        assert payloads(messages[:50]) == recorded.sent[topic]
    late = hearing.hear("/map", durability="transient_local", depth=1)
    eventually(lambda: late)
    assert payloads(late)[0] in recorded.sent["/map"]
    assert says(player.text, PlayText.LEFT_OUT, topic="/odd_json")
    player.press("q")
    assert player.process.wait(60) == 0


def test_times_between_messages_are_kept(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    """No message comes before it is due; twice as fast, in half of the time."""
    topic = recorded.topic("/text")
    for number in range(5):
        recorded.add(topic, number * 0.4, string(str(number)))
    recorded.done()
    heard = hearing.hear(topic)
    player = at_terminal(*words(recorded, hearing, "--paused", "--rate", "2"))
    hearing.wait_for(player)
    player.press(" ")
    eventually(lambda: len(heard) == 5)
    first = heard[0].source
    assert all(each.source - first >= number * 0.2e9 - 50e6 for number, each in enumerate(heard))
    assert player.process.wait(60) == 0


def test_part_and_topics_are_chosen(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    """What was latched before the part is played, too."""
    recorded.topic("/text")
    recorded.topic("/other")
    recorded.topic("/map", profiles=LATCHED)
    recorded.add("/map", 0.0, string("old"))
    recorded.add("/map", 0.1, string("map"))
    for number in range(40):
        recorded.add("/text", number * 0.1, string(str(number)))
        recorded.add("/other", number * 0.1, string(str(number)))
    recorded.done()
    text, other = hearing.hear("/text"), hearing.hear("/map", durability="transient_local")
    options = ("--paused", "--topics", "/text", "/m*", "--from", "2.0", "--to", "2.2")
    player = at_terminal(*words(recorded, hearing, *options))
    hearing.wait_for(player)
    player.press(" ")
    assert player.process.wait(60) == 0
    eventually(lambda: len(text) == 3)
    assert payloads(text) == [string(str(number)) for number in (20, 21, 22)]
    assert payloads(other) == [string("map")]
    assert "/other" not in hearing.node.topics()


def test_clock_has_the_time_of_the_recording(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    topic = recorded.topic("/text")
    recorded.topic("/clock", "rosgraph_msgs/msg/Clock", "builtin_interfaces/Time clock")
    for at in (0.0, 0.5):
        recorded.add(topic, at, string("x"))
        recorded.add("/clock", at, clock_message(1))
    recorded.done()
    heard = hearing.hear("/clock", "rosgraph_msgs/msg/Clock", reliability="best_effort")
    text = hearing.hear(topic)
    player = at_terminal(*words(recorded, hearing, "--paused", "--clock", "100"))
    hearing.wait_for(player)
    player.press(" ")
    assert player.process.wait(60) == 0
    eventually(lambda: len(text) == 2 and heard)
    times = [struct.unpack("<iI", each.payload[4:]) for each in heard]
    found = [seconds * 1_000_000_000 + rest - BEGIN for seconds, rest in times]
    assert found == sorted(found)
    assert all(0 <= each <= 500_000_000 for each in found), "none of those that were recorded"
    assert says(player.text, PlayText.LEFT_OUT, topic="/clock")


def test_keys_pause_step_and_seek(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    topic = recorded.topic("/text")
    for number in range(100):
        recorded.add(topic, number * 1.0, string(str(number)))
    recorded.done()
    heard = hearing.hear(topic)
    player = at_terminal(*words(recorded, hearing, "--paused"))
    hearing.wait_for(player)
    player.wait_for("paused")
    for count in (1, 2, 3):
        player.press(".")
        eventually(lambda count=count: len(heard) == count)
    player.press(RIGHT + RIGHT + ".")
    eventually(lambda: len(heard) == 4)
    player.press(LEFT + ".")
    eventually(lambda: len(heard) == 5)
    assert payloads(heard) == [string(str(number)) for number in (0, 1, 2, 12, 7)]
    holds(lambda: len(heard) == 5, 0.3)
    player.press("q")
    assert player.process.wait(60) == 0


def test_interrupt_ends_it_and_gives_the_terminal_back(recorded: Recorded, hearing: Hearing, at_terminal: Any) -> None:
    recorded.topic("/text")
    for at in (0.0, 1000.0):
        recorded.add("/text", at, string("x"))
    recorded.done()
    player = at_terminal(*words(recorded, hearing))
    player.wait_for("1 messages,")
    player.process.send_signal(signal.SIGINT)
    assert player.process.wait(60) == 130
    assert says(player.text, PlayText.PLAYED, messages=1)
    assert "Traceback" not in player.text


# --- what may move a robot


@pytest.mark.parametrize(("answer", "is_played"), [("", False), ("n", False), ("y", True)])
def test_motion_is_left_out_until_it_is_armed(
    answer: str, is_played: bool, recorded: Recorded, hearing: Hearing, at_terminal: Any
) -> None:
    twist = b"\0\1\0\0" + bytes(48)
    recorded.topic("/cmd_vel", "geometry_msgs/msg/Twist", "x")
    recorded.topic("/text")
    recorded.add("/cmd_vel", 0.0, twist)
    recorded.add("/text", 0.1, string("x"))
    recorded.done()
    moves, text = hearing.hear("/cmd_vel", "geometry_msgs/msg/Twist"), hearing.hear("/text")
    player = at_terminal(*words(recorded, hearing, "--loop", *(("--arm",) if answer else ())))
    if answer:
        player.wait_for("[y/N]")
        player.press(f"{answer}\n")
    eventually(lambda: text)
    if is_played:
        eventually(lambda: moves)
        assert moves[0].payload == twist
    else:
        assert says(player.text, PlayText.MOTION, topic="/cmd_vel")
        assert hearing.node.publishers("/cmd_vel") == []
    player.press("q")
    assert player.process.wait(60) == 0


def test_without_a_terminal_nothing_is_armed(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    recorded.topic("/cmd_vel", "geometry_msgs/msg/Twist", "x")
    recorded.add("/cmd_vel", 0.0, b"\0\1\0\0" + bytes(48))
    recorded.done()
    assert ran(*words(recorded, hearing, "--arm")).code == 2
    done = ran(*words(recorded, hearing))
    assert (done.code, says(done.err, PlayText.NOTHING)) == (1, True)


def test_topics_of_bridges_are_never_played(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    """A recorded announcement would have bridges of the domain take others' messages for their own."""
    recorded.topic("/_rsb_bridge/published")
    recorded.topic("/text")
    for topic in ("/_rsb_bridge/published", "/text"):
        recorded.add(topic, 0.0, string("x"))
    recorded.done()
    done = ran(*words(recorded, hearing))
    assert says(done.out, PlayText.LEFT_OUT, topic="/_rsb_bridge/published", reason=PlayText.OWN())
    assert json.loads(ran(*words(recorded, hearing, "--json")).out)["messages"] == 1


def test_loop_without_messages_ends(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    recorded.topic("/text")
    recorded.topic("/rare")
    recorded.add("/rare", 0.0, string("x"))
    for number in range(5):
        recorded.add("/text", number * 1.0, string("x"))
    recorded.done()
    options = ("--loop", "--topics", "/rare", "--from", "1", "--to", "3", "--json")
    assert json.loads(ran(*words(recorded, hearing, *options)).out)["messages"] == 0


def test_late_joiners_get_nothing_of_volatile_publishers(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    """Also on a topic of which another publisher is latched."""
    recorded.topic("/text", profiles=LATCHED, publisher="first")
    recorded.add("/text", 0.0, string("latched"))
    recorded.topic("/text", publisher="second")
    recorded.add("/text", 0.1, string("volatile"))
    recorded.add("/text", 1.0, string("x"))
    recorded.done()
    assert json.loads(ran(*words(recorded, hearing, "--from", "0.5", "--json")).out)["messages"] == 2


def test_latched_messages_have_a_bound_in_all(
    recorded: Recorded, hearing: Hearing, ran: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording says how deep its topics are, and may be anybody's."""
    LATCHED_BYTES.set(monkeypatch, 2_000_000)
    deep = LATCHED.replace("depth: 1", "depth: 900")
    for topic in ("/a", "/b"):
        recorded.topic(topic, profiles=deep)
        for number in range(12):
            recorded.add(topic, 0.01 * number, string(f"{number} {'x' * 100_000}"))
    recorded.topic("/small", profiles=LATCHED)  # each of its messages takes the place of the one before
    for number in range(5):
        recorded.add("/small", 0.01 * number, string(f"{number} {'x' * 20_000}"))
    recorded.done()
    for options in ((), ("--from", "0.11")):  # as it is played, and as late joiners had it
        done = ran(*words(recorded, hearing, *options))
        said = [each for each in ("/a", "/b", "/small") if says(done.err, PlayText.NO_ROOM, topic=each)]
        assert (done.code, "/small" in said, bool(said)) == (1, False, True), done


def test_seek_frees_room_of_latched_topics(
    recorded: Recorded, hearing: Hearing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What comes after a seek is published, and a late joiner gets no more what was latched before it."""
    LATCHED_BYTES.set(monkeypatch, 150_000)
    for topic in ("/map", "/costmap"):
        recorded.topic(topic, profiles=LATCHED)
    recorded.add("/costmap", 0.5, string("x" * 100_000))
    recorded.add("/costmap", 4.0, string("x"))
    recorded.add("/map", 5.0, string("x" * 100_000))
    recorded.done()
    recording = OpenRecording(recorded.path)
    publishers = PlayedPublishers(hearing.node, recording.channels)
    span = PlaySpan(BEGIN, BEGIN + 10_000_000_000)
    player = Player(recording, hearing.node, publishers, span, is_paused=True)
    pressed = iter(["6", "-10", ".", "end"])  # behind all of them, and before
    keys: Any = SimpleNamespace(wait=lambda _: ["step" if (key := next(pressed)) == "." else key])
    player.play(keys, lambda _: None)
    assert (player.messages, dict(player.room.left_out)) == (3, {})
    late = {topic: hearing.hear(topic, durability="transient_local", depth=1) for topic in ("/map", "/costmap")}
    eventually(lambda: late["/costmap"])
    assert not late["/map"]


# --- what cannot be played


def test_type_that_nobody_knows_is_left_out(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    recorded.topic("/gone", "nowhere_msgs/msg/Gone", "???")
    recorded.topic("/text")
    recorded.add("/gone", 0.0, string("x"))
    recorded.add("/text", 0.0, string("x"))
    recorded.done()
    done = ran(*words(recorded, hearing))
    assert (done.code, says(done.out, PlayText.LEFT_OUT, topic="/gone")) == (0, True)


def test_empty_message_is_counted(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    recorded.topic("/text")
    recorded.add("/text", 0.0, b"")
    recorded.add("/text", 0.01, string("x"))
    recorded.done()
    done = ran(*words(recorded, hearing))
    assert (done.code, says(done.err, PlayText.FAILED, count=1, topic="/text")) == (1, True)


def test_damage_is_told_at_its_place(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    topic = recorded.topic("/text")
    for number in range(200):
        recorded.add(topic, number * 0.001, string(f"number {number}" * 10))
    recorded.done()
    data = bytearray(recorded.path.read_bytes())
    with recorded.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[-1]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    recorded.path.write_bytes(data)
    done = ran(*words(recorded, hearing))
    assert (done.code, says(done.err, PlayText.DAMAGED)) == (1, True)


def test_topic_that_is_not_there_is_refused(recorded: Recorded, hearing: Hearing, ran: Any) -> None:
    recorded.add(recorded.topic("/text"), 0.0, string("x"))
    recorded.done()
    done = ran(*words(recorded, hearing, "--topics", "/scam"))
    assert (done.code, says(done.err, PlayText.NO_TOPIC, pattern="/scam")) == (2, True)

"""What two recordings say of a topic: known losses, doubles, swaps, silences and last values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rsb_extras.audit.tests.conftest import Audited, Sides
from rsb_extras.audit.tests.written import LATCHED, START, text
from rsb_extras.recording.reading.stored_message import content_key

Run = Callable[..., Audited]


def stream(sides: Sides, topic: str, count: int = 200, *, lost: Any = (), doubled: Any = (), age: float = 0.02) -> None:
    """Send a message each 0.05 s from 2 s on."""
    for number in range(count):
        at = 2 + number * 0.05
        sides.near.add(topic, at, number)
        for again in range((number not in lost) + (number in doubled)):
            sides.far.add(topic, at + age + again * 0.001, number)


def test_all_that_crossed_is_no_breach(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan"))
    found = audited()
    scan = found["/scan"]
    assert (found.code, found.json["ok"], found.breaches) == (0, True, set())
    assert (scan["near"], scan["far"], scan["matched"], scan["by_order"]) == (200, 200, 200, 0)
    assert (scan["lost"], scan["doubled"], scan["disordered"], scan["early"], scan["undecided"]) == (0, 0, 0, 0, 0)
    assert found.json["overlap"] == pytest.approx(14.98)  # the least age counts as 0


def test_reliable_losses_and_doubles_are_breaches(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan"), lost={50, 51, 120}, doubled={60, 61})
    found = audited()
    assert (found["/scan"]["lost"], found["/scan"]["doubled"], found["/scan"]["matched"]) == (3, 2, 197)
    assert found["/scan"]["by_order"] == 0
    assert (found.code, found.json["ok"]) == (1, False)
    assert found.breaches == {("lost", "/scan", 3), ("doubled", "/scan", 2)}


@pytest.mark.parametrize(
    ("reliability", "known"), [("best_effort", False), (2, False), ("", None), ("odd", None), ("[", None)]
)
def test_losses_without_a_promise_are_no_breach(reliability: Any, known: Any, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan", reliability=reliability), lost={50}, doubled={70})
    found = audited()
    assert (found.code, found["/scan"]["reliable"]) == (0, known)
    assert (found["/scan"]["lost"], found["/scan"]["doubled"]) == (1, 1)


def test_numbers_of_older_rosbag2_are_policies(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan", reliability=1, durability=1), lost={50})
    found = audited()
    assert (found["/scan"]["reliable"], found["/scan"]["latched"], found.code) == (True, True, 1)


def test_swapped_messages_are_out_of_order(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.05, number)
        late = 0.08 if number in (10, 40) else 0.02  # each comes after the next one
        sides.far.add(topic, 2 + number * 0.05 + late, number)
    found = audited()
    assert found["/scan"]["disordered"] == 2
    assert found.breaches == {("disordered", "/scan", 2)}


def test_order_counts_for_each_publisher(sides: Sides, audited: Run) -> None:
    """Our own recordings tell publishers apart; rosbag2 says how many there are."""
    sides.spans(15)
    for name in ("a", "b"):
        sides.near.topic("/tf", publisher=name)
    sides.far.topic("/tf", publisher="link")
    sides.near.topic("/odom", publishers=2)
    sides.far.topic("/odom")
    for number in range(100):
        at, name = 2 + number * 0.05, "ab"[number % 2]
        sides.near.add("/tf", at, number, publisher=name)
        sides.far.add("/tf", at + (0.08 if name == "a" else 0.02), number, publisher="link")
        sides.near.add("/odom", at, number)
        sides.far.add("/odom", at + (0.08 if name == "a" else 0.02), number)
    found = audited()
    assert (found["/tf"]["disordered"], found["/odom"]["disordered"], found.code) == (0, None, 0)


def test_equal_messages_are_matched_by_order(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic, other = sides.topic("/alive"), sides.topic("/stop")
    for number in range(100):
        at = 2 + number * 0.05
        sides.near.add(topic, at, 7)
        sides.far.add(topic, at + 0.07, 7)
        sides.near.add(other, at, 7)
        if number not in (30, 31, 60):
            sides.far.add(other, at + 0.02, 7)
    found = audited("--offset", "0")
    alive, stop = found["/alive"], found["/stop"]
    assert (alive["by_order"], alive["lost"], alive["doubled"]) == (100, 0, 0)
    assert alive["age_p50"] == pytest.approx(0.07)
    assert (stop["by_order"], stop["lost"], stop["doubled"]) == (97, 3, 0)
    assert found.breaches == {("lost", "/stop", 3)}


def test_more_equal_messages_than_sent_are_doubled(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/alive")
    for number in range(100):
        at = 2 + number * 0.05
        sides.near.add(topic, at, 7)
        for again in range(1 + (number == 70)):
            sides.far.add(topic, at + 0.02 + again * 0.001, 7)
    found = audited("--offset", "0")
    assert (found["/alive"]["lost"], found["/alive"]["doubled"]) == (0, 1)


def test_equal_messages_outside_the_overlap_are_no_losses(sides: Sides, audited: Run) -> None:
    """FAR begins later and ends earlier, while messages are in flight."""
    topic = sides.topic("/alive")
    for number in range(1000):
        at = number * 0.01
        sides.near.add(topic, at, 7)
        if 3.0 <= at + 0.025 <= 7.0 and number not in (400, 401, 500):
            sides.far.add(topic, at + 0.025, 7)
    found = audited("--offset", "0")
    assert (found["/alive"]["lost"], found["/alive"]["doubled"], found.code) == (3, 0, 1)


def test_equal_messages_from_before_the_overlap_are_not_doubled(sides: Sides, audited: Run) -> None:
    """NEAR begins while two messages are in flight, and soon only one is."""
    topic = sides.topic("/alive")
    for number in range(1000):
        at = number * 0.01
        sides.far.add(topic, at + (0.025 if at < 3.1 else 0.005), 7)
        if at >= 3.0:
            sides.near.add(topic, at, 7)
    found = audited("--offset", "0")
    assert (found["/alive"]["lost"], found["/alive"]["doubled"], found.code) == (0, 0, 0)


def test_offset_may_be_off_by_a_little(sides: Sides, audited: Run) -> None:
    """By these clocks, messages come 1 ms before they are sent."""
    sides.spans(15)
    topic = sides.topic("/alive")
    for number in range(100):
        at = 2 + number * 0.05
        sides.near.add(topic, at, 7)
        if number not in (30, 31):
            sides.far.add(topic, at - 0.001, 7)
    found = audited("--offset", "0")
    assert (found["/alive"]["lost"], found["/alive"]["doubled"], found["/alive"]["elsewhere"]) == (2, 0, 0)


def test_slow_messages_are_undecided_for_longer(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in range(120):
        at = 2 + number * 0.1
        sides.near.add(topic, at, number)
        if at + 3 < 15:
            sides.far.add(topic, at + 3, number)
    found = audited("--offset", "0")
    assert (found["/scan"]["lost"], found["/scan"]["undecided"], found.code) == (0, 20, 0)


def test_padding_and_options_are_no_content(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in range(60):
        content = b"\0\1\0\0" + number.to_bytes(4, "little") + bytes(number % 3) + b"x" + bytes(number % 2)
        sides.near.add(topic, 2 + number * 0.1, content)
        padded = content[:2] + b"\0\3" + content[4:] + bytes(-len(content) % 4)
        sides.far.add(topic, 2 + number * 0.1 + 0.01, padded)
    found = audited()
    assert (found["/scan"]["matched"], found["/scan"]["lost"], found.code) == (60, 0, 0)


def test_only_common_time_counts(sides: Sides, audited: Run) -> None:
    """NEAR begins earlier and ends later; the last second of the common time is undecided."""
    topic = sides.topic("/scan")
    for number in range(200):
        at = number * 0.1
        sides.near.add(topic, at, number)
        if 5.0 <= at + 0.01 <= 15.0 and number not in (60, 149):
            sides.far.add(topic, at + 0.01, number)
    sides.far.add(sides.far.topic("/other"), 15.0, 1)
    found = audited("--offset", "0")
    assert (found["/scan"]["lost"], found["/scan"]["undecided"]) == (1, 2)  # 150 is on its way at the end


@pytest.mark.parametrize(("first", "last", "code"), [(2, 50, 0), (14, 50, 1), (2, 38, 1), (8, 44, 0)])
def test_bridge_that_dies_leaves_a_shorter_recording(
    first: int, last: int, code: int, sides: Sides, audited: Run
) -> None:
    """Nothing else is recorded on FAR, so that the end of its recording is unknown."""
    topic = sides.topic("/scan")
    for number in range(500):
        at = 1 + number * 0.1
        sides.near.add(topic, at, number)
        if first <= at <= last:
            sides.far.add(topic, at + 0.01, number)
    found = audited()
    assert (found.code, {kind for kind, _, _ in found.breaches}) == (code, {"shorter"} if code else set())
    again = audited("--overlap", near=sides.near.path, far=sides.far.path)
    assert (again.code, again["/scan"]["lost"]) == (0, 0)
    # Messages that go back may end whenever they like.
    assert audited("--back", "/scan", near=sides.far.path, far=sides.near.path).code == code
    assert audited(near=sides.far.path, far=sides.near.path).code == 0


def test_messages_before_the_first_that_crossed_are_early(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan"), lost=set(range(40)))
    found = audited()
    assert (found["/scan"]["early"], found["/scan"]["lost"], found.code) == (40, 0, 0)


def test_late_bridge_loses_what_is_not_early(sides: Sides, audited: Run) -> None:
    """The topic's first message comes at 2 s, so that something has to cross from 12 s on."""
    sides.spans(30)
    stream(sides, sides.topic("/scan"), count=400, lost=set(range(300)))
    found = audited()
    assert (found["/scan"]["early"], found["/scan"]["lost"], found.code) == (200, 100, 1)


def test_recorder_that_finds_a_topic_late_turns_no_way_around(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/odom"))
    topic = sides.topic("/scan")
    for number in range(100):
        at = 2 + number * 0.1
        if number >= 30:
            sides.near.add(topic, at, number)
        if number not in (50, 70):
            sides.far.add(topic, at + 0.02, number)
    found = audited()
    assert (found["/scan"]["way"], found["/scan"]["lost"], found["/scan"]["elsewhere"]) == ("to_far", 2, 30)


def test_silence_of_a_sender_is_none_of_the_bridge_however_late_messages_are(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in (*range(30), *range(60, 100)):
        sides.near.add(topic, 2 + number * 0.1, number)
        sides.far.add(topic, 2.35 + number * 0.1, number)
    gap, _ = audited("--offset", "0")["/scan"]["gaps"]["far"]
    assert (gap["other"], gap["end"] - gap["start"]) == (0, pytest.approx(3.1))


def test_jitter_makes_no_silence_of_a_sender_the_bridges(sides: Sides, audited: Run) -> None:
    """Messages are 10 to 300 ms old, the last ones before a silence of 4.5 s least."""
    sides.spans(60)
    topic = sides.topic("/scan")
    for number in range(200):
        at = 2 + number * 0.1 + number // 40 * 4.5
        sides.near.add(topic, at, number)
        sides.far.add(topic, at + (0.01 if number % 40 > 35 else 0.2 + number % 2 * 0.1), number)
    gaps = audited("--offset", "0")["/scan"]["gaps"]
    assert [gap["other"] for gap in gaps["far"]] == [0] * 5
    assert [gap["end"] - gap["start"] > 4 for gap in gaps["near"]] == [True] * 5


def test_silence_that_is_longer_than_the_senders_is_the_bridges(sides: Sides, audited: Run) -> None:
    """The sender is silent from 12 s to 18 s and at the end, the bridge from 10 s to 20 s."""
    sides.spans(33)
    topic = sides.topic("/scan")
    for number in range(280):
        at = 2 + number * 0.1
        if not 12 < at < 18:
            sides.near.add(topic, at, number)
            if not 10 < at < 20:
                sides.far.add(topic, at + 0.01, number)
    scan = audited("--offset", "0")["/scan"]
    assert [gap["other"] for gap in scan["gaps"]["far"]] == [pytest.approx(39, abs=1), 0]


def test_one_message_a_second_makes_no_silence(sides: Sides, audited: Run) -> None:
    sides.spans(53)
    topic = sides.topic("/battery")
    for number in range(50):
        at = 2 + number + number % 3 * 0.02
        sides.near.add(topic, at, number)
        if not 20 <= number < 25:
            sides.far.add(topic, at + 0.01 + number % 2 * 0.03, number)
    gaps = audited("--offset", "0")["/battery"]["gaps"]
    assert gaps["near"] == []
    assert [gap["other"] for gap in gaps["far"]] == [5]


def test_losses_before_a_late_message_are_decided(sides: Sides, audited: Run) -> None:
    """The link is away from 10 s to 20 s, and half of what waited for it comes then."""
    sides.spans(31)
    topic = sides.topic("/scan")
    for number in range(300):
        at = 1 + number * 0.1
        sides.near.add(topic, at, number)
        if not 10 <= at < 15:
            sides.far.add(topic, max(at, 20 if 15 <= at < 20 else 0) + 0.02, number)
    found = audited()
    assert (found["/scan"]["lost"], found["/scan"]["undecided"]) == (50, 0)


def test_topic_without_any_message_is_lost(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/odom"))
    topic = sides.topic("/scan")
    for number in range(20):
        sides.near.add(topic, 2 + number * 0.1, number)
    found = audited()
    assert found.breaches == {("lost", "/scan", 20)}


def test_messages_from_elsewhere_are_counted_apart(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/tf"))
    for number in range(30):
        sides.far.add("/tf", 3 + number * 0.1, 10_000 + number)
    found = audited("--forth", "/tf")
    assert (found["/tf"]["elsewhere"], found["/tf"]["doubled"], found.code) == (30, 0, 0)


@pytest.mark.parametrize("durability", ["volatile", LATCHED])
def test_topic_without_common_messages_is_not_judged(durability: str, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    stream(sides, sides.topic("/scan"))
    topic = sides.topic("/rosout", durability=durability)
    for number in range(20):
        sides.near.add(topic, 2 + number * 0.1, number)
        sides.far.add(topic, 2 + number * 0.1, 1000 + number)
    image = sides.topic("/image", durability=durability)
    for side, number in zip(sides, (1, 2), strict=True):
        side.add(image, 5.0, number)
    found = audited()
    assert (found["/rosout"]["nothing_common"], found["/rosout"]["lost"]) == (True, 0)
    assert (found.code, found.breaches) == (1, {("not_judged", "/image", 1)}), "each node has /rosout"


@pytest.mark.parametrize(
    ("far", "state", "code"),
    [
        ([1, 2], "same", 0),
        ([1], "old", 1),
        ([], "absent", 1),
        ([1, 2, 1], "old", 1),
        ([2], "same", 0),
        ([1, 99], "absent", 1),
    ],
)
def test_last_latched_value(far: list[int], state: str, code: int, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/map", durability=LATCHED)
    for at, number in enumerate((1, 2)):
        sides.near.add(topic, 3.0 + at, number)
    for at, number in enumerate(far):
        sides.far.add(topic, 3.1 + at, number)
    found = audited()
    assert (found["/map"]["latched_value"], found.code) == (state, code)
    assert ((f"latched_{state}", "/map", 1) in found.breaches) == (state != "same")


def test_latched_value_of_the_last_second_does_not_count(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/map", durability=LATCHED)
    sides.near.add(topic, 3.0, 1)
    sides.far.add(topic, 3.1, 1)
    sides.near.add(topic, 14.9, 2)
    quick = sides.topic("/quick_map", durability=LATCHED)
    for at, number in ((3.0, 1), (14.9, 2)):
        sides.near.add(quick, at, number)
        sides.far.add(quick, at + 0.01, number)
    found = audited("--offset", "0")
    assert (found["/map"]["latched_value"], found["/map"]["undecided"], found.code) == ("same", 1, 0)
    assert found["/quick_map"]["latched_value"] == "same"


def test_latched_message_that_is_too_young_is_undecided(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/map", durability=LATCHED)
    sides.near.add(topic, 14.9, 1)
    sides.far.add(topic, 14.95, 1)
    found = audited("--offset", "0")
    assert (found["/map"]["latched_value"], found.code) == ("undecided", 0)


def test_each_latched_publisher_keeps_a_value(sides: Sides, audited: Run) -> None:
    """They may arrive in any order, but each has to arrive."""
    sides.spans(15)
    topic, other = (sides.topic(name, durability=LATCHED, publishers=2) for name in ("/tf_static", "/static"))
    for number in (1, 2):
        sides.near.add(topic, 3.0 + number, number)
        sides.far.add(topic, 8.0 - number, number)
        sides.near.add(other, 3.0 + number, number)
    sides.far.add(other, 3.1, 1)
    found = audited()
    assert (found["/tf_static"]["latched_value"], found["/static"]["latched_value"]) == ("same", "old")


def test_silences_have_times_of_both_sides(sides: Sides, audited: Run) -> None:
    sides.spans(30)
    topic = sides.topic("/scan", reliability="best_effort")
    for number in range(200):  # the node is silent from 12 s to 15 s, and the bridge from 5 s to 8 s and from 18 s on
        at = 2 + number * 0.1 if number < 100 else 5 + number * 0.1
        sides.near.add(topic, at, number)
        if not 5 < at < 8 and at < 18:
            sides.far.add(topic, at + 0.01, number)
    gaps = audited("--gap", "1.5")["/scan"]["gaps"]
    near = [(each["start"] - START, each["end"] - START, each["other"], each["open"]) for each in gaps["near"]]
    far = [(each["start"] - START, each["end"] - START, each["other"], each["open"]) for each in gaps["far"]]
    assert near == [
        (pytest.approx(11.9, abs=1e-3), pytest.approx(15.0, abs=1e-3), 0, False),
        (pytest.approx(24.9, abs=1e-3), pytest.approx(30.0, abs=1e-3), 0, True),
    ]
    assert [each[2:] for each in far] == [(29, False), (0, False), (70, True)]
    assert far[0][:2] == (pytest.approx(5.01, abs=0.02), pytest.approx(8.01, abs=0.02))
    assert far[2][:2] == (pytest.approx(17.91, abs=0.02), pytest.approx(30.0, abs=1e-3))


def test_nothing_outside_the_common_time_counts(sides: Sides, audited: Run) -> None:
    """FAR's recording lasts from 5 s to 12 s: neither silences nor messages of NEAR before and after count."""
    sides.near.spans(18)
    topic = sides.topic("/scan")
    for number in range(160):
        at = number * 0.1
        if not 1 < at < 4 and not 13 < at < 15:
            sides.near.add(topic, at, number)
        if 5 <= at <= 12:
            sides.far.add(topic, at + 0.01, number)
    scan = audited()["/scan"]
    assert (scan["gaps"], scan["lost"], scan["elsewhere"]) == ({"near": [], "far": []}, 0, 0)
    back = audited("--back", "/scan", near=sides.near.path, far=sides.far.path)["/scan"]
    assert (back["lost"], back["elsewhere"]) == (0, 0)


def test_slow_topics_have_no_silences(sides: Sides, audited: Run) -> None:
    sides.spans(30)
    topic = sides.topic("/battery")
    for number in range(6):
        sides.near.add(topic, 2 + number * 4, number)
        sides.far.add(topic, 2.01 + number * 4, number)
    assert audited()["/battery"]["gaps"] == {"near": [], "far": []}


def test_lasting_silences_are_counted(sides: Sides, audited: Run) -> None:
    """No more than a hundred are listed."""
    sides.spans(400)
    topic = sides.topic("/scan")
    for number in range(520):
        at = number // 4 * 3 + number % 4 * 0.1
        for side in sides:
            side.add(topic, at + 1, number)
    scan = audited("--gap", "2")["/scan"]
    assert (len(scan["gaps"]["near"]), scan["more_gaps"]["near"]) == (100, 30)


def test_short_messages_that_are_no_cdr(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/odd")
    for number in range(3):
        for side in sides:
            side.add(topic, 2 + number, bytes(number))
    assert audited()["/odd"]["matched"] == 3


def test_content_differs_by_any_bit() -> None:
    base = text(5)
    keys = {content_key(memoryview(base), is_cdr=True)}
    for at in (0, 1, *range(4, len(base))):
        other = bytearray(base)
        other[at] ^= 1
        keys.add(content_key(memoryview(other), is_cdr=True))
    assert len(keys) == len(base) - 1


# --- what once let a loss pass, or made one up


def test_only_a_sender_has_messages_alone_whatever_delays_say(sides: Sides, audited: Run) -> None:
    """NEAR's recorder is late for some messages, so that their differences have a long end on the wrong side."""
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.1 + (0.05 if number % 20 == 0 else 0), number)
        if number not in (30, 40, 50):
            sides.far.add(topic, 2.055 + number * 0.1, number)
    found = audited()
    assert (found["/scan"]["way"], found["/scan"]["way_by"], found["/scan"]["lost"]) == ("to_far", "alone", 3)


def test_messages_that_only_their_sender_covers_are_shown(sides: Sides, audited: Run) -> None:
    topic = sides.topic("/scan")
    for number in range(300):
        sides.near.add(topic, number * 0.1, number)
        if 90 <= number < 210:
            sides.far.add(topic, number * 0.1 + 0.02, number)
    found = audited()
    assert (found["/scan"]["lost"], found["/scan"]["outside"], found.code) == (0, 180, 0)


def test_late_messages_of_an_outage_excuse_no_dead_bridge(sides: Sides, audited: Run) -> None:
    sides.spans(120)
    topic = sides.topic("/scan")
    for number in range(1000):
        at = 1 + number * 0.1
        sides.near.add(topic, at, number)
        if at < 60:
            sides.far.add(topic, max(at, 50) + 0.02, number)
    found = audited()
    assert found["/scan"]["age_p99"] > 40
    assert (found["/scan"]["lost"], found["/scan"]["undecided"]) == (410, 0)


def test_equal_message_that_is_lost_is_not_early(sides: Sides, audited: Run) -> None:
    sides.spans(60)
    topic = sides.topic("/alive")
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.5, 7)
        if number != 50:
            sides.far.add(topic, 2.05 + number * 0.5, 7)
    found = audited("--offset", "0")
    assert (found["/alive"]["lost"], found["/alive"]["early"], found["/alive"]["by_order"]) == (1, 0, 99)


def test_value_that_one_recording_has_from_before_is_another_message(sides: Sides, audited: Run) -> None:
    """FAR's recorder began first, and has the value 1 when NEAR's does not."""
    sides.near.spans(60)
    sides.far.spans(60)
    topic = sides.topic("/mode")
    sides.far.add(topic, 5.0, 1)
    for at, number in ((10.0, 2), (20.0, 3), (30.0, 1)):
        sides.near.add(topic, at, number)
        sides.far.add(topic, at + 0.02, number)
    found = audited("--offset", "0", "--forth", "/mode")
    assert (found["/mode"]["lost"], found["/mode"]["doubled"], found["/mode"]["disordered"]) == (0, 0, 0)
    assert found.code == 0


def test_latched_message_that_a_recorder_got_twice_has_crossed(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    topic = sides.topic("/map", durability=LATCHED)
    sides.far.add(topic, 1.0, 1)
    for at in (3.0, 3.1):
        sides.near.add(topic, at, 1)
    found = audited("--offset", "0", "--forth", "/map")
    assert (found["/map"]["lost"], found["/map"]["nothing_common"], found.code) == (0, False, 0)

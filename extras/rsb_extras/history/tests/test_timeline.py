"""Outages, their lengths and causes, and their aging."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from random import Random

import msgspec
import pytest

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level, Snapshot, Stage, State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.history import timeline, track_record
from rsb_extras.history.history_codes import HistoryCode
from rsb_extras.history.history_data import KEPT_FOR
from rsb_extras.history.recorder import Recorder
from rsb_extras.history.tests import history_places
from rsb_extras.history.tests.hand_clock import EPOCH, HandClock
from rsb_extras.history.tests.world import World, brief
from rsb_extras.history.timeline import Timeline
from rsb_extras.history.track_record import MinuteSeries

HOUR = 3600.0


def test_outage_has_beginning_length_and_cause() -> None:
    world = World("/scan", "/map")
    world.go(600)
    world.put("/scan", State.STALE, "nothing for 15 s")
    world.go(90)
    world.put("/scan", State.OK)
    world.go(310)
    (outage,) = world.outages()
    assert (outage.start, outage.seconds) == (EPOCH + 600, 90)
    assert (outage.link, outage.topic, outage.outgoing) == ("robot1", "/scan", False)
    assert (outage.state, outage.cause, outage.ongoing) == ("stale", "nothing for 15 s", False)
    scan, map_ = world.track("/scan"), world.track("/map")
    assert (scan.up, scan.out, scan.outages) == (910, 90, 1)
    assert (map_.up, map_.out, map_.outages) == (1000, 0, 0)
    assert scan.up_ratio == 0.91
    assert world.outages(200) == (), "it is longer ago"


def test_worst_state_and_first_and_last_words_count() -> None:
    world = World("/scan")
    world.go(100)
    for seconds in (15, 16, 17):
        world.put("/scan", State.STALE, f"nothing for {seconds} s")
        world.go(1)
    assert brief(world.outages())[0][2:] == ("stale", "nothing for 15 s"), "figures that change are no other words"
    world.put("/scan", State.DOWN, "no publisher of /scan")
    world.go(1)
    world.put("/scan", State.STALE, "nothing for 20 s")
    world.put("/scan", State.DOWN, "no publisher of /scan")
    assert brief(world.outages())[0][2:] == ("down", "nothing for 15 s; then: no publisher of /scan")


def test_opening_and_pause_are_no_outage() -> None:
    world = World()
    world.begin("/scan", State.WAITING, "asking the peer")
    world.begin("/map", State.WAITING, "no publisher")
    world.go(10)
    world.put("/scan", State.OK)
    world.go(290)
    world.put("/scan", State.PAUSED)
    world.go(300)
    assert world.outages() == ()
    scan = world.track("/scan")
    assert (scan.up, scan.out, scan.waiting, scan.waits_for) == (290, 0, 10, "")


def test_topic_that_never_opens_is_out_from_beginning() -> None:
    world = World()
    world.begin("/map", State.DOWN, "refused")
    world.go(600)
    (outage,) = world.outages()
    assert (outage.topic, outage.seconds) == ("/map", 600)
    assert (world.track("/map").out, world.track("/map").waiting) == (600, 0)


def test_topic_without_first_message_is_not_out() -> None:
    world = World()
    world.begin("/map", State.WAITING, "no publisher of /map")
    world.go(600)
    assert world.outages() == ()
    track = world.track("/map")
    assert (track.up, track.out, track.waiting, track.up_ratio) == (0, 0, 600, None)
    assert track.waits_for == "no publisher of /map"
    world.put("/map", State.OK)
    world.go(300)
    track = world.track("/map")
    assert (track.up, track.waiting, track.up_ratio, track.waits_for) == (300, 600, 1.0, "")
    restored = Timeline.restore(world.recorder.save(), "robot1", "client")
    assert restored.report(world.clock.wall, HOUR, running=False).tracks[-1].waiting == 600


def test_short_wait_belongs_to_outage_long_ends_it() -> None:
    world = World("/scan")
    world.go(100)
    world.put("/scan", State.DOWN, "refused")
    world.go(50)
    world.put("/scan", State.WAITING, "asking the peer")
    world.go(10)
    world.put("/scan", State.DOWN, "refused")
    world.go(40)
    assert brief(world.outages()) == [("/scan", 100, "down", "refused")]
    world.put("/scan", State.WAITING, "no publisher of /scan")
    world.go(200)
    assert brief(world.outages()) == [("/scan", 130, "down", "refused")]
    track = world.track("/scan")
    assert (track.up, track.out, track.waiting) == (100, 130, 170)


@pytest.mark.parametrize("stages", [(), (Stage("offered", done=True),)], ids=["topic", "service"])
def test_an_outage_ends_when_messages_could_cross_again(stages: tuple[Stage, ...]) -> None:
    """Nobody has published or called since; that is not the link's fault."""
    world = World("/goal_pose")
    world.go(100)
    world.put("/goal_pose", State.DOWN, "the link is down")
    world.go(20)
    calls, cause = (CallsSnapshot(), Cause.NO_CALL) if stages else (None, Cause.PUBLISHER_SILENT)
    opened = replace(world.routes["/goal_pose"], cause=cause, calls=calls, stages=stages)
    world.routes["/goal_pose"] = opened
    world.put("/goal_pose", State.WAITING, "nothing since it was opened again")
    world.go(100)
    (outage,) = world.outages()
    assert outage.seconds == 20
    track = world.track("/goal_pose")
    assert (track.up, track.out, track.waiting) == (100, 20, 100)


def test_a_topic_that_nobody_hears_is_not_out() -> None:
    world = World("/scan")
    world.go(100)
    world.put("/scan", State.UNHEARD, "nobody subscribes")
    world.go(100)
    world.put("/scan", State.SLOW, "2 Hz of 10 expected")
    world.go(50)
    world.put("/scan", State.UNHEARD, "nobody subscribes")
    world.go(50)
    assert brief(world.outages())[0][1:3] == (50, "slow")
    scan = world.track("/scan")
    assert (scan.up, scan.out, scan.outages) == (250, 50, 1)


def test_topics_that_follow_their_link_say_so() -> None:
    world = World("/scan", "/map")
    world.go(100)
    world.put_link(State.DOWN, "the server does not answer")
    world.go(60)
    world.put_link(State.OK)
    world.go(100)
    link, scan, map_ = world.outages()
    assert (link.topic, link.cause) == ("", "the server does not answer")
    assert scan.with_link
    assert map_.with_link
    world.put_link(State.DOWN, "the server does not answer")
    world.put_link(State.OK)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    assert [each.with_link for each in world.outages() if each.topic == "/scan"] == [True, True, False], (
        "its own, by now"
    )


def test_waiting_topic_is_not_out_by_link() -> None:
    world = World()
    world.begin("/scan", State.WAITING, "no publisher")
    world.link = replace(world.link, state=State.DOWN, reason="no answer")
    world.go(20)
    world.link = replace(world.link, state=State.OK)
    world.go(12)
    assert [(each.topic, each.with_link) for each in world.outages()] == [("", False)]


@pytest.mark.parametrize("ahead", [0.0, 1e8])
def test_removed_topic_keeps_its_history_for_day(ahead: float) -> None:
    world = World("/scan")
    world.clock.wall += ahead
    world.go(100)
    world.clock.wall -= ahead
    world.put("/scan", State.DOWN, "no publisher")
    world.go(20)
    del world.routes["/scan"]
    world.go(10)
    assert brief(world.outages()) == [("/scan", 21, "down", "no publisher")]
    world.go(KEPT_FOR + 120, step=20)
    assert world.outages(KEPT_FOR) == ()
    assert [each.topic for each in world.records] == [""]


def test_rates_are_means_of_what_crossed() -> None:
    world = World("/scan")
    world.go(1200, rate=10)
    world.go(1200, rate=20)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(1200)
    rates = world.track("/scan").rates
    assert len(rates) == 48
    assert [rates[0], rates[20], rates[40]] == [10, 20, 0]
    assert world.track("").rates[30] == 1000, "a link's in bytes/s"
    assert world.report(7200.0).tracks[1].rates[0] is None, "it did not run"


def test_a_day_is_kept_and_no_more() -> None:
    world = World("/scan")
    world.go(100)
    for _ in range(30):
        world.put("/scan", State.DOWN, "no publisher")
        world.go(60, step=5)
        world.put("/scan", State.OK)
        world.go(HOUR - 60, step=5)
    assert len(world.outages(KEPT_FOR)) == 24
    (kept,) = [each for each in world.records if each.topic == "/scan"]
    assert len(kept.outages) <= 25
    assert len(MinuteSeries.load(kept.first, kept.rates, kept.up, kept.out, kept.waiting)) <= 1500
    track = world.track("/scan", KEPT_FOR)
    assert abs(track.up + track.out - KEPT_FOR) <= 120
    assert abs(track.out - 24 * 60) <= 60


@pytest.mark.long
def test_fifth_of_topics_takes_fifth_of_space() -> None:
    names = [f"/robot/topic_{number}" for number in range(100)]
    world, now = World(*names), EPOCH
    remembered = Timeline("robot1", "client")
    tracemalloc.start()
    for minute in range(24 * 60):
        for name in names[minute % 10 :: 10]:
            state = State.DOWN if world.routes[name].state is State.OK else State.OK
            reason = "" if state is State.OK else f"no publisher of {name} for {minute} min, " + "and so on " * 10
            world.routes[name] = replace(world.routes[name], state=state, reason=reason)
        now += 60
        remembered.observe(Snapshot(now, "", "", "", 3, True, (world.link,), tuple(world.routes.values())), now)
    used = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert len(remembered.report(now, KEPT_FOR, running=True).outages) == 2000
    assert used < 30e6 / 5


def test_a_flapping_topic_displaces_nobodys_outages(monkeypatch: pytest.MonkeyPatch) -> None:
    history_places.OUTAGES_KEPT.set(monkeypatch, 120)
    world = World("/scan", "/map", "/odom")
    world.go(100)
    world.put("/map", State.DOWN, "no publisher")
    world.go(10)
    world.put("/map", State.OK)
    for _ in range(300):
        for topic in ("/scan", "/odom"):
            world.put(topic, State.STALE, "slow")
        world.go(1)
        for topic in ("/scan", "/odom"):
            world.put(topic, State.OK)
        world.go(1)
    world.go(120)
    report = world.report()
    topics = [each.topic for each in report.outages]
    assert topics.count("/map") == 1
    assert topics.count("/scan") <= track_record.OUTAGES_OF_ONE
    assert len(topics) <= 120
    assert len(topics) + report.outages_left_out == 601, "the number of the missing ones is shown"
    assert world.track("/scan").outages == 300


def test_what_a_peer_can_name_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    history_places.MOST_TRACKS.set(monkeypatch, 20)
    world = World()
    for number in range(100):
        world.routes = World(f"/t{number}", clock=world.clock).routes
        world.go(1)
    assert len(world.records) == 11
    world.routes = World(*(f"/more{number}" for number in range(50)), clock=world.clock).routes
    world.go(1)
    assert len(world.records) == 11


def test_link_with_invented_names_displaces_nobodys(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot's history stays, and its next topic is recorded, in spite of another client's many names."""
    history_places.MOST_TRACKS.set(monkeypatch, 20)
    world = World("/scan", "/gone")
    world.go(1)
    robot = {"/scan": world.routes["/scan"]}
    for number in range(30):
        made_up = World(f"/t{number}", clock=world.clock).routes
        world.routes = robot | {topic: replace(each, link="rogue") for topic, each in made_up.items()}
        world.go(1)
    world.routes |= World("/map", clock=world.clock).routes
    world.go(1)
    known = world.records
    assert {each.topic for each in known if each.link != "rogue" and each.topic} == {"/scan", "/gone", "/map"}
    assert len(known) <= 20


def test_what_finds_no_room_costs_one_walk_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """One walk for all of them: thousands of topics may exceed the kept ones."""
    history_places.MOST_TRACKS.set(monkeypatch, 20)
    walks = []

    def items(self: timeline.TrackRecords) -> object:
        walks.append(len(self))
        return dict.items(self)

    history_places.WALK_TRACKS.set(monkeypatch, items)
    world = World(*(f"/t{number}" for number in range(100)))
    world.go(1)
    walks.clear()
    world.go(3)
    assert len(walks) <= 3
    assert len(world.records) <= 20


def test_operators_actions_are_remembered() -> None:
    world = World("/scan")
    world.go(10)
    world.events.add(
        Level.INFO, EventCode.ROUTE_CONNECTED, "edited", topic="/scan", who="anna", old="max_rate: 5", new="max_rate: 2"
    )
    world.events.add(Level.INFO, EventCode.LINK_UP, "linked", link="robot1")
    world.events.add(Level.WARNING, EventCode.ENGINE_SHUTDOWN, "shut down")
    world.go(10)
    assert [(each.text, each.who, each.new) for each in world.report().actions] == [
        ("edited", "anna", "max_rate: 2"),
        ("shut down", "", ""),
    ]


@pytest.mark.parametrize("jump", [3 * HOUR, -3 * HOUR])
def test_setting_clock_moves_this_runs_records(jump: float) -> None:
    world = World("/scan")
    world.go(600)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    world.events.add(Level.WARNING, EventCode.ENGINE_SHUTDOWN, "before")
    world.go(5)
    world.clock.wall += jump
    world.go(60)
    world.put("/scan", State.OK)
    world.go(600)
    report = world.report()
    (outage,) = report.outages
    assert (outage.start, outage.seconds) == (EPOCH + jump + 600, 125), "no longer than it was"
    assert report.time == world.clock.wall
    shut_down, clock_set = report.actions
    assert shut_down.time == EPOCH + jump + 660
    assert clock_set.code == HistoryCode.CLOCK_SET
    assert f"set {'forward' if jump > 0 else 'back'} by 3 h" in clock_set.text
    assert [round(gap.seconds) for gap in report.gaps] == [3600 - 1325], "only the time before the start"
    track = world.track("/scan")
    assert (track.up, track.out) == (1200, 125)
    assert track.rates[-1] == 10


def test_sleep_is_gap_that_ends_outages() -> None:
    world = World("/scan", "/map")
    world.go(600)
    world.put("/map", State.DOWN, "no publisher")
    world.go(60)
    world.clock.go(2 * HOUR)
    world.go(60)
    report = world.report(3 * HOUR)
    assert [(gap.start, round(gap.seconds)) for gap in report.gaps][1:] == [(EPOCH + 660, 7201)]
    before, after = report.outages
    assert (before.seconds, before.cut_off) == (60, True)
    assert (after.topic, after.ongoing) == ("/map", True)
    assert report.actions[0].code == HistoryCode.GAP
    assert " 2 h:" in report.actions[0].text
    assert world.track("/scan", 3 * HOUR).out == 0


def test_hung_or_ended_engine_is_not_fine() -> None:
    world = World("/scan")
    world.go(60)
    for _ in range(100):
        world.clock.go(1)
        world.recorder.record()
    assert round(sum(gap.seconds for gap in world.report(160).gaps)) == 100
    world.go(60)
    (event,) = world.events.after(0)  # once
    assert event.code == HistoryCode.GAP
    assert " 1 min 41 s:" in event.text
    world.running = False
    world.go(600)
    for _ in range(100):
        world.clock.go(1)
        world.recorder.record()
    assert world.report(800).gaps[-1].seconds >= 700
    assert len(world.events.after(0)) == 1, "the cause is shown"


def next_process(world: World, away: float) -> World:
    """The next one, after so many s, on what the first one saved."""
    world.timeline.cut()
    saved = msgspec.msgpack.decode(msgspec.msgpack.encode(world.recorder.save()), type=timeline.Saved)
    world.clock.go(away)
    new = World(*world.routes, clock=world.clock)
    new.recorder.restore(saved)
    new.recorder.record()
    return new


def test_a_slow_topic_is_not_down_before_its_link_is() -> None:
    world = World("/scan")
    world.go(600)
    world.put("/scan", State.SLOW, "2 Hz of 20 expected")
    world.go(60)
    world.put_link(State.DOWN, "no answer")
    world.go(30)
    world.put_link(State.OK)
    world.go(60)
    assert brief(world.outages()) == [
        ("/scan", 62, "slow", "2 Hz of 20 expected"), ("", 32, "down", "no answer"), ("/scan", 32, "down", "no link"),
    ]  # fmt: skip
    assert [each.with_link for each in world.outages()] == [False, False, True]


def test_restart_is_gap_with_everything_else_kept() -> None:
    world = World("/scan", "/map")
    world.go(600)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    world.put("/scan", State.OK)
    world.put("/map", State.STALE, "nothing for 15 s")
    world.events.add(Level.INFO, EventCode.ROUTE_PAUSED, "paused", who="anna")
    world.go(60)
    world = next_process(world, 300)
    world.go(600)
    report = world.report()
    assert brief(report.outages) == [("/scan", 60, "down", "no publisher"), ("/map", 60, "stale", "nothing for 15 s")]
    assert report.outages[1].cut_off
    assert [each.who for each in report.actions] == ["anna"]
    assert [(gap.start, round(gap.seconds)) for gap in report.gaps][1:] == [(EPOCH + 720, 300)]
    scan = world.track("/scan")
    assert (scan.up, scan.out) == (660 + 600, 60)


def test_machine_with_old_time_is_corrected_later() -> None:
    world = World("/scan")
    world.go(600)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    clock = HandClock()
    clock.wall, clock.up = EPOCH - 5 * HOUR, 0.0
    world.clock.__dict__.update(clock.__dict__)
    world = next_process(world, 10)
    world.go(300)
    before = world.report(2 * HOUR)
    assert before.time == EPOCH + 660 + 300, "time goes on from where it was"
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    world.clock.wall = EPOCH + 8 * HOUR
    world.go(60)
    after = world.report(10 * HOUR)
    assert [round(each.start - EPOCH) for each in after.outages] == [600, round(8 * HOUR - 60)]
    assert abs(world.track("/scan", HOUR).up - 300) <= 60
    assert world.track("/scan", 4 * HOUR).up < 360, "the day before is not in the last hours"


def test_a_process_that_ran_ahead_puts_nothing_into_the_future() -> None:
    world = World("/scan")
    world.go(600)
    world = next_process(world, 3000)
    world.clock.wall += HOUR  # set by hand, and wrong
    world.go(600)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    world.put("/scan", State.OK)
    world.clock.wall -= HOUR  # set right while nothing ran
    world = next_process(world, 60)
    world.go(700)
    world.put("/scan", State.STALE, "nothing for 15 s")
    world.go(10)
    report = world.report(2 * HOUR)
    assert report.time == world.clock.wall
    assert [(each.start - EPOCH, each.state) for each in report.outages] == [(4260, "down"), (5020, "stale")]
    assert [round(gap.seconds) for gap in report.gaps][1:] == [3060], "how far it was ahead is known to the pause only"
    scan = world.track("/scan", 2 * HOUR)
    assert (scan.up, scan.out) == (600 + 600 + 700, 70)
    assert sum("earlier process was ahead by 59 min" in each.text for each in world.events.after(0)) == 1


def test_a_history_from_the_future_is_refused() -> None:
    world = World("/scan")
    world.go(60)
    saved = world.recorder.save()
    world.clock.wall -= 3 * KEPT_FOR
    with pytest.raises(ValueError, match="future"):
        World(clock=world.clock).recorder.restore(saved)


def test_an_event_from_the_future_moves_nothing() -> None:
    world = World("/scan")
    world.go(60)
    saved = world.recorder.save()
    event = Event(0, world.clock.wall + 20 * KEPT_FOR, Level.WARNING, "link.lost", "late", "robot1")
    again = World(clock=world.clock)
    again.recorder.restore(saved, [event])
    again.go(60)
    assert abs(again.report(HOUR).time - world.clock.wall) < HOUR


def test_what_does_not_fit_together_is_refused() -> None:
    world = World("/scan")
    world.go(130)
    saved = world.recorder.save()
    first = msgspec.structs.replace(saved.subjects[0], up=b"")
    with pytest.raises(ValueError, match="rates"):
        Timeline.restore(msgspec.structs.replace(saved, subjects=(first,)), "robot1", "client")


def test_actions_and_outages_are_clean_text() -> None:
    world = World("/scan")
    world.go(60)
    world.put("/scan", State.DOWN, "evil\x1b[2J\u202etext" + "x" * 5000)
    world.go(10)
    (outage,) = world.outages()
    assert "\x1b" not in outage.cause
    assert "\u202e" not in outage.cause
    assert len(outage.cause) < 600


def test_a_recorder_that_was_never_started_answers() -> None:
    """Its engine could not start, and its console shows the history all the same."""
    assert World("/scan").recorder.history(60.0).result(60).name == "robot1"


def test_a_question_that_fails_costs_no_other() -> None:
    recorder = World("/scan").recorder
    recorder.start()
    with pytest.raises(ZeroDivisionError):
        recorder.ask(lambda: 1 / 0).result(60)
    assert recorder.ask(lambda: "answered").result(60) == "answered"
    recorder.stop(10)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_failed_answers_all_the_same() -> None:
    clock = HandClock()

    def broken() -> Snapshot:
        raise ZeroDivisionError

    recorder = Recorder("robot1", "client", EventLog(clock), broken, clock)
    recorder.start()
    with pytest.raises(ZeroDivisionError):
        recorder.history(60.0).result(60)
    recorder.stop(10)  # else pytest may find the thread's failure in another test


@pytest.mark.parametrize("seed", range(5))
def test_snapshots_that_stay_the_same_object_are_remembered_as_new_ones_are(seed: int) -> None:
    """A topic to which nothing happens is not looked at each second, and its time counts all the same."""
    random = Random(seed)
    worlds = World("/scan", "/map"), World("/scan", "/map")
    states = State.OK, State.WAITING, State.PAUSED, State.DOWN, State.STALE, State.UNHEARD
    for world in worlds:
        world.begin("/late", State.WAITING, "no publisher")  # one that never opens
    for _ in range(60):
        topic, state, quiet = random.choice(["/scan", "/map", "/late"]), random.choice(states), random.randrange(1, 90)
        state = random.choice([State.WAITING, State.DOWN]) if topic == "/late" else state
        for is_new, world in enumerate(worlds):
            world.put(topic, state, f"it is {state}")
            for _ in range(quiet):
                world.clock.go(1.0)
                if is_new:
                    world.routes = {name: replace(each) for name, each in world.routes.items()}
                world.renew()
                world.recorder.record()
        if random.random() < 0.2:
            assert worlds[0].report() == worlds[1].report()
    assert worlds[0].records == worlds[1].records

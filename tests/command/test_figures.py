"""The commands `hz`, `bw` and `info`: what they print of a topic, and how they exit."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from tests.console.scripted import LINK, NOW, SESSION, ScriptedEngine, route
from tests.support import constants, replaced
from tests.support.held import held_by
from tests.support.running import Running

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, State
from rsb_bridge.model.verdict import LinkCause
from rsb_console.command import figures
from rsb_console.command.figures import SnapshotWindow
from rsb_console.command.formatting import link_word, links_of

if TYPE_CHECKING:
    from tests.support.commands import Ran
    from tests.support.control import Machine

    from rsb_bridge.control.remote_engine import RemoteEngine

SCAN = route("/scan", outgoing=True, spec=Topic("/scan", "transmit", expected_rate=10.0), messages_total=7122)
DOCK = route("/dock", spec=Topic("/dock", "transmit", kind="service"), outgoing=True, calls=CallsSnapshot(asked=2))


@pytest.fixture
def engine(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Running:
    constants.FIGURES_EVERY.set(monkeypatch, 0.05)
    constants.FIGURES_LEDGER_FROM.set(monkeypatch, 0.0)
    return machine.have(Running(msgspec.structs.replace(SESSION, topics=(SCAN.spec,)), routes=(SCAN, DOCK)))


def objects(done: Ran) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.out.splitlines()]


def test_hz_gives_the_rate_over_the_window(ran: Any, engine: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    newer = replaced.NEWER_FIGURES.value

    def seen(*given: Any) -> Any:
        now = newer(*given)
        engine.seen = True
        return now

    replaced.NEWER_FIGURES.set(monkeypatch, seen)
    engine.waits = True
    done = ran("hz", "/scan", "--count", "3", "--json", "--window", "2")
    assert done.code == 0
    found = objects(done)
    assert len(found) == 3
    for each in found:
        assert (each["rate"], each["offered_rate"], each["delivered_rate"]) == (10.0, 20.0, 10.0)
        assert (each["topic"], each["link"], each["measured"]) == ("/scan", "robot1", "sent")
        assert (each["expected_rate"], each["usual_rate"]) == (10.0, None)
        assert each["seconds"] <= 2
    assert found[-1]["each_second"] == {"seconds": 2, "min": 10, "max": 10, "std_dev": 0.0}


def test_hz_for_people_has_the_words_of_ros2(ran: Any, engine: Running) -> None:
    done = ran("hz", "/scan", "--count", "1")
    assert done.code == 0
    assert "average rate: 10.000 Hz" in done.out
    assert "std dev" in done.out
    assert "\n\tin each of the last" in done.out
    assert "\\t" not in done.out


def test_bw_gives_bytes_and_sizes(ran: Any, engine: Running) -> None:
    (found,) = objects(ran("bw", "/scan", "--count", "1", "--json"))
    assert (found["bytes_per_second"], found["mean_size"]) == (1000.0, 100.0)
    assert found["bytes_total"] > found["bytes"]
    people = ran("bw", "/scan", "--count", "1")
    assert people.code == 0
    assert "1.0 kB/s" in people.out
    assert "100 B" in people.out
    assert "\n\tmessage size mean" in people.out


@pytest.mark.parametrize("name", ["hz", "bw"])
def test_without_a_message_they_exit_with_1(ran: Any, engine: Running, name: str) -> None:
    engine.step = 0
    silent = replace(SCAN, state=State.STOPPED, cause="publisher_silent", last_at=NOW - 12.0)
    engine.now = replace(engine.now, routes=(silent,))
    done = ran(name, "/scan", "--count", "1", "--json")
    assert done.code == 1
    (found,) = objects(done)
    assert (found["state"], found["cause"], found["messages"]) == ("stopped", "publisher_silent", 0)
    assert ran(name, "/scan", "--count", "1").code == 1


@pytest.mark.parametrize("name", ["hz", "bw", "info"])
def test_name_that_is_not_bridged_is_wrong_usage(ran: Any, engine: Running, name: str) -> None:
    done = ran(name, "/scna")
    assert done.code == 2
    assert "/scan" in done.err
    assert ran(name, "/scan", "--link", "robot7").code == 2


@pytest.mark.parametrize("name", ["hz", "bw"])
def test_a_service_has_no_figures_of_messages(ran: Any, engine: Running, name: str) -> None:
    assert ran(name, "/dock", "--count", "1").code == 2


def test_what_is_removed_meanwhile_ends_it(ran: Any, engine: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone(SnapshotWindow):
        def add(self, moment: float, route: RouteSnapshot) -> Any:
            engine.now = replace(engine.now, routes=())
            return super().add(moment, route)

    replaced.FIGURES_WINDOW.set(monkeypatch, Gone)
    assert ran("hz", "/scan", "--for", "60", "--json").code == 1


def test_counts_that_begin_again_are_no_negative_rate() -> None:
    window = SnapshotWindow(10)
    assert window.add(NOW, SCAN) is None
    assert window.add(NOW + 1, replace(SCAN, messages_total=3, bytes_total=300)) is None
    found = window.add(NOW + 2, replace(SCAN, messages_total=7, bytes_total=700))
    assert found is not None
    assert (found.rate, found.size) == (4.0, 400)


def test_a_window_forgets_what_is_older() -> None:
    window = SnapshotWindow(3)
    for second in range(1000):
        found = window.add(NOW + second, replace(SCAN, messages_total=7122 + second * second))
    assert found is not None
    assert (found.seconds, found.messages) == (3.0, 999**2 - 996**2)
    assert held_by(window) == 4


def test_info_of_a_topic(ran: Any, engine: Running) -> None:
    slow = replace(SCAN, state=State.SLOW, cause="slow", reason="3 Hz", publishers=("/lidar",), subscribers=("/nav",))
    engine.now = replace(engine.now, routes=(slow,))
    done = ran("info", "/scan")
    assert done.code == 0, "it is shown in any state"
    words = ("/lidar", "/nav", "SLOW", "udp port 49152", "best effort", "queue full", SCAN.type_name, SCAN.type_hash)
    for word in words:
        assert word in done.out
    found = ran("info", "/scan", "--json").json
    assert (found["ok"], found["type"], found["type_hash"]) == (True, SCAN.type_name, SCAN.type_hash)
    assert (found["publishers"], found["subscribers"], found["state"]) == (["/lidar"], ["/nav"], "slow")
    assert (found["transport"], found["port"], found["direction"]) == ("udp", 49152, "transmit")
    assert found["publisher_qos"]["reliability"] == "best_effort"
    assert found["subscriber_qos"] is None
    assert found["link_status"]["state"] == "ok"


def test_the_ledger_of_info_adds_up(ran: Any, engine: Running) -> None:
    ledger = Ledger(offered=806, delivered=791, waiting=2, in_flight=4, unknown=9, missed_while_down=40)
    engine.now = replace(engine.now, routes=(replace(SCAN, ledger=ledger),))
    engine.step = 0
    lines = ran("info", "/scan").out.splitlines()
    (equation,) = (line for line in lines if line.startswith("Ledger:"))
    offered, parts = equation.split("=")
    counts = [int(number) for number in re.findall(r"\d+", parts)]
    assert [int(number) for number in re.findall(r"\d+", offered)] == [sum(counts)] == [806]
    assert 9 in counts
    assert 40 not in counts, "missed messages were never offered"
    assert any(re.search(r"\b40\b", line) for line in lines), "they have a line of their own"


class Dropping(Running):
    """An engine whose link delivers 2 of the 10 messages a second that it is given."""

    def _more(self, before: RouteSnapshot) -> RouteSnapshot:
        more, was = super()._more(before), before.ledger
        dropped = {"queue full": was.dropped.get("queue full", 0) + 8}
        return replace(more, ledger=replace(more.ledger, delivered=was.delivered + 2, dropped=dropped))


@pytest.mark.parametrize("name", ["hz", "bw", "info"])
def test_full_link_shows_delivered_beside_given(
    ran: Any, machine: Machine, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    constants.FIGURES_EVERY.set(monkeypatch, 0.05)
    machine.serve(Dropping(msgspec.structs.replace(SESSION, topics=(SCAN.spec,)), routes=(SCAN,)))
    people = ran(name, "/scan", *(() if name == "info" else ("--count", "3")))
    assert people.code == 0
    found = re.findall(r"delivered: (\S+) Hz, dropped: (\S+) Hz", people.out)
    assert found[-1] == ("2.0", "8.0")
    if name != "info":
        last = objects(ran(name, "/scan", "--count", "3", "--json"))[-1]
        assert (last["delivered_rate"], last["dropped_rate"]) == (2.0, 8.0)


def test_figures_begin_with_a_snapshot_of_their_own() -> None:
    """Not with the route that the command chose, which may be older."""
    engine = Running(SESSION, routes=(SCAN,))
    for _ in range(5):
        engine.snapshot()
    found = figures.measured(cast("RemoteEngine", engine), SCAN, 1.0)
    assert found is not None
    assert found.rate == 10.0


def test_info_of_service_and_of_untyped_topic(ran: Any, engine: Running) -> None:
    assert "2 asked" in ran("info", "/dock").out
    assert ran("info", "/dock", "--json").json["calls"]["asked"] == 2
    engine.now = replace(engine.now, routes=(replace(SCAN, spec=Topic("/scan", "transmit"), type_name=""),))
    assert "Type: not known yet" in ran("info", "/scan").out


@pytest.mark.parametrize(
    ("cause", "word"), [(LinkCause.NONE, "OK"), (LinkCause.FULL, "FULL"), (LinkCause.NAME_TAKEN, "WARN")]
)
def test_link_with_warning_is_not_ok_in_words(cause: LinkCause, word: str) -> None:
    link = replace(LINK, cause=cause, warning="something" if cause else "", warning_since=NOW - 5 if cause else None)
    snapshot = replace(ScriptedEngine().snapshot(), links=(link,))
    found: Any = links_of(snapshot)["robot1"]
    assert link_word(link) == word
    assert found["state"] == "ok"
    assert found["since"] == (NOW - 5 if cause else LINK.since)

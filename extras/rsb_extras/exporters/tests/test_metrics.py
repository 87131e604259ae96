"""A snapshot as metrics: names, labels and counters as Prometheus expects them, for all texts of a peer."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry
from prometheus_client.exposition import generate_latest
from prometheus_client.openmetrics import exposition as openmetrics
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics_families
from prometheus_client.parser import text_string_to_metric_families as plain_families
from tests.console.scripted import LINK, NOW, route

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Ledger, Level, Snapshot, State
from rsb_bridge.telemetry.event_log import KEPT, EventLog
from rsb_extras.exporters.metrics import DROPPED, FAMILIES, OTHER, SnapshotCollector

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot

_ROOT = Path(__file__).parents[4]
CALLS = route(
    "/dock",
    outgoing=True,
    spec=Topic("/dock", "receive", kind="service"),
    ledger=Ledger(),
    calls=CallsSnapshot(9, 5, 1, {"paused": 2}, 1, 0, 0, 3, 0.1, 0.2, 0.3, 0.4),
)


LOSSY = replace(LINK, loss_out=0.3, loss_in=0.0)


class Scraped:
    """An engine with a scripted snapshot, and a scraper."""

    def __init__(self) -> None:
        self.routes: tuple[RouteSnapshot, ...] = ()
        self.time = NOW
        self.events = EventLog(Clock())
        self.registry = CollectorRegistry()
        self.registry.register(SnapshotCollector(self._look, self.events))

    def _look(self) -> Snapshot:
        return Snapshot(self.time, "hub", "server", "[::]:7060", 3, running=True, links=(LOSSY,), routes=self.routes)

    def samples(self, *routes: RouteSnapshot) -> dict[tuple[str, tuple[str, ...]], float]:
        """Return the samples by name and the values of the labels in their order, without session and link."""
        self.routes = routes
        text = generate_latest(self.registry).decode()
        found: dict[tuple[str, tuple[str, ...]], float] = {}
        for family in plain_families(text):
            for sample in family.samples:
                labels = tuple(value for name, value in sample.labels.items() if name not in ("session", "link"))
                assert (sample.name, labels) not in found
                found[sample.name, labels] = sample.value
        return found

    def dropped(self, ledger: Ledger) -> dict[str, float]:
        """Return the drops of a route with that ledger in the metrics, by cause."""
        found = self.samples(route("/scan", ledger=ledger))
        return {labels[0]: value for (name, labels), value in found.items() if name == "rsb_messages_dropped_total"}


@pytest.fixture
def scraped() -> Scraped:
    return Scraped()


def test_names_and_labels_are_as_prometheus_wants_them() -> None:
    names = [family.name for family in FAMILIES]
    assert len(set(names)) == len(names)
    for family in FAMILIES:
        assert re.fullmatch(r"rsb(_[a-z]+)+", family.name)
        assert not re.search(r"_(ms|milliseconds|percent|kilobytes|count|sum|bucket)(_|$)", family.name)
        assert family.text.endswith(".")
        assert {"reason", "peer", "text"}.isdisjoint(family.labels)


def test_each_count_of_the_ledger_is_a_metric() -> None:
    names = {family.name for family in FAMILIES}
    for count in {each.name for each in fields(Ledger)} - {"waiting_since"}:
        assert names & {f"rsb_messages_{count}", f"rsb_messages_{count}_total"}, count


def test_every_family_has_samples_in_both_formats(scraped: Scraped) -> None:
    scraped.routes = (route("/scan"), CALLS)
    for text, parse in (
        (generate_latest(scraped.registry).decode(), plain_families),
        (openmetrics.generate_latest(scraped.registry).decode(), openmetrics_families),  # type: ignore[no-untyped-call]
    ):
        families: Any = parse(text)
        sampled = {sample.name: set(sample.labels) for family in families for sample in family.samples}
        assert sampled == {family.name: set(family.labels) for family in FAMILIES}


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")
def test_prometheus_s_own_linter_has_nothing_to_say(scraped: Scraped) -> None:
    scraped.routes = (route("/scan"), CALLS)
    text = generate_latest(scraped.registry)
    run = subprocess.run(["promtool", "check", "metrics"], input=text, capture_output=True, timeout=60, check=False)
    assert (run.returncode, run.stdout + run.stderr) == (0, b"")


def test_the_document_says_their_labels() -> None:
    document = (_ROOT / "extras/rsb_extras/exporters/docs/metrics.md").read_text(encoding="utf-8")
    short = {"topic": ["link", "topic", "direction"], "route": ["link", "topic", "direction", "kind"]}
    labels: dict[str, list[str]] = {}
    for row in re.findall(r"^\| (`rsb_.+?) \|(.*?)\|", document, re.MULTILINE):
        said = [short.get(each, [each.strip("`")]) for each in row[1].strip().split(", ") if each]
        labels |= {name: [each for part in said for each in part] for name in re.findall(r"`(rsb_\w+)`", row[0])}
    assert labels == {family.name: list(family.labels) for family in FAMILIES}


LAST = "rsb_route_last_message_timestamp_seconds", ("in", "topic", "/scan")


def test_last_message_of_idle_route_does_not_move(scraped: Scraped) -> None:
    """Such a route is not renewed in a new snapshot."""
    idle = route("/scan", last_at=NOW - 4.0)
    assert scraped.samples(idle)[LAST] == NOW - 4.0
    scraped.time += 10.0
    assert scraped.samples(idle)[LAST] == NOW - 4.0


def test_the_figures_are_the_snapshots(scraped: Scraped) -> None:
    found = scraped.samples(route("/scan", State.STALE, last_at=NOW - 4.0, jitter=None), CALLS)
    scan, dock = ("in", "/scan"), ("out", "service", "/dock")
    assert found["rsb_messages_offered_total", scan] == 7134
    assert found["rsb_messages_dropped_total", ("lost on the way", *scan)] == 7
    assert ("rsb_messages_jitter_seconds", scan) not in found
    assert ("rsb_messages_latency_seconds", ("in", "99", "/scan")) in found
    assert found["rsb_route_last_message_timestamp_seconds", ("in", "topic", "/scan")] == NOW - 4
    scraped.time += 10.0  # an idle route is not renewed
    assert (
        scraped.samples(*scraped.routes)["rsb_route_last_message_timestamp_seconds", ("in", "topic", "/scan")]
        == NOW - 4
    )
    assert found["rsb_route_level", ("in", "topic", "/scan")] == 2
    assert found["rsb_route_state", ("in", "topic", "stale", "/scan")] == 1
    assert found["rsb_calls_asked_total", dock] == 9
    assert found["rsb_calls_refused_total", ("paused", *dock)] == 2
    assert not [name for name, labels in found if name.startswith("rsb_messages") and "/dock" in labels]
    assert not [name for name, labels in found if name.startswith("rsb_calls") and "/scan" in labels]


def test_late_message_makes_no_counter_smaller(scraped: Scraped) -> None:
    assert scraped.dropped(Ledger(10, 7, dropped={"lost on the way": 3})) == {"lost on the way": 3}
    assert scraped.dropped(Ledger(10, 10)) == {"lost on the way": 3}
    assert scraped.dropped(Ledger(20, 16, dropped={"lost on the way": 4})) == {"lost on the way": 4}
    assert scraped.dropped(Ledger(2, 1, dropped={"lost on the way": 1})) == {"lost on the way": 1}, "a new life"


def test_unknown_and_missed_have_counters_of_their_own(scraped: Scraped) -> None:
    found = scraped.samples(
        route("/scan", ledger=Ledger(10, 7, dropped={"queue full": 1}, unknown=2, missed_while_down=40))
    )
    figures = {name: value for (name, _), value in found.items()}
    assert figures["rsb_messages_unknown_total"] == 2
    assert figures["rsb_messages_missed_while_down_total"] == 40
    assert figures["rsb_messages_dropped_total"] == 1


def test_a_peer_makes_up_no_labels(scraped: Scraped) -> None:
    for number in range(50):
        dropped = {f"cause {number} {each}": 1 for each in range(30)} | {"queue full": 2}
        assert scraped.dropped(Ledger(1000, 900, dropped=dropped)) == {"queue full": 2, OTHER: 30}


@given(
    st.lists(
        st.builds(
            Ledger,
            offered=st.integers(0, 9),
            delivered=st.integers(0, 9),
            dropped=st.dictionaries(st.sampled_from(["queue full", "made up", "invented"]), st.integers(0, 9)),
        ),
        max_size=5,
    )
)
def test_counter_becomes_smaller_only_where_everything_begins_anew(ledgers: list[Ledger]) -> None:
    scraped, offered, before = Scraped(), 0, dict[tuple[str, tuple[str, ...]], float]()
    for ledger in ledgers:
        now = scraped.samples(route("/scan", ledger=ledger))
        counters = {
            key: value for key, value in now.items() if key[0].startswith("rsb_messages_") and "total" in key[0]
        }
        if ledger.offered >= offered:
            assert all(counters[key] >= value for key, value in before.items())
        offered, before = ledger.offered, counters


def test_topics_with_one_local_name_are_told_apart(scraped: Scraped) -> None:
    """Prometheus takes no two samples with the same labels; `Scraped.samples` sees to that."""
    ways = [route("/all", key=name, remote_topic=name) for name in ("/a", "/b")]
    found = scraped.samples(*ways, route("/alone"))
    topics = {labels[-1] for name, labels in found if name == "rsb_route_rate_hertz"}
    assert topics == {"/all (/a)", "/all (/b)", "/alone"}


def test_what_is_gone_is_not_remembered(scraped: Scraped) -> None:
    scraped.samples(route("/scan", ledger=Ledger(100, 100)))
    scraped.samples()
    found = scraped.samples(route("/scan", ledger=Ledger(100, 50)))
    assert found["rsb_messages_delivered_total", ("in", "/scan")] == 50


def test_events_are_counted_though_they_are_not_kept(scraped: Scraped) -> None:
    for _ in range(KEPT + 7):
        scraped.events.add(Level.WARNING, EventCode.KEY_WARNING, "x")
    found = scraped.samples()
    assert found["rsb_events_total", ("WARNING",)] == KEPT + 7
    assert found["rsb_events_total", ("ERROR",)] == 0


def test_every_cause_has_its_own_label() -> None:
    causes = set(re.findall(r"``([a-z ]+)``", (Ledger.__doc__ or "").partition("each cause:")[2]))
    assert causes
    assert causes <= DROPPED
    source = "".join(path.read_text() for path in (_ROOT / "bridge/rsb_bridge/route").rglob("*.py"))
    named = set(re.findall(r'(?:\.drop|_NotPublishedError|_dropped)[\[(]"([a-z ]+)"', source))
    assert len(named) > 5
    assert named <= DROPPED


def test_a_link_has_one_state(scraped: Scraped) -> None:
    found = scraped.samples()
    assert found["rsb_link_up", ()] == 1
    assert found["rsb_link_state", ("ok",)] == 1
    assert [labels for name, labels in found if name == "rsb_link_state"] == [("ok",)]

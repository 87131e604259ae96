"""The two recordings of a benchmark on one machine: of real runs, of simulated ones, and their limits."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest
from tests.support import surroundings
from tests.support.commands import Ran
from tests.support.replaced import BENCH_MEASURE
from tests.support.wording import says

from rsb_bridge.cdr.known_types import made_at, serialize_string, stamped_string
from rsb_console.command.shell import OK
from rsb_extras.bench.bench_recording import BenchRecording, RecordingText
from rsb_extras.bench.kept_messages import KeptMessage, KeptMessages, read_kept
from rsb_extras.bench.measured_stream import MeasuredArrivals
from rsb_extras.bench.results import BenchReport, Run
from rsb_extras.bench.suite import QUICK, Plan, Suite
from rsb_extras.bench.tests.bench_places import LOOPBACK, MOST_BYTES, MOST_FOREIGN, MOST_MESSAGES, WRITE_RECORDINGS
from rsb_extras.bench.tests.command_helpers import TINY, bench
from rsb_extras.bench.tests.simulated import SimulatedLink, SimulatedPlace
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from pathlib import Path

EPOCH = 1_700_000_000_000_000_000  # ns


class Recorded(NamedTuple):
    """A message of a recording."""

    published: int
    logged: int
    number: int
    content: bytes


def recorded(path: str | Path) -> dict[str, list[Recorded]]:
    """Return a recording's messages by topic."""
    found = defaultdict(list)
    for _, channel, message in read_strictly(path):
        found[channel.topic].append(Recorded(message.publish_time, message.log_time, message.sequence, message.data))
    return found


def runs_of(report: BenchReport) -> dict[str, Run]:
    """Return the runs of a report by topic, all of which have one."""
    runs = {run.topic: run for point in report.points for run in point.runs}
    assert "" not in runs
    return runs


@pytest.mark.parametrize("transport", ["tcp", "udp", "zenoh"])
def test_recordings_agree_with_report_and_audit(
    transport: str, tmp_path: Path, spare_domains: int, capsys: pytest.CaptureFixture[str]
) -> None:
    if transport == "zenoh":
        pytest.importorskip("zenoh", reason="needs Zenoh")
    domains = f"{spare_domains},{spare_domains + 1}"
    target = str(tmp_path / "run.mcap")
    code, output, errors = bench(*TINY, "--quick", "--transports", transport, "--domains", domains, "--record", target)
    assert code == 0, output or errors
    report = msgspec.json.decode(output, type=BenchReport)
    assert report.recordings == [str(tmp_path / "run-near.mcap"), str(tmp_path / "run-far.mcap")]
    near, far = map(recorded, report.recordings)
    runs = runs_of(report)
    assert near.keys() == runs.keys()
    assert f"/bench/{transport}/bytes_2500/latency_100_hz" in runs
    ages = {}
    for topic, run in runs.items():
        sent, heard = near[topic], far[topic]
        assert (len(sent), len(heard)) == (run.sent, run.received)
        assert [each.number for each in sent] == list(range(1, run.sent + 1))
        assert {each.number for each in heard} == {0}
        # What was heard was sent, byte by byte, with the same stamp; and each message is another one.
        contents = {each.content: each.published for each in sent}
        assert len(contents) == run.sent
        assert all(contents[each.content] == each.published for each in heard)
        latencies = sorted(each.logged - each.published for each in heard)
        assert latencies[len(latencies) // 2] / 1e6 == pytest.approx(run.p50)
        ages[topic] = latencies[(len(latencies) - 1) // 2] / 1e9
    audited = json.loads(Ran(capsys, "audit", *report.recordings, "--offset", "0", "--json").out)
    assert {each["topic"]: pytest.approx(each["age_p50"]) for each in audited["topics"]} == ages
    for each in audited["topics"]:
        run = runs[each["topic"]]
        assert each["matched"] == run.received
        assert each["lost"] + each["early"] + each["undecided"] == run.sent - run.received
        assert (each["doubled"], each["disordered"], each["way"], each["reliable"]) == (0, 0, "to_far", True)
    kinds = {each["kind"] for each in audited["breaches"]}
    assert kinds == ({"lost"} if any(each["lost"] for each in audited["topics"]) else set())


class RecordedLink(SimulatedLink):
    """Keeps for a recording what it carries: of each run the first messages, each of which takes 1 ms."""

    def __init__(self, recording: BenchRecording, name: str, bytes_per_second: float = 10e6) -> None:
        super().__init__(bytes_per_second)
        self._recording = recording
        self._name = name

    def send(self, rate: float, seconds: float, size: int, part: str = "") -> Run:
        run = super().send(rate, seconds, size)
        if not part:
            return run
        kept = self._recording.keep(f"/bench/{self._name}/{size}/{part}", 5)
        for path, count, later in ((kept.near, run.sent, 0), (kept.far, run.received, 1_000_000)):
            messages = KeptMessages(size)
            for made in range(1000, 1000 + count):
                messages.add(made, made + later, stamped_string(size, made))
            assert messages.write(path, count)
        return replace(run, topic=kept.topic)


PLAN = replace(QUICK, sizes=(256, 2500))


def simulated(folder: Path, bytes_per_second: float = 10e6) -> tuple[BenchRecording, BenchReport, RecordedLink]:
    report = BenchReport("a link", "a machine")
    waiting = folder / "waiting"
    waiting.mkdir()
    recording = BenchRecording(folder / "near.mcap", folder / "far.mcap", waiting, report, EPOCH)
    return recording, report, RecordedLink(recording, "tcp", bytes_per_second)


def measure(report: BenchReport, link: RecordedLink, plan: Plan = PLAN) -> None:
    place = SimulatedPlace({"tcp": link})
    Suite(place, plan, report, lambda: place.time, lambda _: None).run()


def test_each_reported_run_is_topic_with_its_losses(tmp_path: Path) -> None:
    recording, report, link = simulated(tmp_path)
    measure(report, link)
    recording.write(lambda _: None)
    near, far = recorded(tmp_path / "near.mcap"), recorded(tmp_path / "far.mcap")
    runs = runs_of(report)
    counts = {topic: (run.sent, run.received) for topic, run in runs.items()}
    assert {topic: (len(near[topic]), len(far[topic])) for topic in near} == counts
    assert any(sent > received for sent, received in counts.values())
    assert len(counts) < len(link.tried)  # a search has more runs than it reports
    first = far["/bench/tcp/256/latency"][0]
    assert first == Recorded(EPOCH + 1000, EPOCH + 1_001_000, 0, stamped_string(256, 1000))
    assert near["/bench/tcp/256/latency"][1].number == 2
    assert read(tmp_path / "near.mcap")[0].message.data == f"{1000:020d}{'x' * 235}"
    assert report.notes == []


def test_run_that_is_best_and_for_latency_is_recorded_once(tmp_path: Path) -> None:
    # The time is up before the search has found a rate that the link carries.
    recording, report, link = simulated(tmp_path, 100_000.0)
    measure(report, link, replace(PLAN, most=0.0))
    recording.write(lambda _: None)
    (point,) = report.points
    assert point.best is not None
    assert point.best.wire is not None
    assert point.best.topic == point.gentle.topic
    (messages,) = recorded(tmp_path / "near.mcap").values()
    assert len(messages) == point.gentle.sent
    assert report.notes == []


def test_run_that_has_no_room_is_left_out_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, report, link = simulated(tmp_path)
    MOST_BYTES.set(monkeypatch, 1_000_000)
    measure(report, link)
    recording.write(lambda _: None)
    runs = [run for point in report.points for run in point.runs]
    inside = [run for run in runs if run.topic]
    assert 0 < len(inside) < len(runs)
    assert sum(run.size * run.sent for run in inside) <= 1_000_000
    largest_inside = max(run.size * run.sent for run in inside)
    assert all(run.topic or run.size * run.sent >= largest_inside for run in runs)
    assert recorded(tmp_path / "near.mcap").keys() == {run.topic for run in inside}
    (note,) = report.notes
    outside = len(runs) - len(inside)
    assert says(note, RecordingText.INCOMPLETE, count=outside, runs=len(runs), gigabytes=0.001)


def test_recording_with_nothing_in_it_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, report, link = simulated(tmp_path)
    MOST_BYTES.set(monkeypatch, 1)
    measure(report, link)
    recording.write(lambda _: None)
    assert report.recordings == []
    assert not list(tmp_path.glob("*.mcap"))


def test_run_that_was_not_kept_is_noted(tmp_path: Path) -> None:
    recording, report, link = simulated(tmp_path)
    measure(report, link)
    point = report.points[0]
    report.points[0] = replace(point, gentle=replace(point.gentle, topic=""))
    recording.write(lambda _: None)
    (note,) = report.notes
    assert says(note, RecordingText.NOT_KEPT, count=1)


def test_second_run_of_same_rate_is_another_topic(tmp_path: Path) -> None:
    recording, _, _ = simulated(tmp_path)
    kept = [recording.keep("/bench/tcp/search", 5) for _ in range(2)]
    assert [each.topic for each in kept] == ["/bench/tcp/search", "/bench/tcp/search_2"]
    assert len({path for each in kept for path in (each.near, each.far)}) == 4


def test_where_one_file_cannot_be_written_there_is_none(tmp_path: Path) -> None:
    recording, report, link = simulated(tmp_path)
    measure(report, link)
    (tmp_path / "far.mcap").mkdir()
    with pytest.raises(OSError):
        recording.write(lambda _: None)
    assert not (tmp_path / "near.mcap").exists()
    assert report.recordings == []
    assert not any(run.topic for point in report.points for run in point.runs)


# --- what the ends keep


def test_what_arrives_altered_is_kept_as_it_is(tmp_path: Path) -> None:
    good, later = stamped_string(256, 50), 99_999_999_999_999_999_999
    altered = [good[:-2] + b"y\0", good + b"\0\0\0\0", serialize_string(b"x" * 255), stamped_string(256, later)]
    kept = KeptMessages(256)
    for made, content in ((50, good), (50, altered[0]), (50, altered[1]), (0, altered[2]), (later, altered[3])):
        kept.add(made, 70, content)
    assert kept.write(tmp_path / "kept", 5)
    assert list(read_kept(tmp_path / "kept")) == [
        KeptMessage(50, 70, good),
        KeptMessage(50, 70, altered[0]),
        KeptMessage(50, 70, altered[1]),
        KeptMessage(0, 70, altered[2]),
        KeptMessage(70, 70, altered[3]),
    ]


def test_message_after_the_report_is_not_in_the_file(tmp_path: Path) -> None:
    kept = KeptMessages(256)
    for made in range(3):
        kept.add(made, made, stamped_string(256, made) if made < 2 else b"altered")
    assert kept.write(tmp_path / "kept", 2)
    assert [each.made for each in read_kept(tmp_path / "kept")] == [0, 1]


def test_beyond_its_limits_no_half_run_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    MOST_MESSAGES.set(monkeypatch, 3)
    MOST_FOREIGN.set(monkeypatch, 10)
    many, large = KeptMessages(256), KeptMessages(256)
    for made in range(4):
        many.add(made, made, stamped_string(256, made))
        large.add(made, made, b"altered" if made < 2 else stamped_string(256, made))
    assert not many.write(tmp_path / "kept", 4)
    assert not large.write(tmp_path / "kept", 2)
    assert not (tmp_path / "kept").exists()
    assert many.write(tmp_path / "kept", 3)


def test_only_counted_messages_are_kept(tmp_path: Path) -> None:
    arrivals, late = MeasuredArrivals(), stamped_string(100)
    arrivals.reset(KeptMessages(100))
    arrivals.add(late)
    message = stamped_string(100)
    arrivals.add(message)
    assert arrivals.kept is not None
    assert arrivals.kept.write(tmp_path / "kept", arrivals.count)
    (only,) = read_kept(tmp_path / "kept")
    assert (only.made, only.content) == (made_at(message), message)
    assert only.time - only.made == arrivals.latencies[0]


# --- the command


def interrupted_place(*arguments: Any) -> SimulatedPlace:
    """A machine that is measured over TCP, and interrupted then."""

    class Interrupted(RecordedLink):
        def send(self, *_: Any) -> Run:
            raise KeyboardInterrupt

    recording = arguments[2]
    return SimulatedPlace({"tcp": RecordedLink(recording, "tcp"), "udp": Interrupted(recording, "udp")})


def test_after_ctrl_c_recordings_have_what_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy", reason="needs ROS")
    LOOPBACK.set(monkeypatch, interrupted_place)
    ran = Ran(capsys, "bench", "--quick", "--sizes", "256", "--json", "--record", str(tmp_path / "x.mcap"))
    assert ran.code == 130
    report = msgspec.json.decode(ran.out, type=BenchReport)
    assert report.ended == "interrupted"
    assert recorded(report.recordings[1]).keys() == runs_of(report).keys()


@pytest.mark.parametrize(
    ("error", "code"), [(FileExistsError(17, "File exists"), 1), (KeyboardInterrupt(), 130), (SystemExit(), 143)]
)
def test_without_recordings_results_are_printed(
    error: BaseException,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("rclpy", reason="needs ROS")

    def write(*_: object) -> None:
        raise error

    LOOPBACK.set(monkeypatch, lambda *arguments: SimulatedPlace({"tcp": RecordedLink(arguments[2], "tcp")}))
    WRITE_RECORDINGS.set(monkeypatch, write)
    ran = Ran(capsys, "bench", "--quick", "--sizes", "256", "--json", "--record", str(tmp_path / "x.mcap"))
    assert ran.code == code
    report = msgspec.json.decode(ran.out, type=BenchReport)
    assert (len(report.points), len(report.notes), report.recordings) == (1, 1, [])


@pytest.mark.parametrize(
    "words",
    [
        ("--record", "no-such-folder/x.mcap"),
        ("--record", "x.bag"),
        ("--record", "there.mcap"),
        ("--record", "away.mcap"),
        ("nobody-here", "--record", "x.mcap"),
    ],
)
def test_recording_that_cannot_be_is_refused_at_once(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there-near.mcap").touch()
    (tmp_path / "away-far.mcap").touch()
    BENCH_MEASURE.set(monkeypatch, lambda *_: OK)
    assert Ran(capsys, "bench", *words).code == 2


def test_what_recordings_need_is_named_before_measuring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy", reason="needs ROS")
    BENCH_MEASURE.set(monkeypatch, lambda *_: OK)
    surroundings.hide_modules(monkeypatch, "mcap")
    ran = Ran(capsys, "bench", "--json", "--record", str(tmp_path / "x.mcap"))
    assert ran.code == 1
    assert "pip install 'rsb-console[record]'" in json.loads(ran.out)["error"]

"""The command: its arguments, a short run on this machine, and one over the link of a bridge that runs."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import msgspec
import pytest
from tests.command.printing_helpers import EVIL
from tests.support.commands import rsb_console
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.control.bridges import serve
from rsb_bridge.model.text import is_clean
from rsb_console.command.target import BridgeChoice
from rsb_extras.bench import BenchmarkLimits
from rsb_extras.bench.bench_arguments import domains, sizes, topics, transports
from rsb_extras.bench.bench_command import Progress
from rsb_extras.bench.results import BenchReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_extras.bench.tests.link_helpers import Pair

from rsb_extras.bench.tests.command_helpers import TINY, WITHIN, bench
from rsb_extras.bench.tests.link_helpers import LEAVE, linked, pair

__all__ = ["linked", "pair"]


@pytest.mark.parametrize(
    ("parse", "text", "parsed"),
    [
        (sizes, "256,10k,1M", (256, 10_000, 1_000_000)),
        (sizes, "1.5kB", (1_500,)),
        (sizes, "64,64", (64,)),
        (transports, "udp,TCP", ("udp", "tcp")),
        (topics, "1,500", (1, 500)),
        (topics, "0", ()),
        (domains, "3,101", (3, 101)),
    ],
)
def test_values(parse: Callable[[str], Any], text: str, parsed: object) -> None:
    assert parse(text) == parsed


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        *((sizes, text) for text in ("", "x", "63", "17M", "10q", "k", "nan", "1e999", "-5")),
        *((transports, text) for text in ("", "pigeon", "tcp,,udp")),
        *((topics, text) for text in ("", "501", "0,1", "-1", "x")),
        *((domains, text) for text in ("1", "1,1", "1,102", "a,b", "1,2,3")),
    ],
)
def test_values_that_are_refused(parse: Callable[[str], Any], text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        parse(text)


@pytest.mark.parametrize(
    "wrong",
    [
        "--transports bluetooth",
        "--direction both",
        "--plot /no/such/x.svg",
        "--plot /tmp",
        "--plot x.png",
        "--link robot1",
        "nobody-here --topics 5",
        "nobody-here --domains 3,4",
    ],
)
def test_what_makes_no_sense_is_refused_at_once(wrong: str) -> None:
    assert rsb_console("bench", *wrong.split()).returncode == 2


def test_a_bridge_that_does_not_run_is_named() -> None:
    refused = rsb_console("bench", "nobody-here")
    assert refused.returncode == 3
    assert says(refused.stderr, BridgeChoice.NONE_RUNS) or says(
        refused.stderr, BridgeChoice.UNKNOWN, name="nobody-here"
    )


@pytest.mark.parametrize("transport", ["tcp", "zenoh"])
def test_a_short_run_on_this_machine(transport: str, tmp_path: Path, spare_domains: int) -> None:
    near = spare_domains
    plot = tmp_path / "plot.svg"
    code, output, errors = bench(
        *TINY, "--quick", "--transports", transport, "--domains", f"{near},{near + 1}", "--plot", str(plot)
    )
    assert code == 0, output or errors
    report = msgspec.json.decode(output, type=BenchReport)
    (point,) = report.points
    assert (point.transport, point.size) == (transport, 2500)
    assert point.gentle.lossless
    assert 0 < point.gentle.p50 <= point.gentle.p99
    assert point.base is not None
    sending, receiving = report.sides[transport]
    assert sending.memory > 10
    assert receiving.listening is not None
    assert receiving.first is not None
    assert 0 < receiving.listening <= receiving.first
    ET.fromstring(plot.read_text())
    assert not list(tmp_path.glob("rsb-bench-*"))


@pytest.fixture
def socket(pair: Callable[..., Pair], tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Serves the client of a pair; gives its control socket."""
    servers = []

    def make(**leave: Any) -> str:
        both = pair(**leave)
        path = tmp_path / "c.sock"
        servers.append(serve(both.client, both.client.session, file=None, control=path))
        return str(path)

    yield make
    for server in servers:
        server.close()


def over_link(socket: str, *options: str, seconds: str = "3") -> tuple[int, BenchReport]:
    code, output, errors = bench("--control", socket, *TINY, "--quick", "--seconds", seconds, *options)
    assert not errors or json.loads(output)["notes"]
    return code, msgspec.json.decode(output, type=BenchReport)


def test_over_the_link_of_a_running_bridge(socket: Callable[..., str]) -> None:
    # A machine that starves it has lost some by the first try: then there are more, and each transport has its share.
    code, report = over_link(socket(to_client=BenchmarkLimits(600.0, LEAVE.max_rate, 1000.0)), seconds="12")
    assert code == 0
    assert {point.transport for point in report.points} == {"tcp", "udp"}
    for point in report.points:
        assert point.base is None
        assert point.best is not None
        assert point.best.rate <= LEAVE.max_rate
        assert point.best.wire_per_byte is not None
        assert 1.0 < point.best.wire_per_byte < 1.2


def test_both_directions_of_link_are_measured_and_drawn(socket: Callable[..., str], tmp_path: Path) -> None:
    plot = tmp_path / "link.svg"
    options = ("--link", "robot1", "--direction", "both", "--transports", "tcp", "--plot", str(plot))
    leave = msgspec.structs.replace(LEAVE, seconds=600.0, megabytes=1000.0)
    code, report = over_link(socket(to_client=leave), *options, seconds="12")
    assert code == 0
    assert {point.direction for point in report.points} == {"transmit", "receive"}
    ET.fromstring(plot.read_text())


def test_without_the_peer_s_leave_nothing_is_measured(socket: Callable[..., str]) -> None:
    code, report = over_link(socket())
    assert code == 1
    assert report.ended == "stopped"
    assert report.points == []
    assert "measure this link" in report.notes[0]


def test_a_line_of_progress_is_clean() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    Progress(stream).show(f"a {EVIL}")
    assert is_clean(stream.getvalue().removeprefix("\r\x1b[K"))


def test_ctrl_c_prints_results_and_leaves_no_process(spare_domains: int) -> None:
    near = spare_domains
    command = [sys.executable, "-m", "rsb_console", "bench", "--json", "--domains", f"{near},{near + 1}"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with _killed_at_last(subprocess.Popen(command, **pipes)) as running:
        children = _children_of(running)
        os.kill(running.pid, 2)
        output, _ = running.communicate(timeout=WITHIN)
    assert running.returncode == 130
    assert msgspec.json.decode(output, type=BenchReport).ended == "interrupted"
    eventually(lambda: not any(_lives(child) for child in children), WITHIN)


@contextlib.contextmanager
def _killed_at_last(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    with process:
        try:
            yield process
        finally:
            process.kill()


def _children_of(parent: subprocess.Popen[str]) -> list[int]:
    """Waits until it has some."""

    def found() -> list[int]:
        return [int(pid) for pid in Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()]

    eventually(lambda: len(found()) >= 2, WITHIN)
    return found()


def _lives(pid: int) -> bool:
    """Whether a process runs; one that only nobody has waited for yet does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"

"""The command ``bench``: measures this machine, or the link of a running bridge."""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Self, TextIO, get_args

from rsb_bridge.config.files import is_there, write_whole
from rsb_bridge.feature_api import (
    EngineError,
    SessionError,
    State,
    attach,
    file_stem,
    load,
    one_line,
    running_bridges,
    why_not_written,
)
from rsb_bridge.model.transports import Protocol, named
from rsb_console.command.shell import TERMINATED
from rsb_console.command.target import check_link
from rsb_console.feature_console import (
    FAILURE,
    INTERRUPTED,
    OK,
    USAGE,
    UsageError,
    attached,
    failed,
    print_error,
    print_line,
    print_lines,
)
from rsb_extras.bench.bench_recording import BenchRecording
from rsb_extras.bench.loopback import TRANSPORTS, Loopback, machine, ros_problem
from rsb_extras.bench.presentation import USUAL, as_svg, in_terminal, in_words, judge, lines_of
from rsb_extras.bench.results import BenchError, BenchReport, as_json
from rsb_extras.bench.suite import FULL, QUICK, OverLink, Plan, Suite, loads_of, loads_of_all, ways_of
from rsb_extras.demo.processes import ProcessError
from rsb_extras.recording.mcap_file import McapText

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence
    from types import TracebackType

    from rsb_bridge.feature_api import LinkSnapshot, RemoteEngine, Snapshot
    from rsb_extras.bench.results import BenchPlace, Load

_ERASE = "\r\x1b[K"
_BOTH = ("transmit", "receive")
_DOMAINS = 92, 93  # a demo may take them (82 to 101): --domains gives others
_LINKED_WITHIN = 3.0  # s. A round figure: with a link that takes longer, the command has to be given again
_LOOK_EVERY = 0.1  # s. A round figure, far below `_LINKED_WITHIN`


class Progress:
    """The progress of a benchmark, written to terminals only.

    Args:
        stream: standard error, if None.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        # `CleanErrors` would escape the codes of `_ERASE`; `show` cleans its text itself.
        errors: Any = sys.stderr
        self._stream: TextIO = stream or getattr(errors, "raw", errors)
        self._shows = self._stream.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._shows:
            self._write(_ERASE)

    def show(self, text: str) -> None:
        """Show a line in the place of the one before."""
        if self._shows:
            # One cell stays free: some terminals wrap a full line, of which `_ERASE` erases the second half only.
            self._write(f"{_ERASE}{one_line(text)[: shutil.get_terminal_size().columns - 1]}")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal has gone
            self._stream.write(text)
            self._stream.flush()


def bench(arguments: Namespace) -> int:
    """Measure and print the results. Return the exit code."""
    here = arguments.bridge is None and arguments.control is None and arguments.way is None
    problem = (
        _misplaced(arguments, here=here)
        or _file_problem(arguments.plot, ".svg")
        or _file_problem(arguments.record, ".mcap")
        or _overwritten(arguments.record)
    )
    if problem:
        return failed(arguments, problem, USAGE)
    try:
        return _on_this_machine(arguments) if here else _over_link(arguments)
    except ProcessError as error:
        return failed(arguments, str(error), FAILURE)


def _file_problem(path: Path | None, suffix: str) -> str:
    """Return the reason why no such file can be written there, or an empty string."""
    if path is None:
        return ""
    if path.suffix.lower() != suffix:
        return f"{path}: choose a name that ends in {suffix}"
    try:
        if path.is_dir():
            return f"{path}: this is a folder"
        return "" if path.parent.is_dir() else f"{path}: there is no such folder"
    except OSError as error:  # its name is too long, for example
        return f"{path}: {error.strerror}"


def _overwritten(path: Path | None) -> str:
    """Return the problem of a recording that is there already, or an empty string."""
    there = [each for each in _recordings(path) if is_there(each)] if path else []
    return f"{there[0]}: there is such a file already; choose another name" if there else ""


def _recordings(path: Path) -> tuple[Path, Path]:
    """Return the paths of the talker's and the listener's recording."""
    near, far = (path.with_name(f"{path.stem}-{side}{path.suffix}") for side in ("near", "far"))
    return near, far


def _misplaced(arguments: Namespace, *, here: bool) -> str:
    """Return the problem of an argument that does not fit this kind of benchmark, or an empty string."""
    if here and arguments.link:
        return "--link needs the name of the bridge whose link to measure, for example: rsb-console bench control"
    of_machine = [f"--{name}" for name in ("topics", "domains", "record") if getattr(arguments, name) is not None]
    if not here and of_machine:
        return f"{of_machine[0]} is for a benchmark on one machine: leave it out, or the name of the bridge"
    return ""


def _on_this_machine(arguments: Namespace) -> int:
    if problem := ros_problem():
        raise BenchError(problem)
    near, far = arguments.domains or _DOMAINS
    if others := [name for name in arguments.transports if name not in TRANSPORTS]:
        message = f"{others[0]} can be measured only over a link: name that link's session"
        return failed(arguments, message, USAGE)
    transports = arguments.transports or tuple(name for name in TRANSPORTS if not _lack(name))
    for name in transports:
        if lack := _lack(name):
            raise BenchError(f"{name}: {lack}")
    if arguments.direction != "transmit":
        return failed(arguments, "on one machine both directions are the same: leave --direction out", USAGE)
    if arguments.record is not None and find_spec("mcap") is None:
        raise BenchError(McapText.NOT_INSTALLED())
    loads = _loads_of_running_bridges()
    report = BenchReport("This machine, two bridges over loopback", machine())
    with _recording(arguments.record, report) as recording:
        code = _measure(Loopback(transports, (near, far), recording), report, _plan(arguments))
        if recording is not None:
            code = _write(recording, arguments.record, report, code)
    return _finish(report, loads or USUAL, "this machine", arguments, code, together=bool(loads))


def _lack(transport: str) -> str:
    """Return what this installation lacks for a transport, or an empty string."""
    return named(transport).missing() if transport in get_args(Protocol) else "its feature is not installed"


@contextlib.contextmanager
def _recording(path: Path | None, report: BenchReport) -> Iterator[BenchRecording | None]:
    """Yield the recording of the report's runs, or None without a path."""
    if path is None:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="rsb-bench-") as folder:
        yield BenchRecording(*_recordings(path), Path(folder), report, time.time_ns() - time.monotonic_ns())


def _write(recording: BenchRecording, path: Path, report: BenchReport, code: int) -> int:
    """Write the recordings; without them, the results are printed all the same. Return the exit code."""
    with Progress() as progress:
        try:
            recording.write(progress.show)
        except OSError as error:
            report.notes.append(f"{path}: the recordings are not written: {why_not_written(error, path)}")
            return FAILURE
        except (KeyboardInterrupt, SystemExit) as error:
            report.notes.append(f"{path}: the recordings are not written: interrupted")
            return INTERRUPTED if isinstance(error, KeyboardInterrupt) else TERMINATED
    return code


def _over_link(arguments: Namespace) -> int:
    _name_of_file(arguments)
    with attached(arguments) as engine:
        link = _linked(engine, arguments.link)
        loads = loads_of(engine.snapshot(), link.name)
        directions = _BOTH if arguments.direction == "both" else (arguments.direction,)
        place = OverLink(engine, link.name, ways_of(engine.session, arguments.transports, directions))
        report = BenchReport(f"The link of {engine.name} with {link.peer or link.name}", f"{machine()} on this side")
        try:
            # Over a link, no topics are opened: left in the plan, they would make the report say that the time was up.
            code = _measure(place, report, replace(_plan(arguments), many=()))
        finally:
            place.close()
    return _finish(report, loads, "this link", arguments, code, together=True)


def _name_of_file(arguments: Namespace) -> None:
    """Replace a session file among the arguments by the name of its bridge.

    Raises:
        UsageError: it is no session file.
    """
    path = None if arguments.bridge is None else Path(arguments.bridge)
    if path is None or not (path.suffix in (".yaml", ".yml") and path.is_file()):
        return
    try:
        arguments.bridge = file_stem(load(path).name, 1)
    except SessionError as error:
        raise UsageError(str(error)) from None


def _linked(engine: RemoteEngine, name: str) -> LinkSnapshot:
    """Return the link to measure; wait for one that is about to come up.

    Raises:
        UsageError: there are several, or it does not come up.
    """
    deadline = time.monotonic() + _LINKED_WITHIN
    while True:
        links = engine.snapshot().links
        # A server that has just started has no link yet: until then the name may be right.
        if links:
            check_link(engine, name)
            link = _chosen_link(links, name)
            if link.state is State.OK:
                return link
        if time.monotonic() > deadline:
            why = f"{link.name} is not linked: {link.reason}" if links else "the bridge has no link yet"
            raise UsageError(why)
        time.sleep(_LOOK_EVERY)


def _chosen_link(links: Sequence[LinkSnapshot], name: str) -> LinkSnapshot:
    """Return the link to measure.

    Raises:
        UsageError: there are several.
    """
    found = [link for link in links if name in ("", link.name)]
    if len(found) != 1:
        raise UsageError(f"several clients; choose one: --link {' or --link '.join(link.name for link in links)}")
    return found[0]


def _loads_of_running_bridges() -> list[Load]:
    """Return the topics of the bridges that run here, to judge."""
    snapshots: list[Snapshot] = []
    for bridge in running_bridges():
        with contextlib.suppress(EngineError, OSError), attach(bridge.path, read_only=True) as engine:
            snapshots.append(engine.snapshot())
    return loads_of_all(snapshots)


def _measure(place: BenchPlace, report: BenchReport, plan: Plan) -> int:
    """Fill the report and return the exit code; after an interrupt, keep the results so far."""
    with Progress() as progress:
        try:
            Suite(place, plan, report, time.monotonic, progress.show).run()
        except KeyboardInterrupt:
            report.ended = "interrupted"
            return INTERRUPTED
        except SystemExit:  # SIGTERM
            report.ended = "interrupted"
            return TERMINATED
    return OK if report.points else FAILURE


def _plan(arguments: Namespace) -> Plan:
    # A short --seconds shortens each run, too, or the first one (3 s) would outlast it. A 20th is a round figure.
    plan = QUICK if arguments.quick else FULL
    wanted = {
        "sizes": tuple(sorted(arguments.sizes)) if arguments.sizes else None,
        "most": arguments.seconds,
        "run": min(plan.run, arguments.seconds / 20) if arguments.seconds else None,
        "gentle_run": min(plan.gentle_run, arguments.seconds / 20) if arguments.seconds else None,
        "idle": min(plan.idle, arguments.seconds / 20) if arguments.seconds else None,
        "many": arguments.topics,
    }
    return replace(plan, **{name: value for name, value in wanted.items() if value is not None})


def _finish(
    report: BenchReport, loads: Sequence[Load], over: str, arguments: Namespace, code: int, *, together: bool
) -> int:
    """Judge, print and draw. Return the exit code."""
    # JSON has the notes among its fields, and an interrupt has its own ending below.
    if not (report.points or arguments.json or report.ended == "interrupted"):
        return failed(arguments, "; ".join(report.notes) or "nothing could be measured", code)
    report.judged = judge(loads, report.points)
    if report.points:
        report.verdict = in_words(report.judged, over, together=together)
    if arguments.json:
        print_line(as_json(report))
    else:
        for line in lines_of(report) if report.points else ():
            print_line(line)
        width = shutil.get_terminal_size((100, 24)).columns if sys.stdout.isatty() else 100
        drawn = in_terminal(report.points, width)
        for line in ["", *drawn, ""] if drawn else [""] if report.points else []:
            print_line(line)
        for line in report.verdict:
            print_lines(fill(line, width, break_long_words=False, break_on_hyphens=False))
        if report.recordings:
            print_line(f"Recordings: {', '.join(report.recordings)}")
        for line in (*report.notes, *_ending(report)):
            print_error(line)
    if arguments.plot is not None:
        try:
            write_whole(arguments.plot, as_svg(report.points, report.over))
        except OSError as error:
            print_error(f"{arguments.plot}: cannot be written: {why_not_written(error, arguments.plot)}")
            return FAILURE
    return code


def _ending(report: BenchReport) -> list[str]:
    if report.ended == "interrupted":
        return ["interrupted: these are the figures so far" if report.points else "interrupted: nothing was measured"]
    if report.ended == "time":
        return ["the time ended before everything was measured: raise --seconds"]
    return []

"""The price of a message beside quiet topics, for `bench.quiet table`.

Each bed has two linked sides of ours, a talker and a listener of one topic, and quiet topics beside it: a publisher and
a subscription each, and no message. All beds stand at once, each in two ROS domains of its own, and take turns.
``--other FOLDER`` adds the same beds of another checkout, in the same turns; ``--peer`` adds them with
zenoh-bridge-ros2dds; ``--many 100`` adds a bed of so many topics at 10 Hz of 500 B each: both sides' CPU by thread, and
in ratio to the first bed of the same round. ``--express`` adds a topic that is `express`, at 20 Hz, to these:
its latency is measured after the CPU, and then that of a topic which no bridge takes, in the talkers' domain.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed, zenoh_bridge
from bench.figures import Figures, in_turn
from bench.quiet_side import EXPRESS

from rsb_bridge.cdr.known_types import STRING, STRING_HASH, stamped_string
from rsb_bridge.config.keys import write_key
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.bench import loopback

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

QUIET = (0, 50, 200, 500)
RATES = ((100, 2.0), (1_000, 1.0), (5_000, 1.0))
"""Hz, and s of a burst."""
_SIZE = 2_500
_DOMAINS = range(66, 100, 2)
_IDLE_SECONDS = 10.0
_MANY_RATE, _MANY_SIZE, _MANY_SECONDS = 10.0, 500, 10.0
_MANY_SETTLES = 15.0
"""s of messages before these count: a robot's topics flow for hours, and a route is looked at more often until it has
settled after a pause (`rsb_bridge.route.idling.SETTLES`)."""
_USER_PROFILES = "RMW_FASTRTPS_USE_QOS_FROM_XML"
_EXPRESS_RATE, _EXPRESS_SIZE = 20.0, 60
_EXPRESS, _DIRECT = "the express topic", "a topic that no bridge takes"
_SHOWN = 0.3  # µs a message of a thread that is shown
_SLEPT = re.compile(r"^voluntary_ctxt_switches:\s*(\d+)", re.MULTILINE)
_FEW, _KEPT_UP = 0.99, 0.9
"""Shares of the messages that have to come, and of the rate that has to be reached, for a burst's CPU to count."""


class Plan(NamedTuple):
    """A bed to be made.

    Attributes:
        busy: topics with messages.
        quiet: topics without.
        folder: a checkout of the bridge, or an empty string for this one.
        peer: whether zenoh-bridge-ros2dds takes the bridge's place.
        express: whether a bed of many has a topic that is `express`, too.
    """

    busy: int = 1
    quiet: int = 0
    folder: str = ""
    peer: bool = False
    express: bool = False

    @property
    def name(self) -> str:
        topics = f"{self.busy} × {_MANY_RATE:g} Hz" if self.busy > 1 else f"{self.quiet} quiet"
        if self.peer:
            return f"{topics}, {zenoh_bridge.NAME}"
        return f"{topics}, other" if self.folder else topics


@dataclass(slots=True)
class _ManyBed(bed.Bed):
    """A bed of many topics.

    Attributes:
        beside: a talker and a listener of a topic that is `express`, in the same domains, and of one that no bridge
            takes, in the talker's; by their names for the reader.
    """

    beside: dict[str, bed.Bed] = field(default_factory=dict)


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.quiet table")
    parser.add_argument("rounds", nargs="?", type=int, default=3)
    parser.add_argument("--quiet", default=",".join(map(str, QUIET)), help="numbers of quiet topics")
    parser.add_argument("--many", type=int, default=0)
    parser.add_argument("--other", default="")
    parser.add_argument("--peer", action="store_true", help="the same beds with zenoh-bridge-ros2dds")
    parser.add_argument("--express", action="store_true", help="add a topic that is express to the many")
    parser.add_argument("--settles", type=float, default=0.0, help="s after all is open: routes rest after 140")
    options = parser.parse_args(arguments)
    bridges = [Plan()]
    if options.other:
        bridges.append(Plan(folder=options.other))
    if options.peer:
        zenoh_bridge.check_built()
        bridges.append(Plan(peer=True))
    plans = [bridge._replace(quiet=int(count)) for count in options.quiet.split(",") for bridge in bridges]
    plans += [bridge._replace(busy=options.many, express=options.express) for bridge in bridges if options.many]
    figures = Figures()
    with contextlib.ExitStack() as stack:
        beds = {
            plan: stack.enter_context(_standing(plan, domain)) for plan, domain in zip(plans, _DOMAINS, strict=False)
        }
        time.sleep(options.settles)
        _measure_idle(figures, beds)
        for number in range(options.rounds):
            for turn, (rate, seconds) in enumerate(RATES):
                for name in in_turn([plan.name for plan in plans if plan.busy == 1], number + turn):
                    plan = next(each for each in plans if each.name == name)
                    _measure(figures, number, plan, beds[plan], rate, seconds)
            many = {plan.name: plan for plan in plans if plan.busy > 1}
            for name in in_turn([*many], number) if many else ():
                _measure_many(figures, number, many[name], beds[many[name]])
        for plan, each in beds.items():
            for at, process in enumerate(each.between):
                figures.add(0, plan.name, f"memory {at}", process.memory())
    _print(figures, plans)


@contextlib.contextmanager
def _standing(plan: Plan, near: int) -> Iterator[bed.Bed]:
    far = near + 1
    busy = [bed.TOPIC] if plan.busy == 1 else [f"{bed.TOPIC}_{number}" for number in range(plan.busy)]
    quiet = [f"/quiet/topic_{number}" for number in range(plan.quiet)]
    with contextlib.ExitStack() as stack:
        if plan.busy == 1:
            made = stack.enter_context(loopback.ends(near, far))
        else:
            talker = stack.enter_context(bed.Process("-m", "bench.quiet", "talk", str(near), *busy))
            listener = stack.enter_context(bed.Process("-m", loopback.TRAFFIC, "listen", str(far), *busy))
            made = _ManyBed(talker, listener)
            if plan.express:
                made.beside[_EXPRESS] = stack.enter_context(loopback.ends(near, far))
                made.beside[_DIRECT] = stack.enter_context(loopback.ends(near, near, [_EXPRESS_SIZE]))
        if quiet:
            for part, domain in (("publish", near), ("subscribe", far)):
                process = stack.enter_context(bed.Process("-m", "bench.quiet", part, str(domain), *quiet))
                process.line()
        names = [*busy, *quiet, *[bed.TOPIC + EXPRESS] * plan.express]
        between = zenoh_bridge.between(near, far) if plan.peer else _sides(plan.folder, near, far, names)
        made.between += stack.enter_context(between)
        yield bed.ready(made) if plan.busy == 1 else made


@contextlib.contextmanager
def _sides(checkout: str, near: int, far: int, topics: Sequence[str]) -> Iterator[list[bed.Process]]:
    """Start two sides of ours, and yield the sending and the receiving one once all topics are open."""
    environ = {}
    if checkout:
        parts = [*(str(Path(checkout) / part) for part in ("bridge", "console", "extras")), str(bed.ROOT)]
        environ["PYTHONPATH"] = os.pathsep.join(parts)
    with contextlib.ExitStack() as stack:
        folder, port = stack.enter_context(tempfile.TemporaryDirectory()), str(bed.free_port())
        write_key(Path(folder) / "bench.key")
        sides: list[bed.Process] = []
        for role, domain, names in (("server", far, ()), ("client", near, topics)):
            side = ("-m", "bench.quiet_side", role, folder, port, str(domain), *names)
            sides.insert(0, stack.enter_context(bed.Process(*side, environ=environ)))
            sides[0].line()
        sides[0].ask("open")
        yield sides


def _measure_idle(figures: Figures, beds: dict[Plan, bed.Bed]) -> None:
    before, began = {plan: [each.cpu() for each in made.between] for plan, made in beds.items()}, time.monotonic()
    time.sleep(_IDLE_SECONDS)
    percent = 100 / (time.monotonic() - began)
    for plan, made in beds.items():
        for at, process in enumerate(made.between):
            figures.add(0, plan.name, f"idle {at}", (process.cpu() - before[plan][at]) * percent)


def _measure(figures: Figures, number: int, plan: Plan, made: bed.Bed, rate: int, seconds: float) -> None:
    made.send(rate, 0.2, _SIZE)  # the beds before it have emptied the caches
    with_turns = [] if plan.peer else made.between
    for side in with_turns:
        side.ask("turn")
    run = made.send(rate, seconds, _SIZE)
    figures.add(number, plan.name, f"{rate} lost", 100 * (run.sent - run.received) / run.sent)
    figures.add(number, plan.name, f"{rate} p99", run.p99)
    if with_turns:
        figures.add(number, plan.name, f"{rate} turn", max(side.ask("turn")["longest"] for side in with_turns))
    if run.rate >= _KEPT_UP * rate and run.received >= _FEW * run.sent:
        figures.add(number, plan.name, f"{rate} CPU", sum(run.sides) / run.sent * 1e6)


def _measure_many(figures: Figures, number: int, plan: Plan, made: bed.Bed) -> None:
    made.talker.ask(f"talk {_MANY_SETTLES}")
    made.listener.ask("reset")
    before, stolen = [(side.cpu(), _threads(side)) for side in made.between], _stolen()
    seconds = made.talker.ask(f"talk {_MANY_SECONDS}")["seconds"]
    figures.add(number, plan.name, "many stolen", 100 * (_stolen() - stolen) / seconds)
    messages, both = seconds * plan.busy * _MANY_RATE, 0.0
    for at, (side, (cpu, threads)) in enumerate(zip(made.between, before, strict=True)):
        used = side.cpu() - cpu
        both += used
        figures.add(number, plan.name, f"many {at}", 100 * used / seconds)
        for name, until in _threads(side).items():
            since = threads.get(name, _Thread())
            figures.add(number, plan.name, f"many CPU {at} {name}", (until.cpu - since.cpu) / messages * 1e6)
            figures.add(number, plan.name, f"many sleeps {at} {name}", (until.sleeps - since.sleeps) / messages)
    report = made.listener.ask("report")
    # A machine without time for it loses messages, and those that it does not lose it takes many at a time.
    if report["count"] >= _FEW * messages:
        figures.add(number, plan.name, "many both", both)
    for name in ("p50", "p99"):
        figures.add(number, plan.name, f"many {name}", report[name] / 1e6)
    if isinstance(made, _ManyBed):
        for topic, each in made.beside.items():
            _measure_beside(figures, number, plan, made, topic, each)


def _measure_beside(figures: Figures, number: int, plan: Plan, many: bed.Bed, topic: str, made: bed.Bed) -> None:
    with ThreadPoolExecutor(1) as beside:
        talks = beside.submit(many.talker.ask, f"talk {_MANY_SECONDS}")
        run = made.send(_EXPRESS_RATE, 0.9 * _MANY_SECONDS, _EXPRESS_SIZE)
        talks.result()
    for name, found in (("p50", run.p50), ("p99", run.p99), ("lost", 100 * (run.sent - run.received) / run.sent)):
        figures.add(number, plan.name, f"{topic} {name}", found)


class _Thread(NamedTuple):
    """A thread so far, or several of one name: CPU time (s), and how often it has slept.

    A busy machine changes the number of sleeps less than seconds of a clock. It has fewer of them where a thread that
    waits for its turn finds several messages then.
    """

    cpu: float = 0.0
    sleeps: int = 0


def _threads(side: bed.Process) -> dict[str, _Thread]:
    """Return a process's threads by their names without the numbers in them."""
    found: dict[str, _Thread] = {}
    for task in Path(f"/proc/{side.pid}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            name, schedstat, status = ((task / each).read_text("ascii") for each in ("comm", "schedstat", "status"))
            name = name.strip().rstrip("0123456789.-")
            cpu, sleeps = found.get(name, _Thread())
            found[name] = _Thread(cpu + int(schedstat.split()[0]) / 1e9, sleeps + int(_SLEPT.findall(status)[0]))
    return found


def _stolen() -> float:
    """Return the CPU time (s) so far that other guests of the host had while this machine wanted to run."""
    ticks = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[8]
    return int(ticks) / os.sysconf("SC_CLK_TCK")


def _print(figures: Figures, plans: Sequence[Plan]) -> None:
    for plan in plans:
        name = plan.name
        idle, memory = ([figures.spread(name, f"{what} {at}") for at in (0, 1)] for what in ("idle", "memory"))
        print(f"{name}: idle {_pair(idle, '.2f')} % of a core, {_pair(memory, '.0f')} MB")
        if plan.busy > 1:
            _print_many(figures, name, next(each.name for each in plans if each.busy > 1))
            continue
        first = plan._replace(quiet=plans[0].quiet).name
        for rate, _ in RATES:
            ratio = figures.ratio(name, f"{rate} CPU", first)
            print(
                f"  {rate:>5,} Hz: {_cell(figures, name, f'{rate} CPU', ',.0f'):<22} µs a message, "
                f"{'–' if ratio is None else f'{ratio.middle:.2f}':>5} × as beside {plans[0].quiet}, "
                f"p99 {_cell(figures, name, f'{rate} p99')} ms, "
                f"longest turn {_cell(figures, name, f'{rate} turn')} ms, lost {_cell(figures, name, f'{rate} lost')} %"
            )


def _print_many(figures: Figures, name: str, first: str) -> None:
    """Print the figures of a bed of many topics, in ratio to the bed `first`."""
    p50, p99 = (_cell(figures, name, f"many {each}", ".2f") for each in ("p50", "p99"))
    print(f"  {_cell(figures, name, 'many 0')} + {_cell(figures, name, 'many 1')} % of a core, p50 {p50}, p99 {p99} ms")
    if name != first and (ratio := figures.ratio(name, "many both", first)) is not None:
        print(f"  CPU of both sides {ratio.middle:.2f} ({ratio.low:.2f}–{ratio.high:.2f}) × of {first}")
    for topic in (_EXPRESS, _DIRECT):
        if figures.names(name, f"{topic} "):
            p50, p99, lost = (_cell(figures, name, f"{topic} {each}", ".2f") for each in ("p50", "p99", "lost"))
            print(f"  {topic}: p50 {p50}, p99 {p99} ms, lost {lost} %")
    for at, side in enumerate(("sending", "receiving")):
        of_side = f"many CPU {at} "
        used = [(figures.spread(name, of_side + each), each) for each in figures.names(name, of_side)]
        shown = sorted([(cpu.middle, each) for cpu, each in used if cpu and cpu.middle >= _SHOWN], reverse=True)
        threads = [
            f"{each} {cpu:.1f} ({_cell(figures, name, f'many sleeps {at} {each}', '.2f')})" for cpu, each in shown
        ]
        print(f"  {side} side's threads, µs (sleeps) a message: {', '.join(threads)}")
    print(f"  stolen by other guests: {_cell(figures, name, 'many stolen')} % of a core")


def _cell(figures: Figures, name: str, quantity: str, form: str = ".1f") -> str:
    spread = figures.spread(name, quantity)
    return "–" if spread is None else f"{spread.middle:{form}} ({spread.low:{form}}–{spread.high:{form}})"


def _pair(spreads: Sequence[object], form: str) -> str:
    return " + ".join(f"{spread.middle:{form}}" for spread in spreads if spread is not None)  # type: ignore[attr-defined]


def ends(part: str, domain: int, names: Sequence[str]) -> None:
    """Be the publishers, the subscriptions or the talker of many topics, until standard input ends."""
    # As a robot's node: a writer by the bridge's own profiles asks its readers for what they lack ten times a second,
    # which is each message at 10 Hz.
    os.environ.setdefault(_USER_PROFILES, "0")
    node = RosNode(domain, f"bench_{part}")
    node.start()
    specs = [TopicSpec(name, STRING, STRING_HASH, Qos()) for name in names]
    if part == "subscribe":
        held: list[object] = [node.subscribe(spec, lambda _: None, "bench") for spec in specs]
    else:
        publishers = [node.advertise(spec, "bench") for spec in specs]
        held = [*publishers]
    if part != "talk":
        print(f'{{"held": {len(held)}}}', flush=True)
        sys.stdin.read()
        return
    pause = threading.Event()
    for line in sys.stdin:
        seconds, began, sent = float(line.split()[1]), time.monotonic(), 0
        interval = 1 / _MANY_RATE / len(publishers)
        while (passed := time.monotonic() - began) < seconds:
            while sent * interval < passed:
                publishers[sent % len(publishers)].publish(stamped_string(_MANY_SIZE))
                sent += 1
            pause.wait(interval)
        print(f'{{"seconds": {time.monotonic() - began}}}', flush=True)

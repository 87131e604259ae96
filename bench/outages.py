"""Measures what topics and calls lose when the path fails: ``python -m bench.outages`` prints a table a transport.

A robot, a router and a server's machine have network namespaces of their own. Stock rclpy nodes publish, listen and
call on the two ends, a bridge is between them, and one fault a run happens to the path or to a bridge: ours, or with
the transport ``zenoh-bridge`` zenoh-bridge-ros2dds. With ``plain`` nothing is between the nodes: they share a domain,
and find each other by address.

A message counts if it was published from 1 s before the fault until all topics have been steady for 5 s, at least 8 s
after the fault's end. ``a; b`` are the figures to the server's side and to the robot's. *Silence* is the longest
time without a message of a reliable topic of 10 Hz, *back* the time from the end of the cause to the end of that
silence, and *live again* the time from there until a message came that was younger than 0.2 s.
*Latched*: messages that never came, and messages that came again to a node that had them. *Events* are
publishers that came or went in the listeners' domains: of all topics of a rate, and of the latched topics, where each
change brings one; and how often the service came or went in its caller's.
*Calls*: answered of asked; of those under way when the fault began; carried out twice. The second table compares our
bridge's account with these counts.

``--record FOLDER`` writes what recorders in both domains have heard, for ``rsb-console audit``.

It needs root, iproute2, nftables and conntrack, and takes 25 to 45 s a run beyond the outage itself.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from bench import zenoh_bridge
from tests.network.bridging import PORT
from tests.network.hosts import NoHostError
from tests.network.outage_bed import FAR, FAULTS, FLOWS, NEAR, PLAIN, STEADY_BEFORE, TRANSPORTS, OutageBed
from tests.network.outage_counts import (
    AccountCounts,
    CallCounts,
    TopicCounts,
    count_account,
    count_calls,
    count_topic,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from tests.network.hosts import Host
    from tests.network.outage_bed import Fault, Record

_TOOLS = {"ip": "iproute2", "ss": "iproute2", "nft": "nftables", "conntrack": "conntrack"}
_NEVER = "never"
_TRANSPORTS = (*TRANSPORTS, zenoh_bridge.NAME)


class _ZenohBridge:
    """A side of zenoh-bridge-ros2dds on a host."""

    def __init__(self, host: Host, part: str, address: str) -> None:
        self._made = host, part, address
        domain = FAR if part == "listen" else NEAR
        arguments = zenoh_bridge.arguments(domain, part, f"tcp/{address}:{PORT}")
        self._process = host.start(sys.executable, *arguments, stdin=subprocess.PIPE)

    def kill(self) -> None:
        with self._process:
            self._process.kill()

    def again(self) -> _ZenohBridge:
        return _ZenohBridge(*self._made)

    close = kill


@dataclass
class Outcome:
    """The counts of one run.

    Attributes:
        lasted: s from the fault's begin to its end.
        steady: whether all topics came back.
        timelines: when each message to the server's side was published, and when it first came, or None; s from the
            fault's begin, by the kind of topic.
    """

    transport: str
    fault: str
    lasted: float
    steady: bool
    topics: dict[str, TopicCounts]
    calls: CallCounts
    accounts: dict[str, AccountCounts] = field(default_factory=dict)
    timelines: dict[str, list[tuple[float, float | None]]] = field(default_factory=dict)

    def of(self, kind: str) -> list[TopicCounts]:
        """Return the counts of a kind's topics, the one to the server's side first."""
        return [self.topics[each.name] for each in FLOWS if each.kind == kind]

    def account(self, kind: str) -> list[AccountCounts]:
        return [self.accounts[each.name] for each in FLOWS if each.kind == kind]

    @property
    def rated(self) -> list[TopicCounts]:
        return [self.topics[each.name] for each in FLOWS if each.rate]

    def as_json(self) -> dict[str, Any]:
        return {
            **{key: value for key, value in vars(self).items() if key not in {"topics", "calls", "accounts"}},
            "topics": {name: each._asdict() for name, each in self.topics.items()},
            "calls": self.calls._asdict(),
            "accounts": {name: each._asdict() for name, each in self.accounts.items()},
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transports", default="tcp,udp,zenoh", help=", ".join(_TRANSPORTS))
    parser.add_argument("--faults", default=",".join(FAULTS), help=", ".join(FAULTS))
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--before", type=float, default=STEADY_BEFORE, help="s of steady traffic before each fault")
    parser.add_argument("--quick", action="store_true", help="TCP, a cut of 1 s and a reset")
    parser.add_argument("--json", type=Path, help="write all counts to this file")
    parser.add_argument("--record", type=Path, metavar="FOLDER", help="write both recordings of each run there")
    options = parser.parse_args()
    transports = ["tcp"] if options.quick else _known(options.transports, _TRANSPORTS)
    if options.record and options.record.exists():
        raise SystemExit(f"--record {options.record}: it is there already; choose another folder")
    if zenoh_bridge.NAME in transports:
        zenoh_bridge.check_built()
    faults = ["cut-1", "reset"] if options.quick else _known(options.faults, FAULTS)
    for tool, package in _TOOLS.items():
        if os.geteuid() or shutil.which(tool) is None:
            raise SystemExit(f"bench.outages needs root and {tool} (apt install {package})")
    outcomes: list[Outcome] = []
    failures: list[str] = []
    for number in range(options.rounds):
        for transport in transports:
            for fault in faults:
                if not _happens(FAULTS[fault], transport):
                    continue
                words = f"{transport}, {FAULTS[fault].words}, round {number + 1}"
                folder = options.record / f"{transport}-{fault}-{number + 1}" if options.record else None
                print(f"{time.strftime('%H:%M:%S')} {words}", file=sys.stderr, flush=True)
                try:
                    outcomes.append(_measured(transport, fault, options.before, folder))
                except AssertionError as error:  # one run of many; the table lacks it, and the exit code says so
                    failures.append(f"{words}: {error}")
                    print(failures[-1], file=sys.stderr, flush=True)
                if options.json:
                    found = {"runs": [each.as_json() for each in outcomes], "failures": failures}
                    options.json.write_text(json.dumps(found), encoding="utf-8")
    for transport in transports:
        _print(transport, [each for each in outcomes if each.transport == transport])
    if failures:
        raise SystemExit("\n".join(["not measured:", *failures]))


def _happens(fault: Fault, transport: str) -> bool:
    """Whether a fault can happen to a transport: Zenoh's routers choose the way, and no session has two of them."""
    return fault.plain if transport == PLAIN else not (fault.two_ways and transport == "zenoh")


def _known(names: str, allowed: Iterable[str]) -> list[str]:
    chosen = names.split(",")
    if unknown := [each for each in chosen if each not in allowed]:
        raise SystemExit(f"unknown: {', '.join(unknown)}; there are {', '.join(allowed)}")
    return chosen


def _measured(transport: str, name: str, before: float, recordings: Path | None) -> Outcome:
    fault = FAULTS[name]
    if recordings is not None:
        recordings.mkdir(parents=True)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="rsb-outages-") as folder,
            OutageBed(
                Path(folder),
                transport,
                translated=fault.translated,
                two_ways=fault.two_ways,
                other=_ZenohBridge if transport == zenoh_bridge.NAME else None,
                recordings=recordings,
            ) as bed,
        ):
            record = bed.record(fault, before)
    except NoHostError as error:
        raise SystemExit(f"no namespaces: {error}; run this as root") from None
    accounts = {each.name: count_account(record, each.name) for each in FLOWS}
    return Outcome(
        transport,
        name,
        (record.ended - record.began) / 1e9,
        record.steady,
        {each.name: count_topic(record, each.name, each.rate) for each in FLOWS},
        count_calls(record),
        {topic: account for topic, account in accounts.items() if account is not None},
        {kind: _timeline(record, f"/up/{kind}") for kind in ("reliable", "whole")},
    )


def _timeline(record: Record, topic: str) -> list[tuple[float, float | None]]:
    came = {number: at for number, _, at in reversed(record.heard[topic])}

    def since(at: int) -> float:
        return round((at - record.began) / 1e9, 3)

    return [
        (since(made), since(came[number]) if number in came else None)
        for number, made in enumerate(record.made[topic], 1)
    ]


# --- tables


def _print(transport: str, outcomes: Sequence[Outcome]) -> None:
    by_fault = {name: [each for each in outcomes if each.fault == name] for name in FAULTS}
    runs = {name: its for name, its in by_fault.items() if its}
    print(f"\n### {transport}, {max(map(len, runs.values()), default=0)} runs a fault\n")
    _table(
        runs,
        {
            "lost: reliable 10 Hz": lambda its: _lost(its, "reliable"),
            "keep_all": lambda its: _lost(its, "whole"),
            "keep: 60": lambda its: _lost(its, "kept"),
            "200 Hz": lambda its: _lost(its, "deep"),
            "best effort": lambda its: _lost(its, "best"),
            "latched: lost, again": lambda its: _several(
                its, lambda run: (_sum(run.of("latched"), "lost"), _sum(run.of("latched"), "doubled"))
            ),
            "doubled, disordered": lambda its: _several(
                its, lambda run: (_sum(run.rated, "doubled"), _sum(run.topics.values(), "disordered"))
            ),
            "silence, s": lambda its: _sides(its, lambda topic: topic.silence),
            "back, s": lambda its: _sides(its, lambda topic: topic.back),
            "live again, s": lambda its: _sides(its, lambda topic: topic.live),
            "events: topics, latched, service": lambda its: _several(
                its, lambda run: (_sum(run.rated, "events"), _sum(run.of("latched"), "events"), run.calls.events)
            ),
            "calls": _calls,
        },
    )
    if any(each.accounts for each in outcomes):
        print("\nThe account's sum − published outside, of published; delivered − heard outside; dropped by cause:\n")
        kinds = {
            "reliable 10 Hz": "reliable",
            "keep_all": "whole",
            "keep: 60": "kept",
            "200 Hz": "deep",
            "best effort": "best",
        }
        columns: dict[str, Callable[[Sequence[Outcome]], str]] = {
            words: lambda its, kind=kind: _account(its, kind)  # type: ignore[misc]
            for words, kind in (kinds | {"latched": "latched"}).items()
        }
        _table(runs, columns | {"causes, all topics": _causes})
    if unsteady := [each for each in outcomes if not each.steady or any(topic.early for topic in each.topics.values())]:
        print("\nNot steady before or after the fault:", ", ".join({each.fault: None for each in unsteady}))


def _table(runs: dict[str, list[Outcome]], columns: dict[str, Callable[[Sequence[Outcome]], str]]) -> None:
    print("|", " | ".join(["fault", *columns]), "|")
    print("|---" * (len(columns) + 1) + "|")
    for name, its in runs.items():
        print("|", " | ".join([FAULTS[name].words, *(cell(its) for cell in columns.values())]), "|", flush=True)


def _spread(values: Iterable[float | None], digits: int = 0) -> str:
    """Return the median with the lowest and the highest; None is more than any number."""
    known = [float("inf") if each is None else each for each in values]
    low, middle, high = (
        _NEVER if each == float("inf") else f"{round(each, digits) + 0.0:,.{digits}f}"  # + 0.0: no -0
        for each in (min(known), median(known), max(known))
    )
    return middle if low == high else f"{middle} ({low} to {high})"


def _sum(counts: Iterable[Any], figure: str) -> int:
    return sum(getattr(each, figure) for each in counts)


def _lost(runs: Sequence[Outcome], kind: str) -> str:
    sides = [[run.of(kind)[side] for run in runs] for side in range(len(runs[0].of(kind)))]
    lost = "; ".join(_spread(topic.lost for topic in side) for side in sides)
    return f"{lost} of {median(topic.published for topic in sides[0]):,.0f}"


def _sides(runs: Sequence[Outcome], figure: Callable[[TopicCounts], float | None]) -> str:
    return "; ".join(_spread((figure(run.of("reliable")[side]) for run in runs), 1) for side in range(2))


def _several(runs: Sequence[Outcome], figures: Callable[[Outcome], tuple[int, ...]]) -> str:
    return ", ".join(_spread(each) for each in zip(*map(figures, runs), strict=True))


def _calls(runs: Sequence[Outcome]) -> str:
    calls = [run.calls for run in runs]
    answered, kept, twice, wrong = (
        _spread(getattr(each, figure) for each in calls) for figure in ("answered", "kept", "twice", "wrong")
    )
    asked, pending = (median(getattr(each, figure) for each in calls) for figure in ("asked", "pending"))
    wrongly = "" if wrong == "0" else f"; {wrong} answered wrongly"
    return f"{answered} of {asked:g}; {kept} of {pending:g}; {twice}{wrongly}"


def _account(runs: Sequence[Outcome], kind: str) -> str:
    parts = []
    for side in range(len(runs[0].account(kind))):
        its = [run.account(kind)[side] for run in runs]
        offered = _spread(each.accounted - each.published for each in its)
        delivered = _spread(each.delivered - each.heard for each in its)
        parts.append(f"{offered} of {median(each.published for each in its):,.0f}, {delivered}")
    return "; ".join(parts)


def _causes(runs: Sequence[Outcome]) -> str:
    """Return what the accounts of all topics say of messages that are not delivered: the mean of the runs."""
    total: Counter[str] = Counter()
    for run in runs:
        for account in run.accounts.values():
            total.update(account.dropped)
            total["unbalanced"] += abs(account.unbalanced)
    return ", ".join(f"{count / len(runs):,.0f} {cause}" for cause, count in sorted(total.items()) if count) or "none"


if __name__ == "__main__":
    main()

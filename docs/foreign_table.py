"""Writes the tables of docs/foreign.md from figures of `bench.foreign_dds`: ``make plots``."""

from __future__ import annotations

import json
from collections import Counter
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).parents[1]
FILE, PAGE = ROOT / "docs/figures/foreign_dds.json", ROOT / "docs/foreign.md"
BEGIN, END = "<!-- by make plots, from docs/figures/foreign_dds.json -->\n", "<!-- end -->\n"
_CASES = {
    "best_effort": "best effort, 20 messages",
    "reliable": "reliable, 20 messages",
    "latched": "latched, the last 5 of 7 to a late joiner",
    "large": "1 MB, reliable, 10 at 2 Hz",
    "large_best_effort": "1 MB, best effort, 10 at 2 Hz",
    "deadline": "deadline of 1 s: silence is reported",
    "liveliness": "lease of 2 s: silence is reported",
    "lifespan": "lifespan of 2 s: a late joiner is spared 5",
    "enhanced": "10 calls (mapping Enhanced, Fast DDS's)",
    "basic": "10 calls by the mapping Basic",
    "cyclone": "10 calls by the mapping of Cyclone",
    "parameters": "a parameter set and read 10 times",
    "clock": "`/clock`, 10 ticks",
    "killed": "killed and started again, 10 messages",
    "keyed": "a type with a key (KeyedString), 20 messages",
    "keyed_latched": "latched with a key, the last of 2 keys to a late joiner",
    "own_key": "a key in the program's String, none in ROS's, 20 messages",
}
_LARGE = "as stock nodes on Fast DDS: reliable, or [large messages](performance.md#fast-dds-within-a-machine)"
_BUFFER = "a larger UDP buffer for Fast DDS where it hears this (below)"
_KEY = "types with a key (below)"
_NO_EVENTS = "its protocol has no such event: watch the time of the last message"
_DUST = "finite times on both ends (below)"
_SHARED = {"large_best_effort": _LARGE}
_REMEDIES: Mapping[str, Mapping[str, str]] = {
    "kilted": _SHARED,
    "discovery-server": _SHARED,
    "cyclonedds": _SHARED
    | {"large": "publish less often, or latched: the first one is often lost"}
    | dict.fromkeys(("keyed", "keyed_latched", "own_key"), _KEY),
    "rustdds": {
        "latched": "a late joiner hears all 7 that it keeps, now and then out of order: look at a stamp",
        "large": _BUFFER,
        "large_best_effort": _BUFFER,
        "liveliness": "it hears the messages, and has no event: watch for a deadline there",
        "lifespan": "its writer keeps what is too old: stamp messages, and look at the stamp",
        "own_key": _KEY,
    },
    "ros2-client": {
        "large": _BUFFER,
        "large_best_effort": _BUFFER,
        "deadline": "its subscription shows no such events: watch the time of the last message",
        "liveliness": "the same",
        "lifespan": "its writer keeps what is too old; the bridge drops it by the stamp",
        "basic": "`ServiceMapping::Enhanced`",
        "cyclone": "`ServiceMapping::Enhanced`",
        "clock": "it has `builtin_interfaces/Time` there, ROS `rosgraph_msgs/Clock`: publish that type by hand",
    },
    "rosbridge": _SHARED | {"deadline": _NO_EVENTS, "liveliness": "it knows no liveliness: ask for no lease"},
    "dust-dds": dict.fromkeys(_CASES, _DUST) | {"large_best_effort": f"{_DUST}; {_BUFFER}", "own_key": _KEY},
}
"""For a user, by part and case."""


def page() -> str:
    """Return the page with the tables of the file."""
    text = PAGE.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    return before + BEGIN + tables() + END + after


def tables() -> str:
    found: Mapping[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return "\n".join(starmap(_table, found.items())) + "\n"


def _table(name: str, part: Mapping[str, Any]) -> str:
    runs = [run for ways in part["cases"].values() for ends in ways.values() for run in ends.values()]
    beside = Counter(run["beside"] for run in runs).most_common(1)[0][0]
    days = sorted({run["seen"] for run in runs})
    lines = [
        f"**{part['title']}**, seen on {' to '.join(dict.fromkeys((days[0], days[-1])))} with a node of {beside}\n",
        "| case | it speaks: alone, robot's end, desk's end | it hears | what to do |",
        "|---|---|---|---|",
    ]
    remedies = _REMEDIES.get(name, {})
    for case, words in _CASES.items():
        if case in part["cases"]:
            ways = part["cases"][case]
            speaks, hears = (_runs(ways.get(way, {})) for way in ("speaks", "hears"))
            remedy = "" if {speaks, hears} <= {"all", ""} else remedies.get(case, "")
            others = {run["beside"] for ends in ways.values() for run in ends.values()} - {beside}
            lines.append(f"| {', with '.join((words, *others))} | {speaks} | {hears} | {remedy} |")
    return "\n".join(lines) + "\n"


def _runs(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what came without a bridge, at the robot's end and at the desk's."""
    counts = [runs[end]["heard"] if end in runs else None for end in ("direct", "robot", "desk")]
    if not runs:
        return ""
    if all(run["heard"] == run["of"] for run in runs.values()):
        return "all"
    return ", ".join("–" if count is None else str(count) for count in counts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

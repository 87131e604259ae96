"""The pane of faults: a line or more for each fault."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.faults import explained_by_link
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_console.notation import formats
from rsb_console.notation.formats import PatternRow, Row, rows_of
from rsb_console.notation.glyphs import STATE_SIGN
from rsb_console.widgets.lines import FixedLines, Line, fit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.snapshot import LinkSnapshot, Snapshot

_NAMED = 3
_OWN_NAME = "\0"
"""Replaces a fault's own name in its cause, so that causes without another difference are alike."""
_DURATION = re.compile(r"\b\d+ (?:s|min|h)\b")
"""Durations, which differ a little between topics that failed together."""
_KEEPS_HEIGHT = 10.0
"""Seconds for which a fault keeps its number of lines, as a figure with one more digit may wrap differently."""
_SHOWN_WHILE_WAITING = (
    Cause.TYPE_UNKNOWN,
    Cause.SIMILAR_NAME,
    Cause.PUBLISHED_THERE,
    Cause.PUBLISHER_UNHEARD,
)
"""Causes for which a waiting topic is shown here. One that merely has no publisher yet is not."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a link or a topic."""

    sign: str
    look: str
    robot: str  # of a topic, if there are several robots
    name: str  # the link's, or the topic's
    cause: str
    of_link: bool
    others: tuple[str, ...] = ()  # names of others with the same cause, ignoring names and durations
    measured: bool = False  # its figures change all the time, so that no other fault shares them for long

    @property
    def key(self) -> tuple[str, str, str]:
        """Identity of the fault; stays when its words change."""
        return self.sign, self.robot, self.name

    @property
    def text(self) -> str:
        robot = f"{self.robot}: " if self.robot else ""
        too = f" (also {join_first(self.others, _NAMED)})" if self.others else ""
        return f"{robot}{self.name}: {self.cause}{too}"


class MoreKeys(NamedTuple):
    """The keys that show the faults without room in the pane: one for links and one for topics."""

    links: str
    topics: str


class FaultLines(FixedLines):
    """The faults, the worst first, each in whole sentences, and the number of faults that do not fit."""

    def __init__(self) -> None:
        super().__init__(id="faults")
        self._faults: list[Fault] = []
        self._most = 0
        self._keys = MoreKeys("", "")
        self._heights = Heights()
        self._now = 0.0

    def show(self, faults: list[Fault], most: int, keys: MoreKeys, now: float) -> None:
        """Show as many faults as fit in `most` lines, of a snapshot of the time `now`."""
        self._faults, self._most, self._keys, self._now = faults, most, keys, now
        self._lay_out(self.app.size.width)
        self.sync()

    def on_resize(self) -> None:
        self._lay_out(self.size.width)

    def _lay_out(self, width: int) -> None:
        self._heights.record(self._faults[: self._most], width, self._now)
        self._lines = fault_lines(self._faults, width, self._most, self._keys, self._heights)
        self.styles.height = len(self._lines)


class Heights:
    """Numbers of lines of faults, which stay while their figures change."""

    def __init__(self) -> None:
        self._width = 0
        self._needed: dict[tuple[str, str, str], tuple[int, float]] = {}

    def record(self, faults: list[Fault], width: int, now: float) -> None:
        """Record how many lines each fault that is shown needs."""
        before = self._needed if width == self._width else {}
        self._width, self._needed = width, {}
        for fault in faults:
            needs = len(_wrapped(fault, width))
            had, at = before.get(fault.key, (0, now))
            # A snapshot has the machine's time, which may be set back: no height is kept until it has caught up.
            self._needed[fault.key] = (had, at) if had > needs and 0.0 <= now - at < _KEEPS_HEIGHT else (needs, now)

    def of(self, fault: Fault) -> int:
        """Return how many lines a fault takes, or 0 if it is unknown."""
        return self._needed.get(fault.key, (0, 0.0))[0]


def fault_lines(
    faults: list[Fault], width: int, most: int, keys: MoreKeys, heights: Heights | None = None
) -> list[Line]:
    """Return the lines of as many whole faults as fit, the worst first; the first is cut if it alone is too long.

    Args:
        heights: least number of lines for each fault, or None.
    """
    # Each fault takes a line at least, so there is no room for further ones.
    wrapped = [_wrapped(fault, width, heights.of(fault) if heights else 0) for fault in faults[:most]]
    if len(faults) <= most and sum(map(len, wrapped)) <= most:
        return [line for lines in wrapped for line in lines]
    room = most - (len(faults) > 1)  # the last line says how many more there are
    shown = wrapped[0] if len(wrapped[0]) <= room else [*wrapped[0][: room - 1], _cut(wrapped[0][room - 1], width)]
    left_out = faults[most:]
    for fault, lines in zip(faults[1:], wrapped[1:], strict=False):
        if len(shown) + len(lines) <= room:
            shown += lines
        else:
            left_out.append(fault)
    if not left_out:
        return shown
    press = [keys.links] * any(fault.of_link for fault in left_out)
    press += [keys.topics] * any(not fault.of_link for fault in left_out)
    more = f"and {sum(1 + len(fault.others) for fault in left_out)} more: press {' or '.join(press)}"
    return [*shown, fit(((f"   {more}", "dim"),), width)]


def _wrapped(fault: Fault, width: int, least: int = 0) -> list[Line]:
    texts = textwrap.wrap(fault.text, max(10, width - 4))
    texts += [""] * (least - len(texts))
    return [((f" {' ' if number else fault.sign} ", fault.look), (text, "")) for number, text in enumerate(texts)]


def _cut(line: Line, width: int) -> Line:
    *_, (text, look) = line
    return fit((*line[:-1], (f"{text} …", look)), width)


def faults_of(snapshot: Snapshot) -> list[Fault]:
    """Return the faults of links, then of topics, the worst first, then waits; none that a link explains."""
    if not snapshot.running:
        return []
    alike: dict[tuple[str, str, str, bool], list[Fault]] = {}
    found = (*_link_faults(snapshot), *_topic_faults(snapshot))
    for fault in sorted(found, key=lambda fault: fault.look == State.WAITING.value):
        cause = _DURATION.sub("", fault.cause.replace(fault.name, _OWN_NAME))
        key = fault.sign, fault.robot, fault.name if fault.measured else cause, fault.of_link
        alike.setdefault(key, []).append(fault)
    return [replace(first, others=tuple(other.name for other in others)) for first, *others in alike.values()]


def _link_faults(snapshot: Snapshot) -> Iterator[Fault]:
    """Yield the faults of links, without a single waiting link, which the header shows, and the refused clients."""
    single = len(snapshot.links) == 1
    for link in sorted(snapshot.links, key=lambda link: (link.state.rank, link.name)):
        if link.acknowledged is not None:
            continue
        parts = link_fault(link, server=snapshot.role == "server"), formats.waits(link, snapshot.time)
        cause = "; ".join(filter(None, parts))
        if link.state is State.OK and link.warning:
            yield Fault("!", State.SLOW.value, "", link.name, cause, of_link=True)
        elif link.state is not State.OK and not (single and link.state is State.WAITING):
            yield Fault(STATE_SIGN[link.state], link.state.value, "", link.name, cause, of_link=True)
    for client in snapshot.refused:
        name = f"{client.name or 'a client'} at {client.host}"
        yield Fault("!", State.SLOW.value, "", name, client.reason, of_link=True)


def _topic_faults(snapshot: Snapshot) -> Iterator[Fault]:
    several = len(snapshot.links) > 1
    links = {link.name: link for link in snapshot.links}
    for row in sorted(rows_of(snapshot), key=lambda row: (row.state.rank, row.topic)):
        if _needs_words(row) and not explained_by_link(row.cause, links.get(row.link)):
            unheard_here = row.cause == Cause.NO_SUBSCRIBER and not row.outgoing
            # One line for all robots: it is this side whose nodes do not subscribe.
            robot = row.link if several and not unheard_here else ""
            sign, measured = STATE_SIGN[row.state], row.state is State.SLOW or row.cause == Cause.LOSSY
            yield Fault(sign, row.state.value, robot, row.topic, _reason(row), of_link=False, measured=measured)


def _needs_words(row: Row) -> bool:
    """Whether a topic has a fault of its own, or waits for something that an operator can remedy."""
    if row.acknowledged is not None:
        return False
    if row.state is State.OK or row.state.is_wanted:
        return False
    return row.state is not State.WAITING or row.cause in _SHOWN_WHILE_WAITING


def _reason(row: Row) -> str:
    stages = () if isinstance(row, PatternRow) else row.stages
    failed = next((stage.detail for stage in stages if not stage.done), "")
    return row.reason or failed or "no cause known"


def link_fault(link: LinkSnapshot, *, server: bool) -> str:
    """Format the fault of a link; on a server, name the missing client."""
    since = formats.minute(link.since)
    if link.state is State.OK:
        return link.warning
    if not server or link.cause not in (LinkCause.LOST, LinkCause.SILENT, LinkCause.CLOSED, LinkCause.NOT_YET):
        return link.reason
    if link.peer:
        return f"missing since {since}, last seen at {link.peer}: {link.reason}"
    if link.cause == LinkCause.NOT_YET:
        return f"not connected yet, since {since}"
    return f"missing since {since}, not seen yet"

"""Parts of the details that topics and services share."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_bridge.model.on_end import CANCEL, NONE
from rsb_bridge.model.wording import Wording
from rsb_console.look import formats
from rsb_console.look.glyphs import (
    ARMED,
    ARMED_WORD,
    DONE,
    FAILED,
    STATE_SIGN,
    STATE_WORD,
    UNKNOWN,
    braille_plot,
)
from rsb_console.widgets.columns import carries, present_rate
from rsb_console.widgets.lines import Line, width_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.snapshot import Acknowledgement, ArmingSnapshot, RouteSnapshot, Stage, State
    from rsb_console.look.formats import Row

PLOT_HEIGHT = 4
LABEL = 11  # cells of a figure's name, of which "subscribers" is the longest
TIED = "\N{NO-BREAK SPACE}"
"""Keeps a figure and its unit on one line: textwrap breaks no line there."""


class DetailText(Wording):
    """Texts of the details of a topic or a service."""

    WHY_NOT_FLOWING = "Why it isn't flowing"
    NOTHING_COMES = "and nothing comes now"
    WHY_NO_ANSWER = "Why it doesn't answer"
    NO_ANSWER_NOW = "and it does not answer now"
    GIVEN_UP = "after {timeout:g} s without an answer"
    ALL_PARAMETERS = "all parameters of the node"
    UNKNOWN_TYPE = "type not known yet"


def heading(route: RouteSnapshot, last: str, width: int) -> Iterator[Line]:
    """Yield the state, the arming and the reason of a fault.

    Args:
        last: word for the last arrival: ``message``.
        width: width of the pane in cells.
    """
    yield (
        state(route.state),
        ("" if route.age is None or route.age < 1 else f" last {last} {formats.age(route.age)} ago", "dim"),
    )
    if (arming := route.arming) is not None and arming.armed:
        left = "" if arming.left is None else f" {arming.left:.0f} s"
        yield ((f" {ARMED} {ARMED_WORD}{left} ", "armed"),)
        yield from wrapped(f"{arming.by}, {_until(arming)}", width, "")
    if arming is not None and arming.demanded_by:
        yield from wrapped(f"has to be armed: {', '.join(arming.demanded_by)}", width, "dim")
    if arming is not None and arming.on_end:
        yield from wrapped(f"when that ends, {_ends(arming.on_end, route)}", width, "dim")
    if route.limits is not None:
        yield from wrapped(f"at most {route.limits} by hand: {', '.join(route.limited_by)}", width, "dim")
    yield from why(route, next((stage.detail for stage in route.stages if not stage.done), ""), width)


def state(of: State) -> tuple[str, str]:
    """Return the piece of a line that shows a state."""
    return f" {STATE_SIGN[of]} {STATE_WORD[of]} ", of.value


def why(row: Row, elsewhere: str, width: int) -> Iterator[Line]:
    """Yield the acknowledgement and the reason of a fault, unless the details give that elsewhere."""
    if row.acknowledged is not None:
        yield from wrapped(acknowledged_by(row.acknowledged), width, "dim")
    if row.reason and row.reason != elsewhere:
        yield from wrapped(row.reason, width, row.state.value)


def _ends(on_end: str, route: RouteSnapshot) -> str:
    if route.calls is not None:
        return "its goals are cancelled" if on_end == CANCEL else "its goals go on"
    return f"the robot gets {'nothing' if on_end == NONE else on_end}"


def acknowledged_by(record: Acknowledgement) -> str:
    """Return a note on the operator who has acknowledged a fault, and the time."""
    return f"acknowledged by {record.by} at {formats.time_of_day(record.at)}, until it changes"


def _until(arming: ArmingSnapshot) -> str:
    """Return the conditions that disarm it."""
    if not arming.deadman:
        return "until it is disarmed, the link drops or that console ends"
    return f"until no key is pressed on that console for {arming.deadman:g} s"


def carrier_of(route: RouteSnapshot) -> str:
    """Return the transport with its port or channel; Zenoh has neither."""
    if not route.port:
        return route.transport.upper()
    return f"{route.transport.upper()} {'channel' if route.transport == 'bluetooth' else 'port'} {route.port}"


def crossing(route: RouteSnapshot, way: str, width: int) -> Iterator[Line]:
    """Yield the type, the direction, the transport, the name on the other side and the pattern.

    Args:
        way: direction and peer in words.
        width: width of the pane in cells.
    """
    yield ((f" {_type(route)}", "strong" if route.type_name else "dim"),)
    carrier = carrier_of(route)
    towards: Line = ((f" {way}", ""), (f"  {carrier}", "dim"))
    yield from (towards,) if width_of(towards) <= width else (towards[:1], ((f"   {carrier}", "dim"),))
    if route.remote_topic and route.remote_topic != route.topic:
        yield ((f"   there: {route.remote_topic}", "dim"),)
    if route.pattern:
        yield ((f"   matches {route.pattern}", "dim"),)


def _type(route: RouteSnapshot) -> str:
    """Return the type, if the bridge knows it. Parameters have ROS's own types."""
    unknown = DetailText.ALL_PARAMETERS if route.spec.kind == "parameters" else DetailText.UNKNOWN_TYPE
    return formats.known_type(route) or unknown()


def stages(route: RouteSnapshot, question: str, nothing: str, width: int) -> Iterator[Line]:
    """Yield the stages: those passed on one line, the first that fails with its reason, and the others on one line.

    Args:
        question: question that they answer if it does not work.
        nothing: text for a route that passed all stages but no longer works.
        width: width of the pane in cells.
    """
    of_route = route.stages
    waiting = [index for index, stage in enumerate(of_route) if not stage.done]
    # A failed stage explains more than an earlier one without a result.
    at = next((index for index in waiting if of_route[index].done is False), next(iter(waiting), None))
    yield ((" Stages" if route.state.flows else f" {question}", "head"),)
    if at is None:
        passed = f"all {len(of_route)} passed"
        if carries(route) and not route.state.flows:
            yield ((f" {UNKNOWN} ", route.state.value), (f"{passed} before", ""))
            yield from wrapped(nothing, width, "")
        else:
            yield ((f" {DONE} ", "ok"), (passed, ""))
        return
    failed = of_route[at]
    yield from _listed(DONE, "ok", [stage for stage in of_route if stage.done], width)
    sign, look = (UNKNOWN, "waiting") if failed.done is None else (FAILED, "down")
    yield ((f" {sign} ", look), (failed.name, "strong"))
    yield from wrapped(failed.detail, width, look)
    yield from _listed(UNKNOWN, "dim", [of_route[index] for index in waiting if index != at], width)


def _listed(sign: str, look: str, of_route: Sequence[Stage], width: int) -> Iterator[Line]:
    names = ", ".join(stage.name for stage in of_route)
    for number, text in enumerate(textwrap.wrap(names, max(10, width - 4))):
        yield ((f" {' ' if number else sign} ", look), (text, "dim"))


def wrapped(text: str, width: int, look: str) -> Iterator[Line]:
    """Wrap a text over as many lines as it takes."""
    for line in textwrap.wrap(text, max(10, width - 3)):
        yield ((f"   {line}", look),)


def plot(route: RouteSnapshot, title: str, unit: str, width: int) -> Iterator[Line]:
    """Yield the present rate and a curve of the last seconds.

    Args:
        width: width of the pane in cells.
    """
    # A route keeps the last 120 s, two of which take a cell.
    cells = max(1, min(width - 2, 60))
    shown = route.history[-2 * cells :]
    usual = route.expected_rate if route.calls is None else None  # nobody expects calls
    top = 1.2 * max(usual or 0.0, *shown, 1.0) if shown else 1.0
    expected = "" if usual is None else f" of {formats.expected(usual)}"
    yield (
        (f" {title}", "head"),
        (f"  {formats.hertz(present_rate(route)) if carries(route) else '-'} {unit}{expected}", "strong"),
        (f"  last {2 * cells} s", "dim"),
    )
    for line in braille_plot(shown, cells, PLOT_HEIGHT, top):
        yield ((f" {line}", "plot"),)


def ledger(title: str, rows: Sequence[tuple[str, int, str, str]]) -> Iterator[Line]:
    """Yield counts, one a line.

    Args:
        rows: name, count, style if the count is not 0, and a remark for each line.
    """
    yield ((f" {title}", "head"),)
    name_width = max(LABEL, *(len(name) for name, _, _, _ in rows)) + 1
    for name, count, look, behind in rows:
        yield (
            (f" {name:<{name_width}}", "dim"),
            (f"{formats.thousands(count):>9}", look if count else "dim"),
            (behind, ""),
        )


def share(part: int, whole: int) -> str:
    """Format a part in percent, or return an empty string if the whole is 0."""
    return f"  {100 * part / whole:.1f} %" if whole > 0 else ""


def throughput(route: RouteSnapshot, width: int) -> Iterator[Line]:
    """Format the present byte rate and the total."""
    total = f"{formats.thousands(route.bytes_total)} in all"
    yield from figure("bytes", [f"{formats.byte_rate(route.bytes_per_second)},", total], width)


def nodes(name: str, of_route: Sequence[str], width: int) -> Iterator[Line]:
    """Yield the known nodes at one end of the route."""
    if of_route:
        yield from figure(name, [f"{node}," for node in of_route[:-1]] + [of_route[-1]], width)


def figure(name: str, pieces: Sequence[str], width: int) -> Iterator[Line]:
    """Yield a named figure, wrapped to the pane's width without breaking pieces that fit on a line."""
    room = max(10, width - LABEL - 2)
    text = " ".join(pieces)
    if len(text) <= room:  # the usual case, at every refresh
        yield labelled(name, text)
        return
    tied = " ".join(piece.replace(" ", TIED) for piece in pieces)
    for number, line in enumerate(textwrap.wrap(tied, room)):
        yield labelled("" if number else name, line.replace(TIED, " ").rstrip())


def last_error(route: RouteSnapshot, width: int) -> Iterator[Line]:
    """Yield the last error with its time, if there was one."""
    if route.last_error:
        words = [*route.last_error.split(), f"(at {formats.time_of_day(route.last_error_at)})"]
        yield from figure("last error", words, width)


def labelled(name: str, text: str) -> Line:
    """Format a named figure on one line."""
    return ((f" {name:<{LABEL}} ", "dim"), (text, ""))

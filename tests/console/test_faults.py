"""The first screen shows the cause of every fault, wherever the cursor is."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from tests.console.driving import engine_of, gone, on_main, put, selected_topic, settled, shown, text, until
from tests.console.scripted import LINK, NOW, ROUTES, route
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import LinkSnapshot, RefusedClient, RouteSnapshot, Snapshot, State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.resolving import Elsewhere, no_publisher
from rsb_console.app import ConsoleApp
from rsb_console.widgets.fault_pane import Heights, MoreKeys, fault_lines, faults_of, link_fault

QOS = "/camera offers best effort, but this topic asks for reliable: its messages are not received; set qos: auto"
MEANT = Elsewhere(Cause.SIMILAR_NAME, "did you mean /w_typo?")
TYPO = route("/w_tpyo", State.WAITING, cause="similar_name", reason=no_publisher("/w_tpyo", "3", MEANT))
CAMERA = route("/camera", State.DOWN, reason="refused there")
SIZES = [pytest.param(size, id=str(size)) for size in ((200, 50), (120, 36), (80, 24), (60, 24), (39, 20))]


def snapshot(*routes: RouteSnapshot, links: tuple[LinkSnapshot, ...] = (LINK,), **changes: Any) -> Snapshot:
    now = Snapshot(NOW, "robot1", "client", "10.0.0.20:49152", 3, True, links, routes)
    return replace(now, **changes)


def said(*routes: RouteSnapshot, **about: Any) -> list[str]:
    """The faults as they begin: sign and sentence."""
    return [f"{fault.sign} {fault.text}" for fault in faults_of(snapshot(*routes, **about))]


def drawn(*routes: RouteSnapshot, width: int, most: int) -> list[str]:
    lines = fault_lines(faults_of(snapshot(*routes)), width, most, MoreKeys("c", "f"))
    made = ["".join(piece for piece, _ in line).rstrip() for line in lines]
    assert len(made) <= most
    assert all(len(line) <= width for line in made)
    return made


def test_faults_come_first_then_what_waits_for_remedy() -> None:
    assert said(TYPO, *ROUTES, route("/a", State.WAITING, cause="no_publisher", reason=no_publisher("/a", "3"))) == [
        "✗ /robot2/scan: no publisher of /scan in domain 4",
        "▲ /robot1/map: nothing for 15 s",
        "◌ /w_tpyo: no publisher of /w_tpyo in domain 3; did you mean /w_typo?",
    ]


def test_what_a_link_explains_is_told_once() -> None:
    down = [route(f"/{n}", State.DOWN, cause="link_down", reason="Connection refused") for n in range(3)]
    link = replace(LINK, state=State.DOWN, cause="unreachable", reason="Connection refused")
    assert said(*down, links=(link,)) == ["✗ robot1: Connection refused"]


def test_faults_of_one_cause_are_grouped_per_robot() -> None:
    links = (LINK, *(replace(LINK, name=f"robot{n}", state=State.WAITING, cause="not_yet", peer="") for n in (2, 3)))
    unheard = [
        route(f"/{robot}/{n}", State.UNHEARD, link=robot, reason=f"nobody subscribes to /{robot}/{n}")
        for robot in ("robot1", "robot2")
        for n in range(5)
    ]
    one, other, link = said(*unheard, links=links, role="server")
    assert link.startswith("◌ robot2: ")
    assert link.endswith(" (also robot3)")
    assert one == (
        "◇ robot1: /robot1/0: nobody subscribes to /robot1/0 (also /robot1/1, /robot1/2, /robot1/3 and 1 more)"
    )
    assert other.startswith("◇ robot2: /robot2/0: nobody subscribes to /robot2/0 (also")


def test_unheard_topics_are_one_line_for_all_robots() -> None:
    links = (LINK, replace(LINK, name="robot2"))
    unheard = [
        replace(
            route(f"/{robot}/{n}", State.UNHEARD, link=robot, cause="no_subscriber", reason=reason), outgoing=n == 2
        )
        for robot in ("robot1", "robot2")
        for n in range(3)
        for reason in [f"nobody subscribes to /{robot}/{n} in domain 3"]
    ]
    told = said(*unheard, links=links, role="server")
    assert [line.partition(" ")[2].split(":")[0] for line in told] == ["/robot1/0", "robot1", "robot2"]
    assert told[0].endswith("(also /robot1/1, /robot2/0 and /robot2/1)")


def test_first_is_whole_and_others_are_counted() -> None:
    first, second = route("/a", State.DOWN, reason=QOS), route("/b", State.DOWN, reason="refused there")
    assert drawn(first, second, width=120, most=3) == [f" ✗ /a: {QOS}", " ✗ /b: refused there"]
    assert drawn(first, second, width=60, most=3) == [
        " ✗ /a: /camera offers best effort, but this topic asks for",
        "   reliable: its messages are not received; set qos: auto",
        " ✗ /b: refused there",
    ]
    assert drawn(first, second, width=60, most=2)[1:] == ["   and 1 more: press f"]
    assert drawn(first, width=39, most=2)[-1].endswith("…")


def test_a_long_one_hides_no_short_one() -> None:
    longest, short = route("/b", State.DOWN, reason="x " * 200), route("/c", State.SLOW, reason="2 Hz of 20 expected")
    assert drawn(route("/a", State.DOWN, reason="refused"), longest, short, width=80, most=4) == [
        " ✗ /a: refused",
        " ≈ /c: 2 Hz of 20 expected",
        "   and 1 more: press f",
    ]


@on_main(*SIZES, landmark="/camera: refused there", routes=(CAMERA, TYPO, *ROUTES[:3]))
async def test_without_a_key_at_every_width(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: "did you mean /w_typo?" in " ".join(text(app).split()), "the name that was meant")
    assert selected_topic(app) == "/camera"


MANY = tuple(route(f"/{n}", State.DOWN, reason=f"reason number {n}") for n in range(10, 30))


@on_main((80, 24), landmark="and 15 more: press f", routes=MANY)
async def test_faults_only_gives_them_more_room(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("f")
    await shown(pilot, "and 9 more: press ⏎ on one")
    put(app, *MANY[:1])
    await shown(pilot, "/10: reason number 10")
    await gone(pilot, "more: press")
    engine_of(app).now = replace(engine_of(app).now, routes=(route("/fine"),))
    await pilot.press("f")
    await until(pilot, lambda: app.main.faults.size.height == 0, "no line for no fault")


def pictures(*verdicts: Verdict, width: int, seconds: int = 90) -> list[list[str]]:
    """The lines of topics that have these verdicts, four times a second."""
    heights, found = Heights(), []
    for number in range(4 * seconds):
        now = NOW + 20.0 + number / 4
        routes = [
            route(f"/{name}", verdict.state, cause=verdict.cause, reason=verdict.said(now))
            for name, verdict in zip("abcd", verdicts, strict=False)
        ]
        faults = faults_of(snapshot(*routes, time=now))
        heights.record(faults, width, now)
        lines = fault_lines(faults, width, 9, MoreKeys("c", "f"), heights)
        found.append(["".join(piece for piece, _ in line).rstrip() for line in lines])
    return found


def silent(since: float, text: str = "nothing for {lasting}, 10 Hz expected: /driver has died") -> Verdict:
    return Verdict(State.STOPPED, Cause.PUBLISHER_SILENT, text, NOW + since)


@pytest.mark.parametrize("width", [40, 76, 121, *long(49, 58, 67, 85, 94, 103, 112)])
def test_lines_do_not_jump_while_their_figures_change(width: int) -> None:
    """Four topics of one node that died: their last messages came at different moments."""
    verdicts = [silent(each) for each in (19.1, 19.35, 19.6, 19.85)]
    assert len({len(each) for each in pictures(*verdicts, width=width, seconds=9)}) == 1
    drawn = pictures(*verdicts, silent(19.7, "nothing for {lasting}"), width=width)
    heights = [len(each) for each in drawn]
    assert sum(one != other for one, other in pairwise(heights)) <= 2, "once for each digit more, at the most"


def test_figures_of_several_lines_change_together() -> None:
    drawn = pictures(*(silent(19.1 + each / 7, f"{each} nothing for {{lasting}}") for each in range(4)), width=120)
    changed = [number for number, (one, other) in enumerate(pairwise(drawn)) if one != other]
    assert changed
    assert all((number + 1) % 4 == 0 for number in changed), "at the full second"


@on_main((64, 24), landmark="/fine", routes=(route("/fine"),))
async def test_a_fault_gives_its_room_back_in_time(app: ConsoleApp, pilot: Pilot[None]) -> None:
    taken = []
    for later, words in ((0.0, 20), (1.0, 2), (9.0, 2), (11.0, 2), (12.0, 0)):
        slow = route("/a", State.SLOW, reason="word " * words) if words else route("/fine")
        put(app, slow, time=NOW + later)
        await settled(pilot)
        taken.append(app.main.faults.size.height)
    assert taken == [2, 2, 2, 1, 0]


@on_main((80, 24), landmark="/fine", routes=(route("/fine"),))
async def test_client_that_is_refused_is_on_first_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    refused = RefusedClient("robot9", "10.0.0.9", "unknown_name", "unknown: add it", NOW - 5.0, 3)
    put(app, refused=(refused,))
    await shown(pilot, "robot9 at 10.0.0.9: unknown: add it")


@pytest.mark.parametrize(("cause", "missing"), [("not_yet", False), ("lost", True)])
def test_robot_that_was_never_there_is_not_missing(cause: str, missing: bool) -> None:
    never = replace(LINK, name="robot2", state=State.DOWN, cause=cause, reason="", peer="", since=NOW)
    assert ("missing" in link_fault(never, server=True)) is missing

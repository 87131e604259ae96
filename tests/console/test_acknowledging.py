"""Faults that an operator has acknowledged: still listed, but no longer first, and no longer in the banner."""

from dataclasses import replace

from tests.console.driving import engine_of, listed, on_main, put, until
from tests.console.scripted import LINK, NOW, ROUTES
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import Acknowledgement, LinkSnapshot, RouteSnapshot, Snapshot, State
from rsb_console.actions.all_actions import BY_ID
from rsb_console.app import ConsoleApp
from rsb_console.notation.glyphs import ACK_WORD, STATE_WORD
from rsb_console.screens.links_screen import LinksScreen
from rsb_console.widgets.bars import acknowledged_count, state_counts, warning_count
from rsb_console.widgets.fault_pane import faults_of
from rsb_console.widgets.filter import RowFilter

KNOWN = Acknowledgement("anna on pts/3", NOW - 60)
FIRST = next(route for route in ROUTES if route.state is State.DOWN)
OTHERS = tuple(route for route in ROUTES if route is not FIRST)


def known(faulty: RouteSnapshot = FIRST) -> RouteSnapshot:
    return replace(faulty, acknowledged=KNOWN)


def faults(*routes: RouteSnapshot, links: tuple[LinkSnapshot, ...] = (LINK,)) -> list[str]:
    snapshot = Snapshot(NOW, "robot1", "client", "10.0.0.20:49152", 3, running=True, links=links, routes=routes)
    return [fault.name for fault in faults_of(snapshot)]


def test_it_is_not_in_banner_and_counted_apart() -> None:
    assert faults(*ROUTES)[0] == FIRST.topic
    assert FIRST.topic not in faults(known(), *OTHERS)
    warned = replace(LINK, warning="two machines are called robot1")
    down = replace(LINK, state=State.DOWN, cause="unreachable")
    for link in (warned, down):
        assert faults(links=(link,)) == [LINK.name]
        assert faults(links=(replace(link, acknowledged=KNOWN),)) == []
    assert state_counts([FIRST], State) != ()
    assert state_counts([known()], State) == ()
    assert warning_count([replace(warned, acknowledged=KNOWN)]) == ()
    assert acknowledged_count([known(), *OTHERS])[0][1] == "dim"
    assert acknowledged_count(ROUTES) == ()


@on_main()
async def test_acknowledged_fault_is_last_dimmed_and_marked(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert listed(app)[0] == FIRST.topic
    put(app, known(), *OTHERS)
    table = app.main.topics
    assert listed(app)[0] != FIRST.topic
    at = listed(app).index(FIRST.topic)
    states = [table.rows[key].state for key in table.keys]
    assert all(state.severity for state in states[:at])
    assert not any(state.severity for state in states[at + 1 :])
    _, state, *cells = table.line(at + 1)
    assert state[0].split() == [ACK_WORD, STATE_WORD[FIRST.state]]
    assert {look for _, look in (state, *cells)} == {"dim"}
    app.main.act(BY_ID["next_match"])
    assert app.main.topics.selected is not None
    assert app.main.topics.selected.topic != FIRST.topic
    await pilot.press("f")
    await until(pilot, lambda: FIRST.topic in listed(app) and len(listed(app)) < len(ROUTES), "all faults")
    table.pattern = RowFilter(f"state:{ACK_WORD}")
    table.relist()
    assert listed(app) == [FIRST.topic]


@on_main()
async def test_a_key_acknowledges_and_takes_it_back(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("i")
    await until(pilot, lambda: engine_of(app).commands == [("acknowledge", FIRST.key, True)], "a command")
    put(app, known())
    await pilot.press("i")
    await until(pilot, lambda: engine_of(app).commands[1:] == [("acknowledge", FIRST.key, False)], "another")


@on_main()
async def test_a_link_is_acknowledged_among_the_links(app: ConsoleApp, pilot: Pilot[None]) -> None:
    down = replace(LINK, state=State.DOWN, cause="unreachable", reason="no answer")
    put(app, links=(replace(down, acknowledged=KNOWN), replace(down, name="robot2")))
    await pilot.press("c")
    await until(pilot, lambda: isinstance(app.screen, LinksScreen), "the links")
    assert isinstance(app.screen, LinksScreen)
    await until(pilot, lambda: app.screen.table.keys == ["robot2", "robot1"], "the order")  # type: ignore[attr-defined]
    await pilot.press("i", "j", "i")
    expected = [("acknowledge", "robot2", True), ("acknowledge", "robot1", False)]
    await until(pilot, lambda: engine_of(app).commands == expected, "the commands")

"""The fleet's screen: one line for each robot, faulty ones first."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from textual import work
from textual.screen import Screen

from rsb_bridge.feature_api import join_first
from rsb_console.actions.all_actions import bindings
from rsb_console.feature_console import DIALOG, Group, Prompt
from rsb_console.terminal.driver import copy
from rsb_console.widgets.bars import KeyBar, KeyEntry
from rsb_console.widgets.filter import table_title
from rsb_extras.fleet.fleet_actions import BY_ID, FLEET_ACTIONS
from rsb_extras.fleet.fleet_table import FleetStatus, FleetTable, FleetView, RobotDetail

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual import events
    from textual.app import ComposeResult

    from rsb_console.console_api import ConsoleShell
    from rsb_console.feature_console import SelectableList
    from rsb_extras.fleet.fleet import Robot, RobotFleet

_NAMED = 5


class FleetScreen(Screen[None]):
    """All robots, live.

    Args:
        view: the operator's settings of the table, from here or a screen before.
        open_robot: opens the console on one.
    """

    BINDINGS = bindings(Group.FLEET, Group.VIEW, actions=FLEET_ACTIONS)
    AUTO_FOCUS = "#fleet"
    VERTICAL_BREAKPOINTS = [(0, "-tiny"), (14, "-short")]  # noqa: RUF012 -- Textual declares it without ClassVar

    def __init__(
        self, console: ConsoleShell, fleet: RobotFleet, view: FleetView, open_robot: Callable[[Robot], None]
    ) -> None:
        super().__init__()
        self.console, self.fleet, self.view = console, fleet, view
        self._open = open_robot
        self.status, self.table, self.detail = FleetStatus(), FleetTable(view), RobotDetail()
        self.prompt, self.key_bar = Prompt("state: robot: group: why:"), KeyBar()
        self._keys_shown_for: tuple[object, ...] = ()

    def compose(self) -> ComposeResult:
        yield self.status
        yield self.table
        yield self.detail
        yield self.prompt
        yield self.key_bar

    # -- what is shown ------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """Show the present state of the robots."""
        self.table.show(self.fleet, self.console.as_seen(time.time()))
        self.table.explain(self._why_empty())
        self.status.show(self.table, self.fleet, readonly=self.console.readonly)
        self._show_detail()
        self._show_title()
        self._show_keys()

    def _why_empty(self) -> str:
        if self.table.rows:
            return f"No robot matches. {self._key('back')} shows all of them."
        return f"No robots yet: {self.fleet.sources[-1].empty}"

    def _show_detail(self) -> None:
        self.detail.show(*self.table.described)

    @property
    def fault_count(self) -> int:
        """Robots with something wrong, and sources without data, shown or not."""
        wrong = sum(row.robot.summary.state.is_wrong for row in self.table.rows.values())
        return wrong + sum(bool(source.problem) for source in self.fleet.sources)

    def _show_title(self) -> None:
        view, shown, rows = self.view, self.table.shown, len(self.table.rows)
        parts = table_title("Robots", view.pattern, faults_only=view.faults_only, shown=shown, rows=rows)
        if view.marked:
            parts.append(f"{len(view.marked)} marked")
        self.table.entitle(f" {' ▸ '.join(parts)} ")

    def _show_keys(self) -> None:
        """Show the keys that are possible now, if they have changed."""
        here, marked, gone = self.app.screen is self, len(self.view.marked), bool(self._gone)
        depends_on = (here, marked, gone, self.table.selected_group, self.table.cursor_key is None)
        if depends_on == self._keys_shown_for:
            return
        self._keys_shown_for = depends_on
        group = self.table.selected_group
        labels = {
            "open_robot": "open" if group is None else "unfold" if group in self.view.folded else "fold",
            "edit_marked": f"edit {marked} marked" if marked else "edit",
        }
        self.key_bar.show(
            [
                KeyEntry(
                    self.console.key_labels(action)[0],
                    labels.get(action.id, action.label),
                    f"{'app' if action.group is Group.CONSOLE else 'screen'}.{action.id}",
                    0 if action.stays else 1,
                )
                for action in FLEET_ACTIONS  # none below a dialog, whose keys are the only ones then
                if here and action.in_footer and self.check_action(action.id, ())
            ]
        )

    @property
    def _gone(self) -> list[Robot]:
        return [robot for robot in self.table.meant if robot.gone]

    def _key(self, action: str) -> str:
        return self.console.key_labels(BY_ID[action])[0]

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Allow the actions that are possible now (Textual's)."""
        if action == "dismiss" and not self._gone:
            return False
        if action in ("open_robot", "mark", "edit_marked") and self.table.cursor_key is None:
            return None
        return self.app.check_action(action, parameters)

    def on_screen_suspend(self) -> None:
        self._show_keys()

    def on_screen_resume(self) -> None:
        self._show_keys()

    def on_selectable_list_cursor_moved(self, event: SelectableList.CursorMoved) -> None:
        self._moved()

    def _moved(self) -> None:
        self.view.cursor = self.table.cursor_key
        self._show_detail()
        self._show_keys()

    def on_selectable_list_chosen(self, event: SelectableList.Chosen) -> None:
        self.action_open_robot()

    def on_resize(self, event: events.Resize) -> None:
        """Wrap the lines again."""
        self.call_after_refresh(self._show_detail)

    # -- actions ------------------------------------------------------------------------------------------------------

    def action_open_robot(self) -> None:
        """Open the console on the robot; of a group, fold or unfold it."""
        self.table.hold()
        robot = self.table.selected
        if robot is None:
            self.table.fold()
            self._moved()
        elif robot.gone:
            self.notify(f"{robot.summary.name} is not connected: it cannot be opened", markup=False, timeout=4)
        else:
            self._open(robot)

    def action_mark(self) -> None:
        """Mark the robot, or take the mark away."""
        self.table.mark()
        self._show_title()
        self._show_keys()

    @work(group=DIALOG)
    async def action_edit_marked(self) -> None:
        """Edit a topic of the marked robots, or of the one under the cursor; servers are left out."""
        from rsb_extras.fleet.rollout import RolloutScreen  # noqa: PLC0415 -- seldom needed

        self.table.hold()
        known = [robot for robot in self.table.meant if not robot.gone]
        if robots := [robot for robot in known if not robot.is_server]:
            await self.console.ask(RolloutScreen(self.console, self.fleet, robots))
        elif known:
            names = join_first([robot.summary.name for robot in known], _NAMED)
            text = f"{names} {'is a server' if len(known) == 1 else 'are servers'}: mark the robots to edit instead"
            self.notify(text, markup=False, timeout=6)
        else:
            self.notify("these robots are not connected: they cannot be edited", timeout=4)

    def action_dismiss(self) -> None:  # type: ignore[override]  # Textual's closes a screen, which this one never does
        """Forget robots that have gone: the marked ones, or the one under the cursor, or its group's."""
        gone = self._gone
        self.fleet.dismiss(gone)
        names = join_first([robot.summary.name for robot in gone], _NAMED)
        self.notify(f"forgotten: {names}", markup=False, timeout=3)
        self.show()

    def action_filter(self) -> None:
        self.prompt.open("" if self.view.pattern is None else self.view.pattern.text)

    def on_prompt_changed(self, event: Prompt.Changed) -> None:
        self.view.pattern = event.pattern
        self._relist()

    def on_prompt_closed(self) -> None:
        self.set_focus(self.table)

    def _relist(self) -> None:
        self.table.relist()
        self.table.explain(self._why_empty())
        self._show_title()
        self._moved()

    def action_back(self) -> None:
        """Drop the filters, or the marks if there are no filters."""
        view = self.view
        if view.pattern is not None or view.faults_only:
            view.pattern, view.faults_only = None, False
        else:
            view.marked.clear()
        self._relist()

    def action_faults(self) -> None:
        self.view.faults_only = not self.view.faults_only
        self._relist()

    def action_group(self) -> None:
        self.view.grouped = not self.view.grouped
        self._relist()

    def action_next_match(self) -> None:
        self.table.next_match(1)

    def action_previous_match(self) -> None:
        self.table.next_match(-1)

    def action_sort_left(self) -> None:
        """Sort by the column to the left."""
        self.table.sort_by(-1)

    def action_sort_right(self) -> None:
        """Sort by the column to the right."""
        self.table.sort_by(1)

    def action_reverse(self) -> None:
        self.table.reverse()

    def action_copy(self) -> None:
        """Copy the robot's name and the reason of its state."""
        if (robot := self.table.selected) is not None:
            summary = robot.summary
            text = f"{summary.name} {summary.state.upper()}{f': {summary.why}' if summary.why else ''}"
            self.notify(copy(self.app, text), timeout=3, markup=False)

"""Changes of what the main screen shows, and what an operator takes from it: a line, a list, a closer look."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import why_not_written
from rsb_bridge.installed_features import added
from rsb_console.actions.action import FooterEntry
from rsb_console.notation.formats import PatternRow, RowText
from rsb_console.screens.event_screen import EventScreen
from rsb_console.widgets.log import plain

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.screens.main import MainScreen


def filter_lines(screen: MainScreen) -> None:
    screen.filtered = screen.pane
    screen.prompt.open("" if screen.pane.pattern is None else screen.pane.pattern.text)


def next_match(screen: MainScreen) -> None:
    screen.pane.next_match(1)


def previous_match(screen: MainScreen) -> None:
    screen.pane.next_match(-1)


def faults(screen: MainScreen) -> None:
    screen.topics.faults_only = not screen.topics.faults_only
    screen.topics.relist()
    screen.console.pull()


def sort_left(screen: MainScreen) -> None:
    screen.topics.sort_by(-1)


def sort_right(screen: MainScreen) -> None:
    screen.topics.sort_by(1)


def reverse(screen: MainScreen) -> None:
    screen.topics.reverse()


def group(screen: MainScreen) -> None:
    screen.topics.grouped = not screen.topics.grouped
    screen.topics.relist()


def freeze(screen: MainScreen) -> None:
    screen.frozen_since = time.time() if screen.frozen_since is None else None
    screen.console.pull()


def level(screen: MainScreen) -> None:
    screen.log_pane.next_level()


def detail(screen: MainScreen) -> None:
    """Open a log line or a topic's details: focus the pane, or give it the whole of a narrow screen."""
    if screen.log_pane.has_focus and screen.log_pane.selected is not None:
        screen.app.push_screen(EventScreen(screen.log_pane.selected))
    elif screen.detail.has_focus:
        message(screen)
    elif screen.detail.display:
        screen.detail.focus()
    else:
        screen.set_mode("-detail")


def message(screen: MainScreen) -> None:
    route = screen.topics.selected
    if route is None or screen.console.engine is None:
        return
    if isinstance(route, PatternRow):
        screen.notify(RowText.IS_PATTERN(topic=route.topic), markup=False, timeout=4)
    elif route.calls is None:
        _show_messages(screen, route)
    else:
        text = RowText.NO_MESSAGES if screen.console.readonly else RowText.NO_MESSAGES_BUT_CALLS
        screen.notify(text(topic=route.topic, key=screen.explanations.key("call")), markup=False, timeout=4)


def _show_messages(screen: MainScreen, route: RouteSnapshot) -> None:
    """Show a topic's messages in the usual way of their type, then in the others, until the screen is closed."""
    from rsb_console.screens.message_screen import MessageScreen  # noqa: PLC0415 -- keeps the start short

    views = added("message_views", name_of=lambda view: view.name)
    as_text = partial(MessageScreen, other=views[0].name if views else "")
    ways = [*(view.screen for view in views), as_text]
    usual = next((at for at, view in enumerate(views) if view.suits(route.type_name)), len(views))

    def show(at: int) -> None:
        screen.app.push_screen(
            ways[at % len(ways)](screen.console, route), lambda other: show(at + 1) if other else None
        )

    show(usual)


def zoom(screen: MainScreen) -> None:
    """Maximize the focused pane, or restore the layout."""
    if screen.mode is not None:
        screen.set_mode(None)
    else:
        screen.set_mode("-log" if screen.log_pane.has_focus else "-detail" if screen.detail.has_focus else "-table")


def log(screen: MainScreen) -> None:
    """Focus the log, maximized if it has no room, or go back."""
    if screen.log_pane.has_focus:
        screen.set_mode(None)
    elif screen.log_pane.display:
        screen.log_pane.focus()
    else:
        screen.set_mode("-log")


def back(screen: MainScreen) -> None:
    """Close the open pane, or drop the filters."""
    if screen.mode is not None:
        screen.set_mode(None)
    elif not screen.topics.has_focus:
        screen.topics.focus()
    elif screen.topics.pattern is not None or screen.topics.faults_only:
        screen.topics.pattern, screen.topics.faults_only = None, False
        screen.topics.relist()


def copy_line(screen: MainScreen) -> None:
    from rsb_console.terminal.driver import copy  # noqa: PLC0415 -- seldom needed

    event, route = screen.log_pane.selected, screen.topics.selected
    text = plain(event) if screen.log_pane.has_focus and event else route.topic if route else ""
    if text:
        screen.notify(copy(screen.app, text), timeout=3, markup=False)


def export(screen: MainScreen) -> None:
    """Export the focused list to a file in the working folder."""
    from rsb_console.session.exports import export_log, export_topics  # noqa: PLC0415 -- seldom needed

    log = screen.pane is screen.log_pane
    try:
        path = export_log(screen.log_pane.listed) if log else export_topics(screen.topics.listed)
    except OSError as error:
        screen.notify(why_not_written(error, Path()), title="Not exported", severity="error", markup=False)
    else:
        screen.notify(f"written to {path}", markup=False)


def has_detail(screen: MainScreen) -> bool | None:
    return True if screen.log_pane.has_focus or screen.topics.selected is not None else None


def detail_in_footer(screen: MainScreen) -> FooterEntry:
    return FooterEntry("whole line" if screen.log_pane.has_focus else "detail")


def faults_in_footer(screen: MainScreen) -> FooterEntry:
    return FooterEntry("faults", screen.topic_counts)

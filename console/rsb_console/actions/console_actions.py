"""The keys of the console itself, on any screen."""

from __future__ import annotations

from rsb_console.actions.action import Action, Group

# Each app has its own way, as a method `action_<id>`: quitting, for example.
ACTIONS = (
    Action("faster", "plus", "faster", "Refresh more often", Group.CONSOLE),
    Action("slower", "minus", "slower", "Refresh less often", Group.CONSOLE),
    Action("theme", "t", "theme", "Next theme", Group.CONSOLE),
    Action("mouse", "m", "mouse", "Give the mouse to the terminal, or take it back", Group.CONSOLE),
    Action("bell_on_fault", "exclamation_mark", "bell", "Turn the terminal's bell for new faults on or off",
           Group.CONSOLE, also="sound, alarm, beep, notify"),
    Action("palette", "colon,ctrl+p", "palette", "Find an action by its name", Group.CONSOLE),
    Action("help", "question_mark,f1", "help", "Show every key", Group.CONSOLE, in_footer=True, stays=True),
    Action("quit", "q", "quit", "Quit; the bridge stops, unless it runs in another process", Group.CONSOLE,
           in_footer=True, stays=True),
)  # fmt: skip

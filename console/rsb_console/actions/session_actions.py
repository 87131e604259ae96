"""The keys for sessions, their files and keys."""

from __future__ import annotations

from rsb_console.actions.action import Action, Beginning, Group, late

_PLACE = "rsb_console.operations.session_operations"
_SAVING = "rsb_console.operations.save_operations"
ACTIONS = (
    Action("bluetooth", "b", "bluetooth", "Find Bluetooth adapters, devices and free channels", Group.SESSION,
           in_footer=True, run=late(f"{_PLACE}:bluetooth")),
    Action("keys", "K", "keys", "Show the key files, or make a key", Group.SESSION, in_footer=True,
           run=late("rsb_console.screens.keys_screen:show_keys")),
    Action("sessions", "o", "sessions", "Open another session", Group.SESSION, changes=True, in_footer=True,
           run=late(f"{_PLACE}:sessions"),
           begins=Beginning("o", "Open a session", "a recent one, or any file", 3, writes=False)),
    Action("save", "w", "save", "Save the session with its present topics", Group.SESSION,
           changes=True, in_footer=True, run=late(f"{_SAVING}:save"), footer=late(f"{_SAVING}:save_in_footer")),
    Action("save_as", "W", "save as", "Save the session to another file", Group.SESSION, changes=True,
           run=late(f"{_SAVING}:save_as")),
    Action("new_session", "f2", "new", "Write a new session", Group.SESSION, changes=True,
           run=late(f"{_PLACE}:new_session"),
           begins=Beginning("n", "New session", "a form that creates the session file and the key", 2, "New…")),
    Action("welcome", "f5", "welcome", "Show the welcome screen", Group.SESSION, changes=True,
           run=late(f"{_PLACE}:welcome")),
)  # fmt: skip

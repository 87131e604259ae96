"""All actions. Key bindings, footer, help and command palette are made from this registry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from textual.binding import Binding

from rsb_bridge.installed_features import added, added_by, leave_taken
from rsb_console.actions import (
    arming_actions,
    bridge_actions,
    console_actions,
    session_actions,
    topic_actions,
    view_actions,
)
from rsb_console.actions.action import Action, Group, KeyChapter

# No Ctrl+S, Q, A, B, J or Enter, and no Alt: terminals and multiplexers take these for themselves.
# The footer shows them in this order, as many as fit: what an operator needs most comes first.
OF_CORE: tuple[Action, ...] = (
    *view_actions.MOVES,
    *topic_actions.ACTIONS,
    *arming_actions.ACTIONS,
    *view_actions.ACTIONS,
    *bridge_actions.ACTIONS,
    *session_actions.ACTIONS,
    *console_actions.ACTIONS,
)


def _in_order() -> tuple[Action, ...]:
    """Return the core's actions and the features', each behind the action that it follows."""
    actions: list[Action] = []
    owners: dict[str, str] = {}

    def add(action: Action, owner: str) -> None:
        places = [place for place, each in enumerate(actions, 1) if each.id == action.after]
        actions.insert(places[0] if places else len(actions), action)
        owners.update(dict.fromkeys(action.keys.split(","), owner))

    for action in OF_CORE:
        add(action, "the core")
    for feature, action in added_by("actions", name_of=lambda action: action.id, taken=[each.id for each in OF_CORE]):
        free = [key for key in action.keys.split(",") if key not in owners]
        for key in set(action.keys.split(",")) - {*free}:
            leave_taken(feature, "actions", f"the key {key} of {action.id}", owners[key])
        add(replace(action, keys=",".join(free)), f"the feature {feature.name}")
    return tuple(actions)


ACTIONS = _in_order()
BY_ID = {action.id: action for action in ACTIONS}
KEYS_ON_SCREENS: tuple[KeyChapter, ...] = (
    *(chapter for action in ACTIONS for chapter in action.chapters),
    KeyChapter(
        "In a form",
        "FormScreen",
        (
            ("↑ ↓ tab", "Next or previous field"),
            ("⏎", "Go to what is missing, else accept"),
            ("F7", "Of a topic: go to a field by the beginning of its name"),
            ("F8", "Of something to add: show all fields"),
            ("esc", "Leave without a change"),
        ),
    ),
)


def screens() -> list[tuple[Action, ...]]:
    """Return the actions of the console, and of each screen that takes its place."""
    return [ACTIONS, *added("screens")]


def bindings(*groups: Group, actions: tuple[Action, ...] = ACTIONS) -> list[Any]:
    """Textual's key bindings of the actions in some groups, but for those whose keys are all taken."""
    return [Binding(a.keys, a.id, a.label, id=a.id, show=False) for a in actions if a.keys and a.group in groups]

"""What a console asks an engine about managed nodes, which there are, and any change of a node."""

from __future__ import annotations

import msgspec

from rsb_bridge.feature_api import TICKET_WITHIN, Command, Effect, Name, Reason, Right
from rsb_extras.node_control.change_records import NO_COMPONENT, ChangeAction, ChangeOutcome, Component, Managed
from rsb_extras.node_control.parameter_records import NewValues

LONGEST = 600.0
"""s that an operator waits at most; the change itself goes on. A round figure: Nav2 comes up within a minute."""
ANSWERED_WITHIN = TICKET_WITHIN + LONGEST + 5.0
"""s until an engine has answered a `ChangeNodes` for sure."""


class ManagedSide(msgspec.Struct, frozen=True, omit_defaults=True):
    """The managed nodes of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: why nothing is known of them, or empty.
    """

    link: Name = ""
    managed: Managed = Managed()
    problem: Reason = ""


class ListManaged(Command[tuple[ManagedSide, ...]], frozen=True, tag="list_managed"):
    """List managed nodes and groups of this side and of all links, without empty sides, or of one side."""

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    cancellable = True
    link: str = ""
    here: bool = False  # this side alone: no link is asked


class ChangeNodes(Command[ChangeOutcome], frozen=True, tag="change_nodes"):
    """Change the states of a node or of a group's nodes, a node's parameters, or a container; wait for the end.

    Attributes:
        link: whose other side has it, or empty for this side.
        values: to be set, if that is the action: all of them, or none; those of a component that is loaded.
        component: to be loaded or unloaded.
    """

    always = Effect.MOVES | Effect.LOSES
    refreshes = False
    target: str
    action: ChangeAction
    link: str = ""
    values: NewValues = ()
    component: Component = NO_COMPONENT

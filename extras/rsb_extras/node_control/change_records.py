"""Managed nodes, groups of nodes, and changes of them with their steps: their types have bounds, for links too."""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import PRINTABLE, Name, OrderOutcome, Reason, Seconds, Wording

MOST_GROUPS, MOST_OF_GROUP = 16, 32
"""Of a session, and nodes of one. Round figures: Nav2 manages 12."""
MOST_MANAGED = 64
"""Managed nodes in a list. A round figure, five times as many as Nav2 has."""
MOST_CONTAINERS, MOST_COMPONENTS = 16, 64
"""In a list, and nodes of one container. Round figures: Nav2's one container has 12."""
MOST_REMAPS = 32
MOST_STEPS = 2 * MOST_OF_GROUP
MOST_CHANGES = 12
"""In a list: a third of this side's, of other sides', and of those that have ended. A round figure."""
GROUP_NAME = re.compile(r"[A-Za-z0-9_-]{1,63}")
NODE_NAME = re.compile(r"/[A-Za-z0-9_/]{1,254}")

Transition: TypeAlias = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]
LifecycleAction: TypeAlias = Literal["up", "down", "configure", "activate", "deactivate", "cleanup", "shutdown"]
ComponentAction: TypeAlias = Literal["load", "unload"]
ChangeAction: TypeAlias = Literal[LifecycleAction, ComponentAction, "set"]
"""What a change does: with the states of nodes, the components of a container, or the parameters of a node."""
COMPONENT_ACTIONS: tuple[ComponentAction, ...] = get_args(ComponentAction)
Target: TypeAlias = Annotated[str, Meta(min_length=1, max_length=255, pattern=r"\A[A-Za-z0-9_/-]*\Z")]
"""A node's full name, or a group's, which has no slash."""
StateName: TypeAlias = Annotated[str, Meta(max_length=32, pattern=PRINTABLE)]
TRANSITIONS: tuple[Transition, ...] = get_args(Transition)
LIFECYCLE_ACTIONS: tuple[LifecycleAction, ...] = get_args(LifecycleAction)
GOALS: dict[str, str] = {
    "configure": "inactive", "activate": "active", "deactivate": "inactive", "cleanup": "unconfigured",
    "shutdown": "finalized", "up": "active", "down": "unconfigured",
}  # fmt: skip
"""The state to which each action leads (design.ros2.org, managed nodes)."""


class ManagedNode(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node with a lifecycle.

    Attributes:
        state: in ROS's words, or empty if it does not answer.
        offers: transitions that it offers in this state.
        allowed: whether the one who asks may ask for them.
    """

    name: Target
    state: StateName = ""
    offers: Annotated[tuple[Transition, ...], Meta(max_length=len(TRANSITIONS))] = ()
    allowed: bool = False


class ListedGroup(msgspec.Struct, frozen=True, omit_defaults=True):
    """Nodes that are brought up in this order, and down in the reverse one."""

    name: Target
    nodes: Annotated[tuple[Target, ...], Meta(max_length=MOST_OF_GROUP)] = ()
    allowed: bool = False


class Container(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node that loads components, and their nodes, by full names."""

    name: Target
    nodes: Annotated[tuple[Target, ...], Meta(max_length=MOST_COMPONENTS)] = ()
    answers: bool = True
    allowed: bool = False


class Component(msgspec.Struct, frozen=True, omit_defaults=True):
    """A component that a container loads; one that it unloads has its node's full name only.

    Attributes:
        name, namespace: of its node, or empty for its own.
        remaps: names, as ``from:=to``.
        intra_process: whether it hands messages to others of the container directly.
    """

    package: Name = ""
    plugin: Name = ""
    name: Name = ""
    namespace: Name = ""
    remaps: Annotated[tuple[Name, ...], Meta(max_length=MOST_REMAPS)] = ()
    intra_process: bool = False


NO_COMPONENT = Component()


class ChangeStep(msgspec.Struct, frozen=True, omit_defaults=True):
    """One node's answer to one step of a change.

    Attributes:
        what: the transition, "set" for parameters, "load" or "unload".
        state: afterwards, or empty if unknown.
        reason: why it is not done, for an operator, or empty.
        seconds: until the answer.
    """

    node: Target
    what: Name
    state: StateName = ""
    reason: Reason = ""
    seconds: Seconds = 0.0


class ChangeOutcome(OrderOutcome, frozen=True):
    """How a change goes, or has ended.

    Attributes:
        is_over: whether it has ended.
    """

    is_over: bool = True
    steps: Annotated[tuple[ChangeStep, ...], Meta(max_length=MOST_STEPS)] = ()

    @property
    def done(self) -> bool:
        return self.is_over and super().done


class NodeChange(msgspec.Struct, frozen=True, omit_defaults=True):
    """A change that is under way, or one of the last that have ended."""

    target: Target
    action: ChangeAction
    outcome: ChangeOutcome = ChangeOutcome()


class Managed(msgspec.Struct, frozen=True, omit_defaults=True):
    """The managed nodes, groups and containers of one side, and what is or was done with them, the newest last."""

    nodes: Annotated[tuple[ManagedNode, ...], Meta(max_length=MOST_MANAGED)] = ()
    groups: Annotated[tuple[ListedGroup, ...], Meta(max_length=MOST_GROUPS)] = ()
    changes: Annotated[tuple[NodeChange, ...], Meta(max_length=MOST_CHANGES)] = ()
    containers: Annotated[tuple[Container, ...], Meta(max_length=MOST_CONTAINERS)] = ()

    @property
    def targets(self) -> tuple[ListedGroup | ManagedNode, ...]:
        """All whose states can be changed."""
        return *self.groups, *self.nodes


class ChangeText(Wording):
    """Changes in words."""

    DONE = "{action}: done in {seconds:.1f} s"
    NOTHING = "{action}: nothing to do"
    UNDER_WAY = "{action} under way for {seconds:.0f} s"
    NOT_DONE = "{action}: {reason}"
    STEP = "{node}  {what}  {result}  {seconds:.1f} s"

    @classmethod
    def of(cls, action: str, outcome: ChangeOutcome) -> str:
        """Return how a change goes or has ended."""
        if not outcome.is_over:
            return cls.UNDER_WAY(action=action, seconds=outcome.seconds)
        if outcome.reason:
            return cls.NOT_DONE(action=action, reason=outcome.reason)
        return (cls.DONE if outcome.steps else cls.NOTHING)(action=action, seconds=outcome.seconds)

    @classmethod
    def of_step(cls, step: ChangeStep) -> str:
        result = step.reason or step.state or "done"
        return cls.STEP(node=step.node, what=step.what, result=result, seconds=step.seconds)

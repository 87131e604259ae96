"""A change from robot to robot, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_console.fleet.rolling import Outcome, Rollout, Step


def said(step: Step) -> str:
    """What a step would change, in words."""
    return step.problem or ", ".join(step.changes) or "nothing to change"


def report(rollout: Rollout, outcome: Outcome) -> Iterator[str]:
    """Where a change has stopped, and why; what is done, and what is not."""
    if outcome.failed is not None:
        has_it = f"it has {' '.join(rollout.keys)}" if outcome.was_changed else "it is as it was"
        yield f"stopped at {outcome.failed.name}: {outcome.why} ({has_it})"
    else:
        yield f"stopped: {outcome.why}"
    yield f"done: {names_of(outcome.done) or 'none'}"
    yield f"not begun: {names_of(outcome.left) or 'none'}"


def way_back(rollout: Rollout, outcome: Outcome, file: str = "FILE") -> Iterator[str]:
    """The commands that put back what was before; `file` is the fleet file, for robots over Zenoh."""
    over = f" --fleet {file}" if any(step.robot.source.kind == "fleet" for step in outcome.changed) else ""
    by_keys: dict[str, list[str]] = {}
    for step in outcome.changed:
        by_keys.setdefault(" ".join(step.back(rollout.keys)), []).append(step.name)
    for keys, names in by_keys.items():
        yield f"to go back: rsb-console fleet edit {' '.join(names)} {rollout.topic} {keys}{over}"


def names_of(steps: Sequence[Step]) -> str:
    """The robots' names."""
    return ", ".join(step.name for step in steps)

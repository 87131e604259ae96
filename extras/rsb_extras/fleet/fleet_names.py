"""Names of robots that complete arguments. On any error nothing is offered: a shell has no place for a message then."""

from __future__ import annotations

from rsb_extras.fleet.fleet import Memory, memory_path


def robots(**_: object) -> list[str]:
    """Return the robots of fleets that this user has seen."""
    return sorted({robot.name for robot in Memory(memory_path()).all()})


def groups(**_: object) -> list[str]:
    return sorted({robot.group for robot in Memory(memory_path()).all()} - {""})

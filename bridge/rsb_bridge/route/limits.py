"""What operators limit on a route, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.session import priority_of

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import Propose


def limits_changed(old: Propose, new: Propose) -> str:
    """What differs between the limits of two proposals, for an operator."""
    limits = (
        ("max_rate", old.max_rate or None, new.max_rate or None, " Hz"),
        ("expected_rate", old.expected_rate or None, new.expected_rate or None, " Hz"),
        ("stale_after", old.stale_after, new.stale_after, " s"),
        ("late_after", old.late_after, new.late_after, " s"),
        ("max_age", old.max_age, new.max_age, " s"),
    )
    changed = [
        f"{name} {_figure(before, unit)} → {_figure(after, unit)}"
        for name, before, after, unit in limits
        if before != after
    ]
    before, after = priority_of(old.priority), priority_of(new.priority)
    return ", ".join(changed + ([f"priority {before} → {after}"] if before != after else []))


def _figure(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:g}{unit}"

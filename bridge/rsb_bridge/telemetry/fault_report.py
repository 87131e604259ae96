"""The JSON object by which a session's `on_fault` command gets a fault's change."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import REASON_LENGTH, TEXT_LENGTH
from rsb_bridge.model.snapshot import LinkSnapshot, PatternSnapshot
from rsb_bridge.model.text import encodable, sanitize_text

if TYPE_CHECKING:
    from rsb_bridge.model.faults import FaultChange

VERSION = 1
"""Grows when a field is removed or changes its meaning; a new field does not change it."""
REMOVED = "removed"
"""State of a link, a route or a pattern that was removed."""


def fault_report(change: FaultChange, *, time: float, bridge: str, role: str, ongoing: int, merged: int) -> bytes:
    """Encode a change as one line of ASCII.

    Texts are cut and cleaned of control characters, since some come from the other side.

    Args:
        change: to report.
        time: s since the epoch.
        bridge: the session's name.
        role: ``client`` or ``server``.
        ongoing: number of faults that are reported and not over, this one included.
        merged: number of earlier changes for which no command was run.
    """
    subject = change.subject
    content: dict[str, object] = {
        "version": VERSION,
        "event": change.kind,
        "time": round(time, 3),
        "bridge": _text(bridge),
        "role": role,
    }
    if isinstance(subject, LinkSnapshot):
        content |= {"what": "link", "kind": "link", "name": _text(subject.name), "link": _text(subject.name)}
        text, from_peer, since = subject.reason or subject.warning, False, subject.fault_since
    elif isinstance(subject, PatternSnapshot):
        sends = (subject.spec.direction == "transmit") == (role == "client")
        content |= {"what": "pattern", "kind": subject.spec.kind, "name": _text(subject.spec.topic)}
        content |= {"link": _text(subject.link), "outgoing": sends}
        text, from_peer, since = subject.reason, False, change.seen
    else:
        content |= {"what": "route", "kind": subject.spec.kind, "name": _text(subject.topic)}
        content |= {"link": _text(subject.link), "outgoing": subject.outgoing}
        text, from_peer, since = subject.reason, subject.from_peer, subject.since
    state, cause = (REMOVED, "") if change.removed else (str(subject.state), subject.cause)
    content |= {
        "state": _text(state),
        "cause": _text(cause),
        "text": "" if change.removed else _text(text, REASON_LENGTH),
        "since": round(time if change.removed else since, 3),
        "from_peer": from_peer,
        "previous_state": _text(change.before[0]),
        "previous_cause": _text(change.before[1]),
        "ongoing": ongoing,
        "merged": merged,
    }
    return json.dumps(content).encode("ascii") + b"\n"


def _text(text: str, limit: int = TEXT_LENGTH) -> str:
    return sanitize_text(encodable(text), limit)

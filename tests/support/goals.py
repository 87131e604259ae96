"""An action's serialized messages as rcl makes them, without rclpy: of any action whose goals have no fields."""

from __future__ import annotations

import struct

_HEADERS = {"<": b"\0\1\0\0", ">": b"\0\0\0\0"}
STATES = {"unknown": 0, "accepted": 1, "executing": 2, "canceling": 3, "succeeded": 4, "canceled": 5, "aborted": 6}


def goal(number: int) -> bytes:
    """A goal's id."""
    return number.to_bytes(16, "big")


def goal_request(goal_id: bytes, order: str = "<", fields: bytes = b"") -> bytes:
    """A send_goal or get_result request, or a feedback message."""
    return _HEADERS[order] + goal_id + fields


def goal_response(accepted: bool, order: str = "<") -> bytes:
    return _HEADERS[order] + struct.pack(f"{order}?3xiI", accepted, 1700000000, 5)


def cancel_request(goal_id: bytes = bytes(16), seconds: int = 0, order: str = "<") -> bytes:
    return _HEADERS[order] + goal_id + struct.pack(f"{order}iI", seconds, 0)


def cancel_response(*canceling: bytes, order: str = "<") -> bytes:
    goals = b"".join(each + struct.pack(f"{order}iI", 1700000000, 5) for each in canceling)
    return _HEADERS[order] + struct.pack(f"{order}b3xI", 0 if canceling else 1, len(canceling)) + goals


def result_response(state: str, fields: bytes = b"", order: str = "<") -> bytes:
    return _HEADERS[order] + bytes((STATES[state],)) + fields


def statuses(*goals: tuple[bytes, str], order: str = "<") -> bytes:
    body = bytearray(struct.pack(f"{order}I", len(goals)))
    for goal_id, state in goals:
        body += goal_id
        body += bytes(-len(body) % 4)
        body += struct.pack(f"{order}iIb", 1700000000, 5, STATES[state])
    return _HEADERS[order] + body

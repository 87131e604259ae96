"""Helpers of `test_arming` and others."""

from __future__ import annotations

from dataclasses import replace

from tests.console.scripted import route

from rsb_bridge.model.snapshot import ArmingSnapshot, State

DISARMED = route(
    "/cmd_vel", State.DISARMED, outgoing=True, reason="not armed", cause="disarmed", rate=0.0,
    arming=ArmingSnapshot(armed=False, deadman=60.0),
)  # fmt: skip


ARMED = replace(
    DISARMED, state=State.OK, reason="", cause="",
    arming=ArmingSnapshot(armed=True, by="robot1 says: anna (uid 1000)", here=True, left=42.0, deadman=60.0),
)  # fmt: skip

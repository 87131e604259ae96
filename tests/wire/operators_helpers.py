"""Helpers of `test_operators` and others."""

from __future__ import annotations

from tests.wire.links import KEY, the

from rsb_bridge.wire.connection import (
    OperatorConsole,
    OperatorEngine,
)
from rsb_bridge.wire.events import Admitted, RefusalCode
from rsb_bridge.wire.preamble import (
    Refusal,
)
from rsb_bridge.wire.sealed_stream import Credential, ReplayCache

VERSION = 7


def make_console(
    *, operator: str = "anna", key: bytes = KEY, engine: str = "robot1", version: int = VERSION, host: str = "pc"
) -> OperatorConsole:
    return OperatorConsole(operator, key, engine, version=version, host=host)


def make_engine(*, name: str = "robot1", key: bytes = KEY) -> OperatorEngine:
    replays = ReplayCache()

    def identity(operator: str) -> Credential:
        if operator != "anna":
            raise Refusal(RefusalCode.UNKNOWN_NAME, f"no operator {operator!r}")
        return Credential((key,), replays)

    return OperatorEngine(name, identity)


def attached() -> tuple[OperatorConsole, OperatorEngine]:
    console, engine = make_console(), make_engine()
    assert engine.receive_data(console.start()) == []
    the(Admitted, console.receive_data(engine.data_to_send()))
    the(Admitted, engine.receive_data(console.data_to_send()))
    return console, engine

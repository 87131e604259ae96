"""Tells the peer of a link about this machine, and keeps what the peer tells about its own."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Extension, Level
from rsb_extras.machine_state.machine_figures import MACHINE, MachineFault, MachineJudge, MachineState, shown
from rsb_extras.machine_state.machine_reading import EVERY, MachineWatch

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.feature_api import Link

_SHOWN_FOR = 3 * EVERY
"""s for which a report is shown: a peer that reads its machine no longer, or a lost link, leaves no old figures."""


class MachineCode(StrEnum):
    FAULT = "machine.fault"
    RECOVERED = "machine.recovered"


class LinkMachine(Extension):
    """The machine at the other end of a link."""

    def __init__(self, link: Link) -> None:
        self.messages = {MachineState: self._received}
        self._link = link
        self._watch = link.context.shared(MachineWatch)
        self._sends = False
        self._sent = 0  # number of the last reading that the peer has
        self._state: MachineState | None = None
        self._heard = 0.0
        self._judge = MachineJudge()

    def connected(self) -> None:
        self._sends, self._sent = True, 0

    def disconnected(self) -> None:
        self._sends = False
        self._state, self._judge = None, MachineJudge()

    def suspend(self) -> None:
        self._sends = False  # no old figures wait for the next connection

    def resume(self) -> None:
        self._sends = True

    def tick(self) -> None:
        if self._state is not None and self._link.context.now() - self._heard > _SHOWN_FOR:
            self._state, self._judge = None, MachineJudge()
        if not self._sends:
            return
        self._watch.look()
        if self._watch.newest is not None and self._watch.number != self._sent:
            self._sent = self._watch.number
            self._link.send(self._watch.newest)

    def link_fields(self) -> Mapping[str, Any]:
        return {} if self._state is None else {MACHINE.name: shown(self._state, self._judge.wrong)}

    def _received(self, state: MachineState) -> None:
        before = self._judge.wrong
        self._judge.take(state)
        self._state, self._heard = state, self._link.context.now()
        for cause in self._judge.wrong:
            if cause not in before:
                text = MachineFault.of(cause, state)
                self._link.log_of_peer(Level.WARNING, MachineCode.FAULT, text)
        for cause in before:
            if cause not in self._judge.wrong:
                self._link.log_of_peer(Level.INFO, MachineCode.RECOVERED, f"its machine recovered: {cause}")

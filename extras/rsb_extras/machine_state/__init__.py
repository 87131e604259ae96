"""Machine state: the load, memory, disks and temperature of the other side's machine, on the page of the link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    import msgspec

    from rsb_bridge.feature_api import Extension, Link
    from rsb_console.feature_console import LinkFact


class MachineStateFeature(Feature):
    name = "machine_state"

    def messages(self) -> Iterable[type[msgspec.Struct]]:
        from rsb_extras.machine_state.machine_figures import MachineState  # noqa: PLC0415 -- `Feature` says why, below too

        return (MachineState,)

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.machine_state.link_machine import LinkMachine  # noqa: PLC0415

        return (LinkMachine(link),)

    def link_facts(self) -> Iterable[LinkFact]:
        from rsb_extras.machine_state.machine_lines import FACT  # noqa: PLC0415

        return (FACT,)


FEATURE = MachineStateFeature()

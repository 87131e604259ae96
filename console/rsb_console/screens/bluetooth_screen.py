"""Bluetooth: adapters, devices to pick a server from, and which channels are taken."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.containers import Vertical
from textual.screen import ModalScreen

from rsb_bridge.bluetooth.hci import ANY_ADAPTER, Adapter
from rsb_bridge.bluetooth.scan import ChannelUse, Scan, held_channels, scan
from rsb_console.widgets.form import Notice
from rsb_console.widgets.key_hints import KeyHints
from rsb_console.widgets.lines import FixedLines, Line, fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

    from rsb_bridge.bluetooth.bluez import Device
    from rsb_console.console_api import Console

CHANNELS_A_LINE = 15  # half of them, so that two lines fit 80 columns
SIGNS = {ChannelUse.FREE: ("·", "dim"), ChannelUse.BUSY: ("✗", "down"), ChannelUse.OWN: ("●", "ok")}


class Machines(SelectableList):
    """One line for each adapter or device."""

    sticky = 1

    def __init__(self) -> None:
        super().__init__(id="machines")
        self.display = False
        self._machines: dict[str, Adapter | Device] = {}

    def show(self, found: Scan) -> None:
        machines: list[Adapter | Device] = [*found.adapters, *found.devices]
        self._machines = {one.address: one for one in machines}
        self.show_keys(list(self._machines))
        self.display = bool(found.adapters)
        self.styles.height = max(2, min(self.line_count, 10))

    @property
    def selected(self) -> Adapter | Device | None:
        return None if self.cursor_key is None else self._machines[self.cursor_key]

    def line(self, index: int) -> Line:
        if index < self.sticky:
            return ((f"   {'MAC':<18} {'':<8} {'STATE':<18} NAME", "head"),)
        one = self._machines[self.keys[index - self.sticky]]
        if isinstance(one, Adapter):
            sign, kind, name = ("●", "ok") if one.powered else ("✗", "down"), one.name, one.alias
            state = "on" if one.powered else "off"
        else:
            sign, kind, name = ("◆", "waiting") if one.connected else ("·", "dim"), "device", one.name
            state = ", ".join(word for word in ("paired", "connected") if getattr(one, word))
        return fit(
            (
                ("▌" if self.is_cursor(index) else " ", "key"),
                (f"{sign[0]} ", sign[1]),
                (f"{one.address:<18} ", "strong"),
                (f"{kind:<8} {state:<18} ", ""),
                (name, ""),
            ),
            self.size.width,
        )


class Channels(FixedLines):
    """Channels 1-30 of each adapter: free, busy, or this bridge's own."""

    def __init__(self) -> None:
        super().__init__(id="channels")
        self.display = False

    def show(self, found: Scan) -> None:
        self.display = bool(found.channels)
        self.put(list(_channel_lines(found)) if found.channels else [])


def _channel_lines(found: Scan) -> Iterator[Line]:
    names = {one.address: one.name for one in found.adapters} | {ANY_ADAPTER: "any"}
    yield (
        ("   CHANNELS    ", "head"),
        *((piece, look) for use in ChannelUse for piece, look in (SIGNS[use], (f" {use.value}  ", "dim"))),
    )
    for address, uses in found.channels.items():
        numbers = list(uses)
        for at in range(0, len(numbers), CHANNELS_A_LINE):
            row = numbers[at : at + CHANNELS_A_LINE]
            cells = [piece for number in row for piece in ((f"{number:>3}", "dim"), SIGNS[uses[number]])]
            yield ((f"   {names.get(address, address) if at == 0 else '':<8} ", "strong"), *cells)


class BluetoothScreen(ModalScreen[str | None]):
    """Scans at once, and returns the picked MAC address."""

    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss", show=False),
        Binding("enter", "pick", show=False),
        Binding("s,f5", "scan", show=False),
    ]

    def __init__(self, console: Console) -> None:
        super().__init__()
        self.console = console
        self.machines, self.channels = Machines(), Channels()
        self._problems, self._state, self._keys = Notice("problem"), Notice("hint"), KeyHints("")

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -wide") as dialog:
            dialog.border_title = "Bluetooth"
            yield self.machines
            yield self.channels
            yield self._problems
            yield self._state
            yield self._keys

    def on_mount(self) -> None:
        self.action_scan()

    @work(exclusive=True)
    async def action_scan(self) -> None:
        self._state.set_text("scanning …")
        engine = self.console.engine
        # A channel that this process listens on looks like one that another program has taken.
        own = held_channels(engine.session, engine.snapshot()) if engine is not None else set()
        # In a thread, with a loop of its own: the scan opens sockets, reads files, and waits up to 5 s for BlueZ.
        found = await asyncio.to_thread(lambda: asyncio.run(scan(own_channels=own)))
        is_unpaired = bool(found.adapters) and not found.devices
        self._state.set_text("No paired device: bluetoothctl pairs them." if is_unpaired else "")
        self._problems.set_text("\n".join(found.problems))
        pick = "⏎ use as the server of a new session   " if found.adapters and not self.console.readonly else ""
        self._keys.say(f"{pick}s scan again   esc close")
        self.machines.show(found)
        self.channels.show(found)

    def action_pick(self) -> None:
        machine = self.machines.selected
        if machine is not None and not self.console.readonly:
            self.dismiss(machine.address)

"""The machine at the other end of a link: what a side reads of its own, tells, takes from the peer, and shows."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.driving import NARROW, on_main, put, shown, text
from tests.console.scripted import LINK
from tests.link.foreign_proposals_helpers import rogue
from tests.support.bridge import happened
from tests.support.waiting import eventually
from tests.wire.document_helpers import documented_fields

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.messages import Ping
from rsb_bridge.wire.protocol_error import Broken
from rsb_extras import machine_state
from rsb_extras.machine_state import machine_reading
from rsb_extras.machine_state.link_machine import MachineCode
from rsb_extras.machine_state.machine_figures import MACHINE, MachineCause, MachineFault, MachineJudge, MachineState
from rsb_extras.machine_state.machine_figures import shown as as_shown
from rsb_extras.machine_state.machine_reading import EVERY, MachineWatch, read_machine

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine
    from textual.pilot import Pilot

    from rsb_bridge.engine import Engine
    from rsb_console.app import ConsoleApp
    from rsb_extras.machine_state.machine_figures import ShownMachine

PAGE = Path(machine_state.__file__).with_name("docs") / "machine-state.md"
FINE = MachineState(4, 1.7, 61, 8200, 42, 71, 9300, "/", 52)
BUSY = msgspec.structs.replace(FINE, cpu=100)
FULL = msgspec.structs.replace(FINE, disk=100, disk_mb=0, disk_path="/var/log")


def of_peer(engine: Engine) -> ShownMachine | None:
    (link,) = engine.snapshot().links
    return MACHINE.of(link)


def test_the_page_documents_each_field() -> None:
    found = {each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in (MachineState,)}
    assert documented_fields(PAGE.read_text(encoding="utf-8").partition("## Protocol")[2]) == found


# -- this machine


def written(root: Path, stat: str, temperature: str = "52300\n") -> Path:
    """Write what a kernel shows of two processors, 1 GB of memory, a full disk and others that do not count."""
    mounts = (
        f"/dev/sda1 {root} ext4 rw,relatime 0 0\n"
        "/dev/loop3 /snap/core squashfs ro,nodev 0 0\n"  # always full, and nothing writes there
        "server:/home /no/such nfs4 rw 0 0\n"
        "proc /proc proc rw 0 0\n"
    )
    texts = {
        "proc/stat": stat,
        "proc/loadavg": "3.25 1.00 0.50 2/100 4242\n",
        "proc/meminfo": "MemTotal: 1000000 kB\nMemFree: 1 kB\nMemAvailable: 250000 kB\n",
        "proc/self/mounts": mounts,
        "sys/class/thermal/thermal_zone0/temp": temperature,
        "sys/class/thermal/thermal_zone1/temp": "-274000\n",
    }
    for name, each in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(each)
    return root


def test_a_machine_is_read_from_the_kernel(tmp_path: Path) -> None:
    state, counts = read_machine(None, written(tmp_path, "cpu  100 0 100 700 100 0 0 0 0 0\ncpu0 1\n"))
    assert (state.load, state.memory, state.memory_mb, state.cpu, state.temperature) == (3.25, 75, 1024, None, 52)
    assert state.disk_path == str(tmp_path)[:64]
    written(tmp_path, "cpu  190 0 160 750 100 0 0 0 0 0\n", "")  # 150 of 200 ticks; the sensor fails
    state, _ = read_machine(counts, tmp_path)
    assert (state.cpu, state.temperature) == (75, None)


def test_this_machine_is_read() -> None:
    state, counts = read_machine(None)
    again, _ = read_machine(counts)
    assert state.cores == os.cpu_count()
    assert state.memory_mb > 100
    assert again.cpu is not None
    assert len(encode(again)) < 200


def test_a_disk_that_hangs_keeps_one_thread_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """It must hold up neither the engine's end nor the pool that loads types."""
    answers, clock = threading.Event(), [0.0]
    monkeypatch.setattr(machine_reading, "read_machine", lambda _: answers.wait())

    async def look_for_minutes() -> None:
        context: Any = SimpleNamespace(now=lambda: clock[0], loop=asyncio.get_running_loop())
        watch = MachineWatch(context)
        for _ in range(20):
            watch.look()
            await asyncio.sleep(0)
            clock[0] += EVERY

    asyncio.run(look_for_minutes())
    assert [each.name for each in threading.enumerate()].count("machine") == 1
    answers.set()


# -- what is wrong


def test_a_short_load_is_no_fault_and_a_fault_does_not_flicker() -> None:
    judge = MachineJudge()

    def after(*states: MachineState) -> tuple[MachineCause, ...]:
        for state in states:
            judge.take(state)
        return judge.wrong

    assert after(FINE, BUSY, BUSY, FINE, BUSY, BUSY) == ()
    assert after(BUSY) == (MachineCause.CPU,)
    assert after(msgspec.structs.replace(FINE, cpu=92)) == (MachineCause.CPU,)
    assert after(msgspec.structs.replace(FINE, cpu=None)) == (MachineCause.CPU,)
    assert after(FINE) == ()
    assert after(FULL) == (MachineCause.DISK,)
    assert after(msgspec.structs.replace(FINE, disk=96)) == (MachineCause.DISK,)
    assert after(msgspec.structs.replace(FINE, memory=99, temperature=90)) == (MachineCause.MEMORY, MachineCause.HOT)


def test_path_of_the_peer_is_one_word_of_a_command() -> None:
    state = msgspec.structs.replace(FULL, disk_path="/var; reboot")
    assert MachineFault.of(MachineCause.DISK, state).endswith("(du -xh '/var; reboot')")
    assert MachineFault.of(MachineCause.DISK, FULL).endswith("(du -xh /var/log)")


# -- two sides


def test_both_sides_show_each_others_machine(bridge: Bridge, machine: Machine, ran: Callable[..., Ran]) -> None:
    server, client = bridge.both()
    eventually(lambda: of_peer(server) is not None and of_peer(client) is not None, what="figures of both")
    figures = of_peer(client)
    assert figures is not None
    assert figures.cores == os.cpu_count()
    machine.serve(client)
    (link,) = ran("status", "--json").json["links"].values()
    assert link["machine"]["cores"] == os.cpu_count()
    assert {"cpu", "load", "memory", "disk", "temperature", "wrong"} <= link["machine"].keys()
    server.stop()
    eventually(lambda: of_peer(client) is None, what="no figures of a lost link")


def test_a_side_without_the_feature_gets_and_shows_nothing(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge) as client:
        for _ in range(5):  # one a second
            assert isinstance(client.wait_for(Ping, MachineState), Ping)
        assert of_peer(server) is None


def test_a_full_machine_there_is_said_here(bridge: Bridge, machine: Machine, ran: Callable[..., Ran]) -> None:
    server = bridge.server()
    machine.serve(server)
    with rogue(bridge) as client:
        for _ in range(3):
            client.say(BUSY)
        eventually(partial(happened, server, MachineCode.FAULT, "its processors are at 100 %"), what="an event")
        eventually(
            lambda: (known := of_peer(server)) is not None and known.wrong == (MachineCause.CPU,), what="a snapshot"
        )
        assert "    ! its processors are at 100 %: end what takes them there (top)" in ran("status").out
        client.say(FULL)
        eventually(partial(happened, server, MachineCode.FAULT, "its disk is 100 % full at /var/log"), what="another")
        assert happened(server, MachineCode.RECOVERED, "cpu")
        assert not server.snapshot().links[0].reason


@pytest.mark.parametrize("broken", [{"cpu": 101}, {"disk_path": "/\x1b[2J"}, {"disk_path": "x" * 65}, {"load": -1.0}])
def test_figures_out_of_bounds_end_the_link(bridge: Bridge, broken: dict[str, object]) -> None:
    server = bridge.server()
    with rogue(bridge) as client:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        client.say(msgspec.structs.replace(FINE, **broken))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)
        assert of_peer(server) is None


# -- on the screen


@on_main(NARROW)
async def test_the_links_page_shows_the_machine(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, features={MACHINE.name: as_shown(FULL, (MachineCause.DISK,))}),))
    await pilot.press("c", "enter")
    await shown(pilot, "processors 42 %, load 1.7 on 4 processors, 52 °C")
    await shown(pilot, "memory 61 % of 8.2 GB, disk /var/log 100 %, 0 B left")
    lines = [line.strip(" │") for line in text(app).splitlines()]
    fault = next(number for number, line in enumerate(lines) if line.startswith("! "))
    assert "its disk is 100 % full at /var/log: make room there (du -xh" in lines[fault]
    assert fault < next(number for number, line in enumerate(lines) if line.startswith("peer"))

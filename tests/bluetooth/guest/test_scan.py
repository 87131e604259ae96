"""The scan against the real kernel and BlueZ: in the machine only."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support import constants
from tests.support.wording import says

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.bluez import BluezProblem, read_bluez
from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS, NoBluetooth
from rsb_bridge.bluetooth.scan import ChannelUse, Scan, ScanProblem, scan
from rsb_console.command.bt_scan import run_bt_scan

from .conftest import holding, wait_until


def look(adapter: str | None = None, own: tuple[tuple[str, int], ...] = ()) -> Scan:
    return asyncio.run(scan(adapter, own))


def busy(found: Scan, address: str) -> set[int]:
    return {number for number, use in found.channels[address].items() if use is ChannelUse.BUSY}


def test_adapters_are_those_of_bluez(addresses: tuple[str, str]) -> None:
    adapters, _ = asyncio.run(read_bluez())
    found = look()
    assert list(found.adapters) == adapters
    assert [one.name for one in found.adapters] == ["hci0", "hci1"]
    assert tuple(one.address for one in found.adapters) == addresses
    assert all(one.powered and one.alias for one in found.adapters)
    assert found.problems == ()
    assert found.usable


def test_exactly_the_held_channels_are_busy(addresses: tuple[str, str]) -> None:
    first, second = addresses
    before = look()
    assert all(not busy(before, address) for address in (first, second, ANY_ADAPTER))
    held = [
        (first, 1, "bound"),
        (first, 3, "listen"),
        (first, 30, "listen"),
        (second, 20, "listen"),
        (ANY_ADAPTER, 12, "listen"),
    ]
    with holding(*held):
        found = look()
    assert busy(found, first) == {1, 3, 30}
    assert busy(found, second) == {20}
    assert busy(found, ANY_ADAPTER) == {12}
    assert all(set(found.channels[address]) == set(CHANNELS) for address in (first, second, ANY_ADAPTER))
    assert look().channels == before.channels


def test_own_channels_are_told_apart(addresses: tuple[str, str]) -> None:
    first, _ = addresses
    with hci.rfcomm_socket() as own, holding((first, 5, "listen")):
        own.bind((first, 4))
        own.listen(1)
        found = look(own=((first.lower(), 4),))
    assert found.channels[first][4] is ChannelUse.OWN
    assert busy(found, first) == {5}


@pytest.mark.parametrize("name", ["hci1", "HCI1", "address"])
def test_one_adapter_by_name_or_address(addresses: tuple[str, str], name: str) -> None:
    found = look(addresses[1].lower() if name == "address" else name)
    assert [one.name for one in found.adapters] == ["hci1"]
    assert list(found.channels) == [addresses[1], ANY_ADAPTER]


def test_unknown_adapter_is_named_with_those_there_are(addresses: tuple[str, str]) -> None:
    found = look("hci7")
    assert found.problems == (
        ScanProblem.ADAPTER_UNKNOWN(adapter="hci7", known=f"hci0 ({addresses[0]}), hci1 ({addresses[1]})"),
    )
    assert not found.usable


def test_devices_are_listed_on_their_adapters(addresses: tuple[str, str]) -> None:
    """Both adapters have the same BlueZ, so each lists the other; the kernel pairs them without asking."""
    first, second = addresses
    wait_until(lambda: not look().devices, "earlier links are down")
    with hci.rfcomm_socket() as listener, hci.rfcomm_socket() as client:
        listener.bind((first, 8))
        listener.listen(1)
        client.connect((first, 8))
        wait_until(lambda: [one.paired for one in look().devices] == [True, True], "both ends list the other")
        found = look()
        assert [(one.adapter, one.address, one.connected) for one in found.devices] == [
            ("hci0", second, True),
            ("hci1", first, True),
        ]
        assert [one.adapter for one in look("hci1").devices] == ["hci1"]


@pytest.fixture
def second_off() -> Iterator[None]:
    """hci1 switched off by BlueZ."""
    _set_power("hci1", "false")
    wait_until(lambda: not hci.adapters()[1].powered, "hci1 off")
    yield
    _set_power("hci1", "true")
    wait_until(lambda: hci.adapters()[1].powered, "hci1 on")


def _set_power(adapter: str, value: str) -> None:
    call = f"/org/bluez/{adapter} org.freedesktop.DBus.Properties.Set string:org.bluez.Adapter1 string:Powered"
    command = ["dbus-send", "--system", "--print-reply", "--dest=org.bluez", *call.split(), f"variant:boolean:{value}"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def test_switched_off_adapter_says_how_to_switch_on(second_off: None) -> None:
    found = look()
    assert [one.powered for one in found.adapters] == [True, False]
    assert found.problems == (ScanProblem.SWITCHED_OFF(adapter="hci1"),)
    assert found.usable
    assert not look("hci1").usable


@pytest.fixture
def second_blocked() -> Iterator[None]:
    """hci1 blocked as `rfkill block` does it."""
    (switch,) = Path("/sys/class/bluetooth/hci1").glob("rfkill*/soft")
    switch.write_text("1")
    wait_until(lambda: not hci.adapters()[1].powered, "hci1 off")
    yield
    switch.write_text("0")
    wait_until(lambda: hci.adapters()[1].powered, "hci1 on")


def test_a_blocked_adapter_says_how_to_unblock_it(second_blocked: None) -> None:
    assert look("hci1").problems == (ScanProblem.SOFT_BLOCKED(adapter="hci1"),)


_SCAN_AS_USER = """
import asyncio, os
from rsb_bridge.bluetooth.scan import scan
os.setgroups([]); os.setgid(1000); os.setuid(1000)
found = asyncio.run(scan())
print(found.usable, found.problems, *found.channels)
"""


def scan_as_user() -> str:
    return subprocess.run([sys.executable, "-c", _SCAN_AS_USER], capture_output=True, text=True, check=True).stdout


def test_an_ordinary_user_may_scan(addresses: tuple[str, str]) -> None:
    assert scan_as_user() == f"True () {addresses[0]} {addresses[1]} {ANY_ADAPTER}\n"


@pytest.fixture
def bluez_forbidden() -> Iterator[None]:
    """The bus does not let the user "operator" talk to BlueZ."""
    rule = Path("/etc/dbus-1/system.d/forbidden.conf")
    rule.write_text('<busconfig><policy user="operator"><deny send_destination="org.bluez"/></policy></busconfig>')
    _reload_bus()
    yield
    rule.unlink()
    _reload_bus()


def _reload_bus() -> None:
    command = "dbus-send --system --print-reply --dest=org.freedesktop.DBus / org.freedesktop.DBus.ReloadConfig"
    subprocess.run(command.split(), check=True, stdout=subprocess.DEVNULL)


def test_user_without_rights_on_bluez_is_told_group(bluez_forbidden: None) -> None:
    printed = scan_as_user()
    assert printed.startswith("True ")
    assert says(printed, BluezProblem.BLUEZ_FORBIDDEN)


def test_without_dbus_the_kernel_is_asked(addresses: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nonexistent")
    with holding((addresses[0], 2, "listen")):
        found = look()
    assert [(one.name, one.address, one.powered) for one in found.adapters] == [
        ("hci0", addresses[0], True),
        ("hci1", addresses[1], True),
    ]
    assert busy(found, addresses[0]) == {2}
    assert says(found.problems[0], BluezProblem.NO_DBUS)
    assert found.usable


def test_a_python_without_bluetooth_lists_adapters_only(
    addresses: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(socket, "AF_BLUETOOTH")
    found = look()
    assert tuple(one.address for one in found.adapters) == addresses
    assert found.channels == {}
    assert NoBluetooth.NOT_IN_PYTHON() in found.problems[0]
    assert not found.usable


_BUS = """<busconfig><listen>unix:path={path}</listen>
<policy context="default"><allow send_destination="*"/><allow own="*"/>{rule}</policy></busconfig>"""


@pytest.mark.parametrize(
    ("rule", "code"), [('<allow receive_sender="*"/>', BluezProblem.BLUEZ_STOPPED), ("", BluezProblem.BLUEZ_SILENT)]
)
def test_a_bus_without_bluez(rule: str, code: ScanProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A D-Bus daemon of the test's own, where nobody is org.bluez, and one that keeps its answers to itself."""
    config, path = tmp_path / "bus.conf", tmp_path / "bus"
    config.write_text(_BUS.format(path=path, rule=rule))
    with subprocess.Popen(["dbus-daemon", f"--config-file={config}", "--nofork"]) as bus:
        wait_until(path.exists, "the bus is up")
        monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", f"unix:path={path}")
        constants.BLUEZ_ANSWERS_WITHIN.set(monkeypatch, 0.5)
        found = look()
        bus.terminate()
    assert says(found.problems[0], code)
    assert found.usable


def test_what_the_command_prints(addresses: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    first, second = addresses
    with holding((first, 2, "listen"), (first, 3, "listen"), (ANY_ADAPTER, 30, "listen")):
        assert run_bt_scan(None, as_json=False) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [" ".join(line.split()[:3]) for line in lines[:6:2]] == [
        f"hci0 {first} on",
        f"hci1 {second} on",
        f"any {ANY_ADAPTER}",
    ]
    assert [line.strip() for line in lines[1:6:2]] == ["busy: 2-3", "busy: none", "busy: 30"]
    assert lines[6].endswith(": 1, 4-29")

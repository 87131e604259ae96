"""Keys, links and Bluetooth: what an operator compares, never the key itself."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from tests.console.driving import NARROW, WIDE, engine_of, fill, form_of, gone, on_main, put, shown, text, until
from tests.console.scripted import LINK, SESSION
from tests.support import replaced
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.bluetooth.bluez import Device
from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS, Adapter
from rsb_bridge.bluetooth.scan import ChannelUse, Scan
from rsb_bridge.config.keys import fingerprint, read_key, write_key
from rsb_bridge.model.session import Client
from rsb_bridge.model.snapshot import State
from rsb_console.app import ConsoleApp
from rsb_console.screens.help import HelpScreen
from rsb_console.screens.keys_screen import KeyText, key_files
from rsb_console.screens.links_screen import LinkScreen, LinkText
from rsb_console.session.saving import PathProblem

# -- keys ------------------------------------------------------------------------------------------------------------


@on_main()
async def test_key_is_shown_by_fingerprint_only(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    key = write_key(folder / "r.key")
    (folder / "r.key").chmod(0o644)
    await pilot.press("K")
    await shown(pilot, fingerprint(key))
    await shown(pilot, "0644")
    await shown(pilot, "others may read this key (mode 0644): run `chmod 600 r.key`")
    assert (folder / "r.key").read_text().strip() not in text(app)


@on_main(WIDE, NARROW)
async def test_a_key_is_replaced_only_with_a_yes(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    old = write_key(folder / "r.key")
    await pilot.press("K")
    await shown(pilot, fingerprint(old))
    await pilot.press("g", "enter")
    await shown(pilot, KeyText.REPLACE, file="r.key")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, KeyText.REPLACE, file="r.key")
    assert read_key(folder / "r.key") == old
    await pilot.press("enter", "y")
    await gone(pilot, "Generate a key")
    new = read_key(folder / "r.key")
    assert new != old
    await shown(pilot, fingerprint(new))


@on_main()
async def test_new_key_is_saved_bad_place_refused(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await pilot.press("K")
    await shown(pilot, "no such key file")
    await pilot.press("g")
    await shown(pilot, "Generate a key")
    await fill(pilot, path="nowhere/new.key")
    await shown(pilot, PathProblem.NO_FOLDER)
    await fill(pilot, path="new.key")
    await pilot.press("enter")
    await shown(pilot, "new.key")
    await until(pilot, (folder / "new.key").exists, "the key")
    await shown(pilot, fingerprint(read_key(folder / "new.key")))


@pytest.mark.usefixtures("folder")
@on_main(readonly=True)
async def test_readonly_looks_at_keys_and_makes_none(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("K")
    await shown(pilot, "no such key file")
    await gone(pilot, "generate a key")
    await pilot.press("g")
    await pilot.pause()
    await gone(pilot, "Generate a key")


def test_each_key_file_of_server_names_its_client() -> None:
    clients = (
        Client("robot1"),
        Client("robot2", key_file="/keys/two.key"),
        Client("robot3"),
        Client("robot4", "old.key", "new.key"),
    )
    server = msgspec.structs.replace(SESSION, role="server", clients=clients)
    assert key_files(server, Path("/base")) == {
        Path("/base/r.key"): "robot1, robot3",
        Path("/keys/two.key"): "robot2",
        Path("/base/old.key"): "robot4",
        Path("/base/new.key"): "robot4 (next)",
    }


@on_main()
async def test_key_tells_whether_used_and_its_age(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    key = write_key(folder / "r.key")
    await pilot.press("K")
    await shown(pilot, "written ")
    await gone(pilot, KeyText.IN_USE)
    await pilot.press("escape")
    await gone(pilot, "Key files")
    used = replace(LINK, fingerprint=fingerprint(key))
    engine_of(app).now = replace(engine_of(app).now, links=(used,))
    await pilot.press("K")
    await shown(pilot, KeyText.IN_USE)


@on_main()
async def test_link_tells_which_key_is_used(app: ConsoleApp, pilot: Pilot[None]) -> None:
    valid = replace(LINK, next_fingerprint="aaaa bbbb cccc dddd")
    engine_of(app).now = replace(engine_of(app).now, links=(valid,))
    await pilot.press("c")
    await shown(pilot, f"aaaa bbbb cccc dddd  {LinkText.NEXT_KEY_UNUSED()}")
    engine_of(app).now = replace(engine_of(app).now, links=(replace(valid, fingerprint=valid.next_fingerprint),))
    await shown(pilot, f"aaaa bbbb cccc dddd  {LinkText.NEXT_KEY_USED()}")


# -- links -----------------------------------------------------------------------------------------------------------


@on_main(*long(WIDE), NARROW)
async def test_one_row_robot_worst_first_and_why(app: ConsoleApp, pilot: Pilot[None]) -> None:
    down = replace(LINK, name="robot2", state=State.DOWN, reason="no answer", rtt=None, retry_in=3.0, attempts=3)
    engine_of(app).now = replace(engine_of(app).now, links=(LINK, down))
    await pilot.press("c")
    await shown(pilot, "▌✗ DOWN  robot2")
    await shown(pilot, "no answer; retry 4 in 3 s")
    await shown(pilot, "● ok    robot1")
    await pilot.press("j")
    await shown(pilot, "▌● ok    robot1")
    await shown(pilot, LINK.fingerprint)
    await shown(pilot, "-12.0 ms against ours ± 400 µs")
    await pilot.press("r")
    await until(pilot, lambda: engine_of(app).commands == [("retry", "robot1")], "the command")
    await pilot.press("escape")
    await gone(pilot, "its clock")


@on_main()
async def test_cursor_stays_on_link_that_comes_up(app: ConsoleApp, pilot: Pilot[None]) -> None:
    down = replace(LINK, name="robot2", state=State.DOWN, reason="no answer", rtt=None)
    engine_of(app).now = replace(engine_of(app).now, links=(LINK, down))
    await pilot.press("c")
    await shown(pilot, "▌✗ DOWN  robot2")
    engine_of(app).now = replace(engine_of(app).now, links=(LINK, replace(LINK, name="robot2")))
    await shown(pilot, "▌● ok    robot2")
    await pilot.press("r")
    await until(pilot, lambda: engine_of(app).commands == [("retry", "robot2")], "the command")


@on_main()
async def test_a_link_in_the_clear_stands_out(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).now = replace(engine_of(app).now, links=(replace(LINK, encrypted=False, cipher=""),))
    await pilot.press("c")
    await shown(pilot, "key          ")
    key_line = next(line for line in text(app).splitlines() if "key          " in line)
    assert "NOT ENCRYPTED" in key_line


@on_main()
async def test_lost_link_closes_its_own_screen_only(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("c", "enter")
    await shown(pilot, "Link robot1")
    link = app.screen
    assert isinstance(link, LinkScreen)
    await pilot.press("question_mark")
    put(app, links=())
    link.show()
    assert isinstance(app.screen, HelpScreen)
    await pilot.press("escape")
    await gone(pilot, "Link robot1")


# -- Bluetooth -------------------------------------------------------------------------------------------------------

HCI0 = Adapter("hci0", "5C:F3:70:9A:1B:2E", powered=True, alias="desk")
PHONE = Device("00:1A:7D:DA:71:13", "robot1", "hci0", paired=True, connected=False)


def found() -> Scan:
    uses = {number: ChannelUse.BUSY if number in (1, 5) else ChannelUse.FREE for number in CHANNELS}
    return Scan((HCI0,), {HCI0.address: uses, ANY_ADAPTER: uses}, (PHONE,))


@pytest.fixture
def radio(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """A stand-in for the radio that no test machine has; the real scan has tests of its own. Lists its calls."""
    calls: list[object] = []

    async def scan(own_channels: object) -> Scan:
        calls.append(own_channels)
        return found()

    replaced.BLUETOOTH_SCAN.set(monkeypatch, scan)
    return calls


@on_main()
async def test_dialog_without_findings_has_no_empty_lines(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scan(own_channels: object) -> Scan:
        return Scan((), {}, (), ("no radio here",))

    replaced.BLUETOOTH_SCAN.set(monkeypatch, scan)
    await pilot.press("b")
    await shown(pilot, "no radio here")
    lines = text(app).splitlines()
    title = next(number for number, line in enumerate(lines) if "─ Bluetooth ─" in line)
    assert "no radio here" in lines[title + 2]


@on_main(*long(WIDE), NARROW)
async def test_adapters_devices_and_channels_at_a_glance(
    app: ConsoleApp, pilot: Pilot[None], radio: list[object]
) -> None:
    await pilot.press("b")
    await shown(pilot, "5C:F3:70:9A:1B:2E  hci0     on                 desk")
    await shown(pilot, "00:1A:7D:DA:71:13  device   paired             robot1")
    await shown(pilot, "1✗  2·  3·  4·  5✗  6·")
    await pilot.press("s")
    await until(pilot, lambda: len(radio) == 2, "another scan")


@on_main()
async def test_paired_device_becomes_server_of_new_session(
    app: ConsoleApp, pilot: Pilot[None], radio: list[object]
) -> None:
    await pilot.press("b")
    await shown(pilot, PHONE.address)
    await pilot.press("j", "enter")
    await shown(pilot, "New session")
    assert form_of(app).values["server_ip"] == PHONE.address
    await fill(pilot, name="robot1")
    await pilot.press("enter")
    await shown(pilot, "7060 is not a valid RFCOMM channel")


@on_main(session=msgspec.structs.replace(SESSION, role="server", server_ip=HCI0.address, server_port=4))
async def test_servers_own_channels_are_told_to_scan(app: ConsoleApp, pilot: Pilot[None], radio: list[object]) -> None:
    await pilot.press("b")
    await until(pilot, lambda: radio, "a scan")
    assert radio == [{(HCI0.address, 4), (HCI0.address, 3)}]  # the session's, and that of /robot2/scan

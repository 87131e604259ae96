"""Devices in BlueZ: their owners may choose any name."""

from typing import Any

import pytest

from rsb_bridge.bluetooth.bluez import BluezError, read_objects

ADAPTER = {"Address": "00:11:22:33:44:55", "Powered": True, "Alias": "robot1", "Class": 0}
DEVICE = {
    "Address": "66:77:88:99:AA:BB", "Alias": "control", "Paired": True, "Connected": False,
    "Adapter": "/org/bluez/hci0", "RSSI": -60,
}  # fmt: skip


def objects(**changes: Any) -> dict[str, Any]:
    return {
        "/org/bluez": {"org.bluez.AgentManager1": {}},
        "/org/bluez/hci0": {"org.bluez.Adapter1": ADAPTER},
        "/org/bluez/hci0/dev_1": {"org.bluez.Device1": {**DEVICE, **changes}},
    }


def test_adapters_and_paired_devices_are_found() -> None:
    (adapter,), (device,) = read_objects(objects())
    assert (adapter.name, adapter.address, adapter.powered, adapter.alias) == (
        "hci0", "00:11:22:33:44:55", True, "robot1",
    )  # fmt: skip
    assert (device.address, device.name, device.adapter) == ("66:77:88:99:AA:BB", "control", "hci0")
    assert read_objects(objects(Paired=False))[1] == []


def test_a_devices_name_does_nothing_to_a_terminal() -> None:
    _, (device,) = read_objects(objects(Alias="\x1b[2Jphone\n\u202e"))
    assert device.name == "\N{REPLACEMENT CHARACTER}[2Jphone\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}"


@pytest.mark.parametrize("answer", [objects(Address=None), [], {"/org/bluez/hci0": {"org.bluez.Adapter1": {}}}])
def test_answer_of_another_form_is_refused_in_words(answer: object) -> None:
    with pytest.raises(BluezError, match="not as documented"):
        read_objects(answer)

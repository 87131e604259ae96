"""BlueZ's answer, which holds the names that devices near this machine give themselves."""

from __future__ import annotations

import json

from tests.fuzz.editing import edit_json
from tests.fuzz.parser import Parser, check_text

from rsb_bridge.bluetooth.bluez import BluezError, read_objects
from rsb_bridge.model.text import is_clean


def _read(data: bytes) -> None:
    try:
        objects = json.loads(data)
        json.dumps(objects, ensure_ascii=False).encode()  # D-Bus has whole characters only
    except (ValueError, RecursionError):
        return
    try:
        adapters, devices = read_objects(objects)
    except BluezError as error:
        check_text(str(error), 500)
        return
    for each in adapters:
        assert is_clean(each.address + each.name + each.alias)
    for device in devices:
        assert is_clean(device.address + device.name + device.adapter)


_OBJECTS = (
    b'{"/org/bluez/hci0":{"org.bluez.Adapter1":{"Address":"00:11:22:33:44:55","Powered":true,"Alias":"robot1"}},'
    b'"/org/bluez/hci0/dev_1":{"org.bluez.Device1":{"Address":"66:77:88:99:AA:BB","Alias":"control","Paired":true,'
    b'"Connected":false,"Adapter":"/org/bluez/hci0"}},"/org/bluez":{}}'
)

PARSERS = (Parser("bluez_objects", _read, (_OBJECTS,), edit_json),)

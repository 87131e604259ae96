"""Import another bridge's configuration, by whose it is."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.yaml_text import SessionError, read_text, read_yaml
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.session import Problem
from rsb_extras.imports.domain_bridge import import_domain_bridge
from rsb_extras.imports.other_bridges import OtherBridge, origin_of
from rsb_extras.imports.thesis import import_bringup
from rsb_extras.imports.zenoh_bridge import import_zenoh_bridge

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_extras.imports.other_bridges import Choices, Imported


class ImportMistake(Wording):
    """The reason why a file cannot be imported."""

    UNKNOWN = "not a file of ros2_socket_bridge, domain_bridge or zenoh-bridge-ros2dds"
    JSON5 = "JSON5 is read by Zenoh, whose package is not installed: pip install 'rsb-console[zenoh]'"
    NOT_JSON5 = "not JSON5: {problem}"


def import_file(path: Path, choices: Choices) -> Imported:
    """Make the sessions of another bridge's configuration.

    Raises:
        SessionError: it is no such file, or it makes no valid session; locations and lines are the file's.
    """
    text = read_text(path)
    if path.suffix == ".json5" or text.lstrip().startswith(("//", "/*")):
        data = _json5(text, path)
        if origin_of(data) is OtherBridge.ZENOH_BRIDGE:
            return import_zenoh_bridge(data, path, choices)
        raise SessionError(path, [Problem("", ImportMistake.UNKNOWN())])
    document = read_yaml(text, path)
    match origin_of(document.data):
        case OtherBridge.DOMAIN_BRIDGE:
            return import_domain_bridge(document, path, choices)
        case OtherBridge.ZENOH_BRIDGE:
            return import_zenoh_bridge(document.data, path, choices)
        case OtherBridge.THESIS:
            return import_bringup(document, path, choices)
    raise SessionError(path, [Problem("", ImportMistake.UNKNOWN())])


def _json5(text: str, path: Path) -> dict[str, Any]:
    """Read a Zenoh configuration, as Zenoh itself does."""
    try:
        import zenoh  # noqa: PLC0415 (an extra)
    except ImportError:
        raise SessionError(path, [Problem("", ImportMistake.JSON5())]) from None
    try:
        config = zenoh.Config.from_json5(text)
        return {key: json.loads(config.get_json(key)) for key in ("plugins", "mode", "connect", "listen")}
    except zenoh.ZError as error:
        raise SessionError(path, [Problem("", ImportMistake.NOT_JSON5(problem=str(error).strip()))]) from None

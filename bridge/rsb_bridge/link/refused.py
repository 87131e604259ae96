"""A server's refusal of a client: its cause, and what the client's operator is told."""

from __future__ import annotations

import shlex

from rsb_bridge.link.duplicate_client import REMEDY
from rsb_bridge.link.shut_down import told_by_server
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.wire.preamble import RefusalCode

CAUSES: dict[RefusalCode | None, LinkCause] = {
    RefusalCode.WRONG_KEY: LinkCause.WRONG_KEY,
    RefusalCode.WRONG_VERSION: LinkCause.WRONG_VERSION,
    RefusalCode.UNKNOWN_NAME: LinkCause.UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: LinkCause.NAME_TAKEN,
    RefusalCode.SHUT_DOWN: LinkCause.SHUT_DOWN,
}
"""Why the link is down; with any other code, `LinkCause.REFUSED`."""


def with_remedy(code: RefusalCode, message: str, *, name: str, has_key: bool) -> str:
    """The server's message, and what the client's operator does about it.

    Args:
        code: the server's.
        message: the server's.
        name: the client's.
        has_key: whether the client has a key.
    """
    match code:
        case RefusalCode.WRONG_KEY if has_key:
            return f"{message}: copy one side's key file to the other"
        case RefusalCode.NAME_TAKEN:
            return f"{message}: {REMEDY}"
        case RefusalCode.SHUT_DOWN:
            return told_by_server(message)
        case RefusalCode.UNKNOWN_NAME:
            add = f"rsb-console client add {shlex.quote(name)}"
            return f"{message}: run {add} on the server, or correct name in this side's session"
        case RefusalCode.ENCRYPTION_REQUIRED:
            return f"{message}: set use_encryption and key_file"
        case _:
            return message

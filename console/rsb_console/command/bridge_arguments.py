"""The arguments of the commands on a running bridge as a whole."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rsb_console.command.remote_arguments import (
    EXIT,
    NO_BRIDGE,
    bridge_command,
    console_options,
    drop_arm_option,
    named_bridge_options,
    subcommand,
)

if TYPE_CHECKING:
    from rsb_console.command.remote_arguments import AddCommand, Complete

_EXIT_STATUS = f"""\
These are not wrong: a link or a topic that waits for its first connection or
message, a topic that is paused or not armed, a topic without a subscriber, and an
acknowledged fault (`ack`).

exit codes:
  0  nothing is wrong
  1  something is wrong; the output names it
{NO_BRIDGE}"""
_EXIT_RELOAD = f"""\
exit codes:
  0  everything that differs is changed, or nothing differs
  1  something was not changed; the output names it
{NO_BRIDGE}"""
_EXIT_SAVE = f"""\
Until then, a change lasts as long as the bridge runs. The bridge writes the file, so its
user must be allowed to.

exit codes:
  0  the file holds the running session
  1  not saved: the session has no file, somebody else has changed it, or it cannot be written
{NO_BRIDGE}"""


def add_bridge_commands(command: AddCommand, complete: Complete) -> None:
    summary = "open the console on a bridge that runs already"
    attach = command("attach", subcommand("local_commands:attach"), summary, EXIT)
    named_bridge_options(attach, complete, json=False)
    console_options(attach, complete)
    remote = partial(bridge_command, command, complete)
    remote("status", "status:print_status", "show how a running bridge, its links and its topics are", _EXIT_STATUS)
    summary = "connect now instead of later, and open refused topics again"
    retry = remote("retry", "bridge_commands:retry_links", summary)
    complete(retry.add_argument("--link", default="", metavar="CLIENT", help="the link with this client only"), "links")
    remote("restart", "bridge_commands:restart_links", "close the links on both sides and open them again")
    summary = "read the session file again, and change only what differs"
    reload = remote("reload", "bridge_commands:reload_session", summary, _EXIT_RELOAD)
    reload.add_argument("--dry-run", action="store_true", help="only print what would change")
    drop_arm_option(reload, "also drop the demands to arm that the file does not make any more; otherwise they stay")
    summary = "save the running session to its file, with the file's comments"
    remote("save", "bridge_commands:save_session", summary, _EXIT_SAVE)
    remote("stop", "bridge_commands:stop_bridge", "end a running bridge, and wait until it has ended")

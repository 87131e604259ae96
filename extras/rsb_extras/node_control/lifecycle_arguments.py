"""The arguments of the command ``lifecycle``, and the keys of its screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, KeyChapter, bridge_options, side_options, subcommand
from rsb_extras.node_control.change_records import LIFECYCLE_ACTIONS

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
Up configures and activates a node, or a group's nodes in their order; down
deactivates them and cleans them up in the reverse order. Each stops at the first
node that refuses, and leaves out what a node needs no more. Groups are listed in
the session file of the machine that has the nodes, which also says what this
side may change (may). A change asks first, and ends with the last node's answer.

for example:
  rsb-console lifecycle
  rsb-console lifecycle up nav
  rsb-console lifecycle deactivate /lidar_driver --link robot2 --yes

exit codes:
  0  listed, or done
  1  refused or failed; then the last step says why
{NO_BRIDGE}"""
CHAPTERS = (
    KeyChapter(
        "Of other features, on a node", "NodesScreen",
        (("x", "Show its lifecycle, and change it"), ("p", "Show its parameters, and set them")),
    ),
    KeyChapter(
        "Lifecycle (X)", "LifecycleScreen",
        (
            ("u w", "Bring a node or a group up, or down, after a question"),
            ("c a", "Configure, activate"),
            ("d n", "Deactivate, clean up"),
            ("S", "Shut down for good"),
            ("l L", "Of containers: load a component, unload the one under the cursor"),
            ("esc", "Close"),
        ),
    ),
)  # fmt: skip


def add_lifecycle(add: AddCommand, complete: Complete) -> None:
    summary = "list managed nodes and groups of both sides; change their states"
    parser = add("lifecycle", subcommand("rsb_extras.node_control.lifecycle_command:lifecycle"), summary, _MORE)
    bridge_options(parser, complete)
    about = "the change; without it, all are listed"
    parser.add_argument("action", nargs="?", choices=LIFECYCLE_ACTIONS, help=about)
    target = parser.add_argument("target", nargs="?", metavar="NODE", help="a node's full name, or a group's")
    complete(target, "rsb_extras.node_control.target_names:target_names")
    side_options(parser, complete, "it", "one of that name")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.set_defaults(in_fleet=True)

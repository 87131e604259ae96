"""The commands for a whole running bridge and its links."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rsb_bridge.model.commands import Save
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, OK, print_error, print_line
from rsb_console.command.target import ANSWERED_WITHIN, attached, check_link, done, result

if TYPE_CHECKING:
    from argparse import Namespace

_LOOK_EVERY = 0.1  # s. A round figure: a command takes so much longer at most


def retry_links(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        result(engine.retry(arguments.link))
        return done(arguments, f"trying again: {arguments.link or 'all links'}")


def restart_links(arguments: Namespace) -> int:
    def step(text: str) -> None:
        if not arguments.json:
            print_line(text)

    with attached(arguments) as engine:
        result(engine.restart(step))
        return done(arguments)


def reload_session(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        reloaded = result(engine.reload(dry_run=arguments.dry_run, drop_arm=arguments.drop_arm))
    if arguments.json:
        is_done = not (reloaded.left or reloaded.failed)
        about = {name: getattr(reloaded, name) for name in ("changed", "left", "failed")}
        print_line(json_line({"ok": is_done, "dry_run": arguments.dry_run, **about}))
    else:
        for line in reloaded.changed or ["no difference that can be applied in place"]:
            print_line(line)
        for line in (*reloaded.left, *reloaded.failed):
            print_error(line)
    return FAILURE if reloaded.left or reloaded.failed else OK


def save_session(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.do(Save()))
        return done(arguments, f"saved: {engine.bridge.file}")


def stop_bridge(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.stop_bridge())
        # The answer comes before the process has ended, and a script may start the session again right after this.
        deadline = time.monotonic() + ANSWERED_WITHIN
        while not engine.unreachable:
            if time.monotonic() > deadline:
                raise TimeoutError
            time.sleep(_LOOK_EVERY)
        return done(arguments, f"stopped: {engine.name}", name=engine.name)

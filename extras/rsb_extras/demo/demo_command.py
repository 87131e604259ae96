"""The command ``demo``: a simulated robot and a desk, bridged on this machine."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Engine, EngineError
from rsb_bridge.model.text import keep_output_clean
from rsb_console.command.headless import Signals, bridge_until_told
from rsb_console.command.local_commands import can_draw
from rsb_console.command.shell import allow_many_descriptors
from rsb_console.feature_console import FAILURE, INTERRUPTED, OK, USAGE, print_error, print_line
from rsb_extras.demo.demo_session import running_demo

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_extras.demo.demo_session import Demo

HOW_TO_END = "Ctrl-C ends them all"


def demo(arguments: Namespace) -> int:
    allow_many_descriptors()
    if not arguments.no_ui and not can_draw("rsb-console demo --no-ui"):
        return USAGE
    return run_demo(ui=not arguments.no_ui, seconds=arguments.seconds)


def run_demo(*, ui: bool, seconds: float | None) -> int:
    """Run the demo in the console, or headless for some seconds or until a signal.

    Returns:
        The exit code; headless, 0 only if every topic crossed.
    """
    try:
        with Signals(ignore_hangup=False, has_terminal=True) as signals, contextlib.ExitStack() as resources:
            demo = resources.enter_context(running_demo())
            if signals.caught:
                return INTERRUPTED
            if ui:
                from rsb_console.command.console_command import run_console  # noqa: PLC0415 -- needs Textual

                return run_console(demo.path, temporary=True, resources=resources)
            code = _headless(demo, signals, seconds)
    except EngineError as error:
        print_error(str(error))
        return FAILURE
    return code or _print_counts(demo)


def _headless(demo: Demo, signals: Signals, seconds: float | None) -> int:
    keep_output_clean()
    print_line(f"a simulated robot, a desk in another ROS domain, an encrypted bridge between them: {demo.path.parent}")
    sys.stdout.flush()
    engine = Engine(demo.session, base=demo.path.parent)
    engine.start()
    code = bridge_until_told(engine, signals, seconds=seconds)
    demo.desk.stop()
    demo.robot.stop()
    return code


def _print_counts(demo: Demo) -> int:
    """Print how many messages each end published and received. Return the exit code."""
    print_line(f"{'topic':<12} {'published':>10} {'received':>10}")
    failed = []
    for sender, receiver in ((demo.robot, demo.desk), (demo.desk, demo.robot)):
        for topic, published in sender.published.items():
            # Nobody bridges /battery_state until the operator adds it.
            if all(topic != bridged.topic for bridged in demo.session.topics):
                continue
            received = receiver.received.get(topic, 0)
            print_line(f"{topic:<12} {published:>10} {received:>10}  {'ok' if received else 'NOTHING CAME'}")
            if not received:
                failed.append(topic)
    if failed or not demo.robot.published or not demo.desk.published:
        print_error(f"the demo failed: {', '.join(failed) or 'the robot or the desk did not run'}")
        return FAILURE
    return OK

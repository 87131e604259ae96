"""A simulated robot and desk, our bridge between them, and the command of a console at the desk; of any checkout."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench import bed

from rsb_bridge.config.keys import write_key

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_TOPICS = """\
  - {topic: /scan, direction: receive, protocol: udp, expected_rate: 10}
  - {topic: /odom, direction: receive, protocol: udp, expected_rate: 50}
  - {topic: /map, direction: receive, protocol: tcp, compression: zstd}
  - {topic: /plan, direction: receive, protocol: tcp, expected_rate: 1}
  - {topic: /tf, direction: receive, protocol: udp, expected_rate: 25}
  - {topic: /tf_static, direction: receive, protocol: tcp}
  - {topic: /goal_pose, direction: transmit, protocol: tcp, expected_rate: 1}
  - {topic: /cmd_vel, direction: transmit, type: geometry_msgs/msg/Twist, protocol: tcp, arm: true}
services:
  - {service: /set_light, provider: server}
parameters:
  - {node: /simulated_robot, provider: server}
"""
"""The demo's."""
_CONSOLE = """\
refresh_rate: {rate}
layouts:
  one-camera: [/camera/image_raw]
  two-silent: [/battery_state, /imu]
"""
_SILENT = ("/battery_state", "/imu")
_READS_EVERY = 0.5
"""s, longer than the simulated robot takes until it reads the next line."""
_OF_TERMINALS = ("TMUX", "STY", "ZELLIJ", "SSH_CONNECTION", "SSH_TTY", "TERM_PROGRAM", "COLORTERM", "NO_COLOR")
"""Variables of the terminal that this program runs in."""


class Checkout:
    """A checkout of this project, with the Python that runs it."""

    def __init__(self, root: Path, name: str) -> None:
        self.name = name
        own = root / ".venv/bin/python"
        self.python = str(own) if own.exists() else sys.executable
        paths = [str(root / part) for part in ("bridge", "console", "extras")]
        self.environ = {"PYTHONPATH": os.pathsep.join(paths)}

    @contextlib.contextmanager
    def running(self, environ: Mapping[str, str], module: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
        """Run a module, which ends with this process, as `rsb_console.child` has it."""
        watched, held = os.pipe()
        command = [self.python, "-P", "-m", "rsb_console.child", str(watched), module, *arguments]
        process = subprocess.Popen(
            command,
            env=os.environ | self.environ | dict(environ),
            pass_fds=(watched,),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(watched)
        try:
            yield process
        finally:
            os.close(held)
            process.wait(20)


class Side:
    """A checkout with its robot, desk and bridge. A context manager."""

    def __init__(self, checkout: Checkout, domain: int, folder: Path) -> None:
        self.name = checkout.name
        self._checkout = checkout
        for name in _OF_TERMINALS:
            os.environ.pop(name, None)
        self._domain = domain
        self._folder = folder
        self._stack = contextlib.ExitStack()
        places = {f"XDG_{name}_HOME": str(folder / name.lower()) for name in ("STATE", "CONFIG", "DATA", "CACHE")}
        self._environ = {
            **places,
            "XDG_RUNTIME_DIR": str(folder),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }

    def __enter__(self) -> Side:
        port, near, far = bed.free_port(), self._domain, self._domain + 1
        common = f"server_ip: 127.0.0.1\nserver_port: {port}\nkey_file: line.key\n"
        write_key(self._folder / "line.key")
        clients = "clients:\n  - {name: desk, key_file: line.key}\n"
        (self._folder / "robot.yaml").write_text(f"name: robot\nrole: server\ndomain_id: {far}\n{common}{clients}")
        session = f"name: desk\nrole: client\ndomain_id: {near}\n{common}topics:\n{_TOPICS}"
        (self._folder / "desk.yaml").write_text(session)
        robot, *_ = (
            self._run("rsb_extras.demo.simulated_part", "robot", str(far)),
            self._run("rsb_extras.demo.simulated_part", "desk", str(near)),
            self._run("rsb_console", "run", "--no-ui", str(self._folder / "robot.yaml")),
            self._run("rsb_console", "run", "--no-ui", str(self._folder / "desk.yaml")),
        )
        assert robot.stdin is not None
        for topic in _SILENT:
            robot.stdin.write(f"{topic}\n".encode())
            robot.stdin.flush()
            time.sleep(_READS_EVERY)
        wait = [*self.command("wait"), "--bridge", "desk", "--for", "flowing", "/odom", "--timeout", "60"]
        deadline = time.monotonic() + 90
        while subprocess.run(wait, env=os.environ | self.environ, capture_output=True, check=False).returncode:
            if time.monotonic() > deadline:
                raise SystemExit("nothing flows")
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _run(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        return self._stack.enter_context(self._checkout.running(self._environ, module, *arguments))

    @property
    def environ(self) -> dict[str, str]:
        return self._checkout.environ | self._environ

    def command(self, *arguments: str) -> list[str]:
        return [self._checkout.python, "-m", "rsb_console", *arguments]

    def set_up_console(self, rate: float) -> dict[str, str]:
        """Write the settings of a console that refreshes so often, and return its environment."""
        place = Path(self._environ["XDG_CONFIG_HOME"], "rsb-console", "console.yaml")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(_CONSOLE.format(rate=f"{rate:g}"))
        return self.environ

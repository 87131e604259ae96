"""The discovery server of Fast DDS, and a node that it serves."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

_TALKER = """
import sys, time, rclpy
from std_msgs.msg import String
rclpy.init(domain_id=int(sys.argv[1]))
publisher = rclpy.create_node("talker").create_publisher(String, sys.argv[2], 10)
print("ready", flush=True)
while True:
    publisher.publish(String(data="said"))
    time.sleep(0.1)
"""


@contextlib.contextmanager
def discovery_server(port: int, number: int = 0) -> Iterator[None]:
    """Run the server with an id on 127.0.0.1; skip the test where none is installed."""
    program = shutil.which("fast-discovery-server", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if program is None:
        pytest.skip("fast-discovery-server is not installed")
    # In the wheels it finds its own libraries only with their folders.
    libraries = {
        str(each.parent) for each in Path(sys.prefix, "lib").rglob("lib*.so*") if "fastrtps" in str(each.parent)
    }
    path = ":".join((str(Path(sys.prefix, "lib")), *sorted(libraries), os.environ.get("LD_LIBRARY_PATH", "")))
    command = [program, "-i", str(number), "-l", "127.0.0.1", "-p", str(port)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=os.environ | {"LD_LIBRARY_PATH": path}
    ) as run:
        assert run.stdout is not None
        try:
            assert any("running" in line for line in run.stdout)
            yield
        finally:
            run.terminate()


@contextlib.contextmanager
def talker(domain_id: int, topic: str, **environ: str) -> Iterator[None]:
    """Run a node with a publisher in a process of its own."""
    command = [sys.executable, "-c", _TALKER, str(domain_id), topic]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | environ) as run:
        assert run.stdout is not None
        try:
            assert run.stdout.readline() == "ready\n"
            yield
        finally:
            run.kill()

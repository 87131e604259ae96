"""Files on a disk that is full, out of inodes or read-only: a small file system of their own, for real."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rsb_bridge.config.files import SHORTAGES, why_not_written

_ROOT = Path(__file__).parents[2]
COMMAND = Path(sys.executable).with_name("rsb-console")
_SETUP = """
import errno, os, re, subprocess, sys
from pathlib import Path
import msgspec, pytest
from rsb_bridge.config.files import new_file, write_whole
from rsb_bridge.config.keys import KeyFileError, write_key
from rsb_bridge.config.session_file import UnwritableError, load, save
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.config.files import Shortage, why_not_written

disk, command = Path(sys.argv[1]), sys.argv[2]
os.chdir(disk)
session = Session(name="robot1", role="client", server_ip="10.0.0.1", server_port=7060, key_file="k.key")
larger = msgspec.structs.replace(session, topics=tuple(Topic(f"/topic{n}", "transmit") for n in range(99)))
path = disk / "robot1.yaml"
save(session, path)

def fill():
    with open("ballast", "wb", buffering=0) as ballast:
        try:
            while True:
                ballast.write(bytes(512))
        except OSError as error:
            assert error.errno == errno.ENOSPC

def ran(*arguments, **more):
    return subprocess.run([command, *arguments], capture_output=True, text=True, timeout=120, **more)
"""


def on_disk(tmp_path: Path, script: str, options: str = "size=64k") -> None:
    """Run a script on a file system with these options; its first argument is where that is."""
    disk = tmp_path / "disk"
    disk.mkdir()
    environ = os.environ | {"PYTHONPATH": os.pathsep.join(str(_ROOT / name) for name in ("", "bridge", "console"))}
    mount = 'mount -t tmpfs -o "$1" none "$2" && exec "$3" -c "$4" "$2" "$5"'
    program = (sys.executable, f"{_SETUP}\n{script}\nprint('done')", str(COMMAND))
    run = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount, "sh", options, str(disk), *program],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
        env=environ,
    )
    if "unshare:" in run.stderr or "mount:" in run.stderr:
        pytest.skip(f"no file system of its own here: {run.stderr}")
    assert run.stdout.endswith("done\n"), run.stdout + run.stderr


def test_full_disk_loses_nothing_and_names_remedy(tmp_path: Path) -> None:
    on_disk(
        tmp_path,
        """
write_whole(disk / "robot.txt", "old")
fill()
before = {each: each.read_bytes() for each in disk.iterdir()}
with pytest.raises(UnwritableError, match=f"robot1.yaml: cannot be written: .*free space on {disk}"):
    save(larger, path)
with pytest.raises(KeyFileError, match=f"new.key: cannot be written: .*free space on {disk}"):
    write_key(disk / "new.key")
with pytest.raises(OSError, match="No space"):
    write_whole(disk / "robot.txt", "new" * 9999)
with pytest.raises(OSError, match="No space"), new_file(disk / "log.txt") as file:
    file.write("x" * 9999)
run = ran("keygen", "other.key")
assert (run.returncode, run.stdout) == (1, ""), run
assert f"free space on {disk}" in run.stderr and run.stderr.count(chr(10)) == 1, run.stderr
assert {each: each.read_bytes() for each in disk.iterdir()} == before
(disk / "ballast").unlink()
save(larger, path)
assert load(path) == larger
""",
    )


def test_disk_without_room_for_more_files_says_so(tmp_path: Path) -> None:
    on_disk(
        tmp_path,
        """
with pytest.raises(OSError):
    for number in range(99):
        (disk / f"{number}").touch()
with pytest.raises(UnwritableError, match=re.escape(Shortage.NO_INODES(error=os.strerror(errno.ENOSPC), mount=disk))):
    save(larger, path)
assert load(path) == session
""",
        "size=1m,nr_inodes=8",
    )


def test_disk_that_may_only_be_read_says_so(tmp_path: Path) -> None:
    on_disk(
        tmp_path,
        """
subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
text = Shortage.READ_ONLY(error=os.strerror(errno.EROFS), mount=disk)
for work in (lambda: save(larger, path), lambda: write_key(disk / "new.key"), lambda: write_key(path, force=True)):
    with pytest.raises((UnwritableError, KeyFileError), match=re.escape(text)):
        work()
assert load(path) == session
""",
    )


def test_what_keeps_crash_from_being_recorded_is_said(tmp_path: Path) -> None:
    on_disk(
        tmp_path,
        """
fill()
script = "import sys; from rsb_console import cli; sys.exit(cli._unexpected(ValueError('a mistake'), show=False))"
run = subprocess.run([sys.executable, "-c", script], env=os.environ | {"XDG_STATE_HOME": str(disk)},
                     capture_output=True, text=True, timeout=180)
assert run.returncode == 1
assert "a mistake" in run.stderr and f"free space on {disk}" in run.stderr, run.stderr
assert "Traceback" not in run.stderr
""",
    )


@pytest.mark.parametrize("arguments", [("check", "robot1.yaml"), ("completion", "bash")])
def test_standard_output_on_full_disk_ends_in_sentence(arguments: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "robot1.yaml").write_text(
        "name: a\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 7060\nuse_encryption: false\n"
    )
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [COMMAND, *arguments],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=180,
            check=False,
        )
    assert run.returncode == 1
    assert "No space left on device" in run.stderr
    assert "Traceback" not in run.stderr
    assert "Exception ignored" not in run.stderr


@pytest.mark.parametrize("number", sorted(SHORTAGES))
def test_each_shortage_has_remedy_and_names_file_system(number: int, tmp_path: Path) -> None:
    text = why_not_written(OSError(number, os.strerror(number)), tmp_path / "missing" / "file")
    assert text.startswith(f"{os.strerror(number)}: ")
    assert len(text) > len(os.strerror(number)) + 20


def test_another_error_is_as_it_was(tmp_path: Path) -> None:
    assert why_not_written(OSError(errno.EACCES, "Permission denied"), tmp_path) == "Permission denied"

"""Builds a Debian package of a wheel and its locked dependencies, without root: ``make deb`` (docs/install.md).

Ubuntu's textual, msgspec and cryptography are too old, so the package brings all of ``locks/fleet.txt`` in a virtual
environment of its own. It sees the packages of the distribution, because the distribution's ROS needs numpy and lark
from there. pip fetches the wheels of another Python or machine just as well, so any machine can build for any other.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import subprocess
import sys
from email import message_from_string
from pathlib import Path

ROOT = Path(__file__).parents[1]
HOME = Path("usr/lib/rsb-console")
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
GLIBC = 34  # 2.34 or newer: Ubuntu 22.04, Debian 12
TO_DEBIANS_PLACES = {
    "share/bash-completion/completions/rsb-console": "usr/share/bash-completion/completions/rsb-console",
    "share/zsh/site-functions/_rsb-console": "usr/share/zsh/vendor-completions/_rsb-console",
    "share/fish/vendor_completions.d/rsb-console.fish": "usr/share/fish/vendor_completions.d/rsb-console.fish",
}
CONTROL = """\
Package: rsb-console
Version: {version}+py{python}
Architecture: {architecture}
Maintainer: The maintainers of rsb-console <rsb-console@users.noreply.github.com>
Installed-Size: {size}
Depends: python3 (>= {python}~), python3 (<< {next_python}~), libc6 (>= 2.{glibc})
Suggests: ros-jazzy-ros-base
Homepage: https://github.com/rsb-console/rsb-console
Section: net
Priority: optional
Description: ROS 2 bridge over encrypted sockets, with an operator console
 The package brings the Python packages that it was tested with, in a virtual
 environment in /{home}. ROS 2 is not a part of it.
"""
PROGRAM = """\
#!/{home}/bin/python
import sys

from rsb_console.cli import main

sys.exit(main())
"""
ENVIRONMENT = "home = /usr/bin\ninclude-system-site-packages = true\nversion = {python}\n"
# Without bytecode, each start by a user would compile everything again.
AFTER_INSTALLATION = "#!/bin/sh\nset -e\n/{home}/bin/python -P -m compileall -q /{home}/lib\n"
BEFORE_REMOVAL = "#!/bin/sh\nset -e\nfind /{home}/lib -depth -name __pycache__ -exec rm -r {{}} +\n"


def install_wheels(wheel: Path, target: Path, python: str, architecture: str) -> None:
    """Let pip unpack what the lock file names, checked by its hashes, and then the wheel."""
    machine = MACHINES[architecture]
    platforms = [f"--platform=manylinux_2_{minor}_{machine}" for minor in range(5, GLIBC + 1)]
    pip = (sys.executable, "-P", "-m", "pip", "install", "--disable-pip-version-check", "--no-deps", "--no-compile")
    kind = ("--only-binary=:all:", "--implementation=cp", f"--python-version={python}", *platforms)
    into = (*pip, *kind, f"--platform=manylinux2014_{machine}", f"--target={target}")
    subprocess.run([*into, "--require-hashes", f"--requirement={ROOT / 'locks/fleet.txt'}"], check=True)
    subprocess.run([*into, "--upgrade", wheel], check=True)


def make_environment(unpacked: Path, home: Path, python: str) -> None:
    """Make a virtual environment of what pip has unpacked."""
    shutil.rmtree(unpacked / "bin")  # scripts with the path of this machine's Python
    shutil.move(unpacked / "share", home / "share")
    write(home / "lib/rsb_console/rsb-console", (ROOT / "ros/rsb-console").read_text(), 0o755)  # pip --target drops it
    packages = home / "lib" / f"python{python}" / "site-packages"
    packages.parent.mkdir(parents=True)
    shutil.move(unpacked, packages)
    for of_pip in ("RECORD", "REQUESTED", "direct_url.json"):  # they name paths of this machine
        for path in packages.glob(f"*.dist-info/{of_pip}"):
            path.unlink()
    for path in packages.glob("*.dist-info/INSTALLER"):
        path.write_text("dpkg\n")
    (home / "bin").mkdir()
    for name in ("python", "python3"):
        (home / "bin" / name).symlink_to(f"/usr/bin/python{python}")
    write(home / "bin/rsb-console", PROGRAM.format(home=HOME), 0o755)
    write(home / "pyvenv.cfg", ENVIRONMENT.format(python=python))


def add_system_files(stage: Path) -> None:
    """Put the command, man page, completions, unit and license where Debian looks for them."""
    home = stage / HOME
    for source, target in TO_DEBIANS_PLACES.items():
        (stage / target).parent.mkdir(parents=True)
        shutil.move(home / source, stage / target)
    for emptied in ("bash-completion", "zsh", "fish"):
        shutil.rmtree(home / "share" / emptied)
    manual = stage / "usr/share/man/man1/rsb-console.1.gz"
    manual.parent.mkdir(parents=True)
    manual.write_bytes(gzip.compress((ROOT / "docs/rsb-console.1").read_bytes(), mtime=0))
    shutil.rmtree(home / "share/man")
    (stage / "usr/bin").mkdir()
    (stage / "usr/bin/rsb-console").symlink_to("../lib/rsb-console/bin/rsb-console")
    write(stage / "usr/lib/systemd/system/rsb-console@.service", (ROOT / "configs/rsb-console@.service").read_text())
    write(stage / "usr/share/doc/rsb-console/copyright", (ROOT / "LICENSE").read_text())
    (stage / "usr/share/doc/rsb-console/examples").symlink_to("../../../lib/rsb-console/share/rsb_console/configs")
    (stage / "etc/rsb-console").mkdir(parents=True)


def add_control_files(stage: Path, python: str, architecture: str) -> str:
    """Write what dpkg reads, and return the package's version."""
    packages = stage / HOME / "lib" / f"python{python}" / "site-packages"
    (metadata,) = packages.glob("rsb_console-*.dist-info/METADATA")
    about = message_from_string(metadata.read_text(encoding="utf-8"))
    version = about["Version"].replace(".dev", "~dev")  # which is before the release
    major, minor = python.split(".")
    control = CONTROL.format(
        version=version,
        python=python,
        next_python=f"{major}.{int(minor) + 1}",
        architecture=architecture,
        glibc=GLIBC,
        home=HOME,
        size=sum(path.lstat().st_size for path in stage.rglob("*")) // 1024,
    )
    write(stage / "DEBIAN/control", control)
    write(stage / "DEBIAN/postinst", AFTER_INSTALLATION.format(home=HOME), 0o755)
    write(stage / "DEBIAN/prerm", BEFORE_REMOVAL.format(home=HOME), 0o755)
    return f"{version}+py{python}"


def write(path: Path, text: str, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)


def build(wheel: Path, folder: Path, python: str, architecture: str) -> Path:
    """Build the package into the folder, and return its path."""
    stage, unpacked = folder / "stage", folder / "unpacked"
    for old in (stage, unpacked):
        shutil.rmtree(old, ignore_errors=True)
    (stage / HOME).mkdir(parents=True)
    install_wheels(wheel, unpacked, python, architecture)
    make_environment(unpacked, stage / HOME, python)
    add_system_files(stage)
    version = add_control_files(stage, python, architecture)
    for path in stage.rglob("*"):  # whatever the umask here is
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() or os.access(path, os.X_OK) else 0o644)
    stage.chmod(0o755)
    package = folder / f"rsb-console_{version}_{architecture}.deb"
    subprocess.run(["dpkg-deb", "--build", "--root-owner-group", "-Zxz", stage, package], check=True)
    shutil.rmtree(stage)  # colcon would take its package.xml for another package of a workspace
    return package


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--folder", type=Path, default=ROOT / "build/deb")
    parser.add_argument("--python", default="3.12", help="Python of the distribution: 3.12 on Ubuntu 24.04")
    parser.add_argument("--architecture", default="amd64", choices=MACHINES)
    arguments = parser.parse_args()
    print(build(arguments.wheel, arguments.folder, arguments.python, arguments.architecture))

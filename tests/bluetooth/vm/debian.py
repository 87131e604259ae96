"""The Debian packages the machine is made of: which ones, their versions here, downloading and unpacking them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

# Not 6.1.0-55 and -56: there an RFCOMM connect to an absent peer hits a kernel BUG. The cloud kernels lack Bluetooth.
KERNELS = (
    "6.1.0-47-amd64",
    "6.1.0-50-amd64",
    "6.1.0-51-amd64",
    "6.1.0-53-amd64",
    "6.12.100+deb12-amd64",
    "6.12.117+deb12-amd64",
)
_TOOLS = "bluez bluez-test-tools busybox-static dbus-bin dbus-daemon dbus-system-bus-common"
_PYTHON = "python3.11-minimal libpython3.11-minimal libpython3.11-stdlib"
_LIBRARIES = (
    "libapparmor1 libasound2 libaudit1 libbz2-1.0 libc6 libcap-ng0 libcap2 libdbus-1-3 libdw1 libelf1 libexpat1 libffi8"
    " libgcc-s1 libgcrypt20 libglib2.0-0 libgpg-error0 liblz4-1 liblzma5 libpcre2-8-0 libreadline8 libselinux1 libssl3 "
    "libstdc++6 libsystemd0 libtinfo6 libudev1 libuuid1 libzstd1 zlib1g"
)
PACKAGES = f"{_TOOLS} {_PYTHON} {_LIBRARIES}".split()


class UnavailableError(Exception):
    """The VM cannot be set up on this machine; the message says why, and what would help."""


class Release(NamedTuple):
    """The packages of this machine's package lists.

    Attributes:
        kernel: version of the kernel, as in ``uname -r``.
        image: file name of the kernel's package.
        packages: file names of the other packages; they carry the versions.
    """

    kernel: str
    image: str
    packages: tuple[str, ...]


def release(kernels: tuple[str, ...] = KERNELS) -> Release:
    """The packages to use, with the first of `kernels` that is offered.

    Raises:
        UnavailableError: no QEMU, no apt, or packages of another distribution.
    """
    for tool in ("qemu-system-x86_64", "apt-get", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise UnavailableError(
                f"{tool} is missing (Debian 12: apt install --no-install-recommends qemu-system-x86)"
            )
    packages = _file_names(PACKAGES)
    if packages is None:
        raise UnavailableError("the packages of Debian 12 (amd64) are not in this machine's lists (try apt-get update)")
    for kernel in kernels:
        if image := _file_names([f"linux-image-{kernel}"]):
            return Release(kernel, image[0], tuple(packages))
    raise UnavailableError(f"none of the kernels {', '.join(kernels)} is in this machine's package lists")


def _file_names(packages: list[str]) -> list[str] | None:
    listing = subprocess.run(
        ["apt-get", "download", "--print-uris", *packages], capture_output=True, text=True, check=False
    )
    return None if listing.returncode else sorted(line.split()[1] for line in listing.stdout.splitlines())


def download(kernel: str, folder: Path) -> None:
    """Fetch the kernel's and all other packages into `folder`.

    Raises:
        UnavailableError: the archive could not be reached.
    """
    command = ["apt-get", "download", "-qq", "-o", "APT::Sandbox::User=root", f"linux-image-{kernel}", *PACKAGES]
    fetched = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if fetched.returncode:
        raise UnavailableError(f"apt-get download failed: {fetched.stderr.strip()}")


def unpack(package: Path, folder: Path) -> None:
    """Unpack one package without installing it."""
    subprocess.run(["dpkg-deb", "--extract", package, folder], check=True)

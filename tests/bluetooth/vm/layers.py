"""Makes, once for each set of versions, what the machine boots from: its kernel and the fixed part of its initramfs."""

from __future__ import annotations

import hashlib
import lzma
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from tests.bluetooth.vm import debian
from tests.bluetooth.vm.cpio import Archive

_HERE = Path(__file__).parent
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rsb-console" / "bluetooth-bed"

# What the link, the transport and the scan import, and pytest.
_WHEELS = (
    "aiohappyeyeballs cffi cryptography dbus-fast iniconfig msgspec packaging platformdirs pluggy pycparser pygments"
    " pytest pyyaml zstandard"
)
_WHEEL_PLATFORMS = [f"manylinux_2_{minor}_x86_64" for minor in range(17, 37)]  # Debian 12 has glibc 2.36

# Pairing's crypto (cmac, ecb) and BlueZ's (algif_*) are loaded on demand where there is a modprobe to do it.
_MODULES = ("rfcomm", "hci_vhci", "cmac", "ecb", "algif_hash", "algif_skcipher")
_MODULE_FOLDERS = re.compile(r"kernel/(arch/x86/crypto|crypto|drivers/bluetooth|lib|net/bluetooth|net/rfkill)/")

_LEFT_OUT = re.compile(
    r"usr/(share/(?!dbus-1)|lib/(systemd|udev|cups)/|lib/x86_64-linux-gnu/(gconv|perl)|lib/debug|games)"
    r"|usr/lib/python3\.11/(idlelib|lib2to3|pydoc_data|turtledemo|test|distutils)/|etc/init|var/"
)
_MERGED = ("bin", "lib", "lib64", "sbin")  # folders that are links into /usr on Debian


class Layers(NamedTuple):
    """The archives that the machine boots from.

    Attributes:
        initrd: an initramfs that each run's own archive is appended to.
        version: the kernel's.
    """

    kernel: Path
    initrd: Path
    version: str


def prepare(kernels: tuple[str, ...] = debian.KERNELS) -> Layers:
    """The layers for the versions at hand: from the cache, else made now (about 20 s and 80 MB of downloads).

    Raises:
        debian.UnavailableError: they can't be made on this machine.
    """
    release = debian.release(kernels)
    wheels = [f"{name}=={version(name)}" for name in _WHEELS.split()]
    sources = [(_HERE / name).read_text() for name in ("layers.py", "init")]
    key = hashlib.sha256(repr((release, wheels, sources)).encode()).hexdigest()[:12]
    folder = _CACHE / f"{release.kernel}-{key}"
    layers = Layers(folder / "vmlinuz", folder / "initrd", release.kernel)
    if not folder.exists():
        _CACHE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=_CACHE, prefix="making-") as making:
            _make(Path(making), release.kernel, wheels)
            (Path(making) / "done").rename(folder)
        for older in _CACHE.glob(f"{release.kernel}-*"):
            if older != folder:
                shutil.rmtree(older)
    return layers


def _make(work: Path, kernel: str, wheels: list[str]) -> None:
    for name in ("packages", "root", "done"):
        (work / name).mkdir()
    debian.download(kernel, work / "packages")
    (image,) = (work / "packages").glob("linux-image-*")
    for package in (work / "packages").iterdir():
        if package != image:
            debian.unpack(package, work / "root")
    _install_wheels(work / "root" / "site", wheels)
    _compile(work / "root")
    vmlinuz, modules = _read_kernel(image, kernel)
    (work / "done" / "vmlinuz").write_bytes(vmlinuz)
    with (work / "done" / "initrd").open("wb") as file, Archive(file) as archive:
        _add_root(archive, work / "root")
        for name, content in modules.items():
            archive.add(PurePosixPath(f"modules/{name}.ko"), content)
        archive.add(PurePosixPath("modules/order"), "".join(f"{name}\n" for name in modules).encode())
        archive.add(PurePosixPath("init"), (_HERE / "init").read_bytes(), 0o755)


def _install_wheels(folder: Path, wheels: list[str]) -> None:
    """Install for the machine's Python, which may differ from the one that runs this."""
    target = [
        "--target",
        str(folder),
        "--python-version",
        "3.11",
        "--no-deps",
        "--only-binary",
        ":all:",
        "--no-compile",
    ]
    platforms = [argument for name in _WHEEL_PLATFORMS for argument in ("--platform", name)]
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    installed = subprocess.run([*pip, *target, *platforms, *wheels], capture_output=True, text=True, check=False)
    if installed.returncode:
        raise debian.UnavailableError(f"the wheels for the machine can't be installed: {installed.stderr.strip()}")


def _compile(root: Path) -> None:
    """Compile to bytecode with the machine's own Python: emulated, that takes longer than all else at each start."""
    environment = {"PYTHONHOME": str(root / "usr"), "LD_LIBRARY_PATH": str(root / "usr/lib/x86_64-linux-gnu")}
    compiling = ["-m", "compileall", "-q", "--invalidation-mode", "unchecked-hash", "-s", str(root), "-p", "/"]
    python = root / "usr/bin/python3.11"
    subprocess.run([python, *compiling, root / "usr/lib/python3.11", root / "site"], env=environment, check=True)


def _read_kernel(image: Path, kernel: str) -> tuple[bytes, dict[str, bytes]]:
    """The kernel's image, and its modules by name in the order to insert them."""
    found: dict[str, bytes] = {}
    vmlinuz = b""
    with (
        subprocess.Popen(["dpkg-deb", "--fsys-tarfile", image], stdout=subprocess.PIPE) as package,
        tarfile.open(fileobj=package.stdout, mode="r|") as tar,
    ):
        for member in tar:
            if member.name == f"./boot/vmlinuz-{kernel}":
                vmlinuz = _content(tar, member)
            elif member.isfile() and _MODULE_FOLDERS.search(member.name):
                name = Path(member.name).name.split(".")[0].replace("-", "_")
                found[name] = _content(tar, member)
    return vmlinuz, _in_order(found)


def _content(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = tar.extractfile(member)
    assert file is not None
    data = file.read()
    return lzma.decompress(data) if member.name.endswith(".xz") else data


def _in_order(found: dict[str, bytes]) -> dict[str, bytes]:
    """`_MODULES` with those they depend on before them; what is not found is built in."""
    ordered: dict[str, bytes] = {}

    def add(name: str) -> None:
        if name in ordered or name not in found:
            return
        depends = re.search(rb"\0depends=([^\0]*)\0", found[name])
        for other in depends[1].decode().split(",") if depends else []:
            add(other.replace("-", "_"))
        ordered[name] = found[name]

    for module in _MODULES:
        add(module)
    return ordered


def _add_root(archive: Archive, root: Path) -> None:
    for folder in _MERGED:
        archive.add_symlink(PurePosixPath(folder), f"usr/{folder}")
    for found in sorted(root.rglob("*")):
        path = PurePosixPath(found.relative_to(root))
        if path.parts[0] in _MERGED:
            path = "usr" / path
        if _LEFT_OUT.match(str(path)):
            continue
        if found.is_symlink():
            archive.add_symlink(path, str(found.readlink()))
        elif found.is_file():
            archive.add(path, found.read_bytes(), found.stat().st_mode & 0o755)

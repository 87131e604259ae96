"""Findings about ROS on this machine: what is installed, what it carries, and its environment variables."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import SAFE_DOMAIN, Check, Finding, Grade, RosError, Wording
from rsb_bridge.model.limits import DOMAIN, dds_ports
from rsb_bridge.ros.discovery import RANGE, SERVERS, SUPER_CLIENT, Discovery, DiscoveryText, is_off
from rsb_bridge.ros.distribution import (
    check_libraries,
    check_middleware,
    check_shared_memory,
    described,
    distribution,
    rclpy_version,
)
from rsb_bridge.ros.memory import PROFILE_VARIABLES, profile_for_large
from rsb_bridge.ros.security import Security
from rsb_extras.doctor import large_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_SELF_TEST = (sys.executable, "-P", "-m", "rsb_bridge.ros.self_test")
_CONFIGS = Path(sys.prefix, "share/rsb_console/configs")
_WITHIN = 20.0
"""s for the self-test: to import ROS takes 1 s, on a small computer several."""
_RANGES = {
    "SUBNET": "nodes of this subnet",
    "LOCALHOST": "nodes of this machine",
    "OFF": "no other node",
    "SYSTEM_DEFAULT": "as DDS has it",
}


class RosText(Wording):
    """Findings about ROS, and remedies."""

    NOT_INSTALLED_REMEDY = (
        "source the setup file of your ROS 2 (/opt/ros/jazzy/setup.bash), or on x86-64 Linux: "
        "pip install 'rsb-console[ros]'"
    )
    NOT_SOURCED = "ROS 2 is installed, but not sourced in this shell ({setups})"
    OTHER_PYTHON_REMEDY = (
        "install rsb-console with that Python: pipx install --force --system-site-packages --python python{theirs} ."
    )
    WORKS = "{ros}, {middleware}: types that are not installed cross, too"
    FAILED = "{ros} does not start: {problem}"
    FAILED_REMEDY = "try without the bridge: python3 -c 'import rclpy; rclpy.init()'"
    NO_NUMPY = "numpy is not installed for this Python: ROS's messages with arrays need it, and so pictures"
    NO_NUMPY_REMEDY = "install rsb-console with the distribution's packages: pipx install --system-site-packages …"
    DOMAIN = "domain {domain}, discovers {range}"
    DOMAIN_INVALID = "ROS_DOMAIN_ID is {value!r}: it has to be a number, {range}"
    DOMAIN_COLLIDES = (
        "domain {domain} uses UDP ports {ports}, which Linux gives to other programs, too; {range} does not"
    )
    HIDDEN = "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: ROS finds no other node, so a bridge carries nothing"
    SERVER_REMEDY = "fast-discovery-server -i {place} -p {port}, on the machine {host}; or correct ROS_DISCOVERY_SERVER"
    LARGE = "{arrived} of {sent} best-effort messages of {size:g} MB arrived in another process of this machine"
    LARGE_LOST = "{found}: Fast DDS loses those above 64 kB"
    LARGE_NOT_MEASURED = "not measured: {problem}"
    LARGE_REMEDY = "export {variable}={file}  # for the bridge, and for all nodes with such messages"
    NOT_DISCOVERED = "two processes of this machine did not discover each other"
    KEYS = "keystore {keystore}, enclave {enclave}"
    LOCALHOST_ONLY = (
        "ROS_LOCALHOST_ONLY=1 overrides ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS, and is obsolete"
    )
    LOCALHOST_ONLY_REMEDY = "unset ROS_LOCALHOST_ONLY; export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"


def checks(
    environ: Mapping[str, str],
    self_test: Sequence[str] = _SELF_TEST,
    large_test: Sequence[str] = large_messages.COMMAND,
    own_domain: int | None = None,
    root: Path = Path("/"),
) -> tuple[Check, ...]:
    """Return the checks of ROS.

    Args:
        self_test: command that prints what `rsb_bridge.ros.self_test.main` prints.
        large_test: command that prints what `rsb_extras.doctor.large_messages.main` prints.
        own_domain: the session's `domain_id`, which counts more than ``$ROS_DOMAIN_ID``, or None.
        root: in place of ``/`` for ``/opt/ros``.
    """
    return (
        Check("ros", "ROS", partial(_ros, environ, self_test, root)),
        Check("ros_domain", "ROS domain", partial(_environment, environ, own_domain)),
        Check("ros_discovery", "ROS discovery", partial(_discovery, environ)),
        Check("large_messages", "large messages", partial(_large_messages, environ, large_test)),
        Check("ros_security", "ROS security", partial(_security, environ)),
    )


def _ros(environ: Mapping[str, str], self_test: Sequence[str], root: Path) -> Iterator[Finding]:
    spec = importlib.util.find_spec("rclpy")
    unusable = _unusable(spec.origin if spec is not None else None, root)
    if unusable is not None:
        yield unusable
        return
    facts = {"distribution": distribution(), "rclpy": rclpy_version()}
    finding = partial(Finding, "ros", subject="ROS", facts=facts)
    try:
        # Before the self-test, whose process would end without a word on the remedy.
        check_libraries(environ)
        check_middleware(environ)
        check_shared_memory()
    except RosError as error:
        yield finding(grade=Grade.ERROR, text=str(error))
        return
    try:
        ran = subprocess.run(self_test, capture_output=True, text=True, timeout=_WITHIN, check=False)  # noqa: S603 -- own program
        # The last line only: Fast DDS writes its faults to standard output, too.
        result = json.loads(ran.stdout.splitlines()[-1]) if ran.returncode == 0 and ran.stdout else None
    except subprocess.TimeoutExpired:
        text = f"{described()} does not answer within {_WITHIN:g} s"
        yield finding(grade=Grade.ERROR, text=text, remedy=RosText.FAILED_REMEDY())
        return
    if result is None:
        if ran.returncode < 0:
            text = f"{described()} ends the process with {signal.Signals(-ran.returncode).name}"
        else:
            last = next(iter(ran.stderr.strip().splitlines()[-1:]), f"exit code {ran.returncode}")
            text = RosText.FAILED(ros=described(), problem=last)
        yield finding(grade=Grade.ERROR, text=text, remedy=RosText.FAILED_REMEDY())
        return
    # In place, because `finding` has it.
    facts |= {name: result[name] for name in ("middleware", "shortfalls", "seconds") if name in result}
    if "error" in result:
        text = RosText.FAILED(ros=described(), problem=result["error"])
        yield finding(grade=Grade.ERROR, text=text, remedy=RosText.FAILED_REMEDY())
    elif not result["shortfalls"]:
        yield finding(grade=Grade.OK, text=RosText.WORKS(ros=described(), middleware=result["middleware"]))
    if importlib.util.find_spec("numpy") is None:
        yield Finding("ros_numpy", Grade.WARNING, "ROS", RosText.NO_NUMPY(), RosText.NO_NUMPY_REMEDY(), facts)
    for shortfall in result.get("shortfalls", ()):
        yield Finding("ros_limited", Grade.WARNING, "ROS", shortfall, "docs/support.md lists what is tested", facts)


def _unusable(origin: str | None, root: Path) -> Finding | None:
    """Say why this Python cannot use ROS, or return None if it may.

    Args:
        origin: the file of the rclpy that this Python finds. A setup file sets ``PYTHONPATH``, so that any Python finds
            it, and only its own can load it.
        root: in place of ``/`` for ``/opt/ros``.
    """
    ours = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = [Path(origin).parent] if origin else sorted((root / "opt/ros").glob("*/lib/python3.*/site-packages/rclpy"))
    others = {place: theirs for place in found if (theirs := _python_of(place)) not in {"", ours}}
    finding = partial(Finding, "ros", Grade.ERROR, "ROS")
    if found and len(others) == len(found):
        place, theirs = next(iter(others.items()))
        text = f"ROS 2 in {place.parents[3]} is for Python {theirs}, and rsb-console runs with Python {ours}"
        facts = {"python": theirs, "prefix": str(place.parents[3])}
        return finding(text, RosText.OTHER_PYTHON_REMEDY(theirs=theirs), facts)
    if origin:
        return None
    setups = [
        setup
        for setup in sorted((root / "opt/ros").glob("*/setup.bash"))
        # To source a ROS for another Python is no remedy.
        if not any(place.is_relative_to(setup.parent) for place in others)
    ]
    if setups:
        listed = [str(setup) for setup in setups]
        text, remedy = RosText.NOT_SOURCED(setups=", ".join(listed)), f"source {quote(listed[0])}"
        return finding(text, remedy, {"setups": listed})
    return finding(f"ROS 2 is not installed for this Python ({sys.executable})", RosText.NOT_INSTALLED_REMEDY())


def _python_of(package: Path) -> str:
    """Return the version of the Python whose ``lib/python3.12/site-packages`` a package is in, or an empty string."""
    folder = package.parents[1].name
    return folder.removeprefix("python") if folder.startswith("python3.") else ""


def _environment(environ: Mapping[str, str], own_domain: int | None) -> Iterator[Finding]:
    value = (environ.get("ROS_DOMAIN_ID", "").strip() or "0") if own_domain is None else str(own_domain)
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or "SUBNET"
    facts = {name: environ[name] for name in environ if name.startswith("ROS_") or name in PROFILE_VARIABLES}
    finding = partial(Finding, "ros_domain", subject="ROS domain", facts=facts)
    remedy = f"export ROS_DOMAIN_ID=0, or any of {SAFE_DOMAIN}"
    if not value.isdecimal() or int(value) not in DOMAIN:
        yield finding(grade=Grade.ERROR, text=RosText.DOMAIN_INVALID(value=value, range=DOMAIN), remedy=remedy)
    elif int(value) not in SAFE_DOMAIN:
        text = RosText.DOMAIN_COLLIDES(domain=value, ports=dds_ports(int(value)), range=SAFE_DOMAIN)
        yield finding(grade=Grade.WARNING, text=text, remedy=remedy)
    elif is_off(environ):
        yield finding(grade=Grade.ERROR, text=RosText.HIDDEN(), remedy=f"unset {RANGE}")
    elif reach.upper() in _RANGES:
        yield finding(grade=Grade.OK, text=RosText.DOMAIN(domain=value, range=_RANGES[reach.upper()]))
    if reach.upper() not in _RANGES:
        text = f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach!r}: ROS knows {', '.join(_RANGES)}"
        yield finding(grade=Grade.WARNING, text=text, remedy="unset ROS_AUTOMATIC_DISCOVERY_RANGE")
    if environ.get("ROS_LOCALHOST_ONLY", "0") == "1":
        text, remedy = RosText.LOCALHOST_ONLY(), RosText.LOCALHOST_ONLY_REMEDY()
        yield finding(grade=Grade.WARNING, text=text, remedy=remedy)
    for variable in PROFILE_VARIABLES:
        path = environ.get(variable, "")
        if path and not Path(path).is_file():
            text = f"{variable} names {path}, which does not exist: Fast DDS ignores it"
            yield finding(grade=Grade.WARNING, text=text, remedy=f"unset {variable}, or correct the path")


def _discovery(environ: Mapping[str, str]) -> Iterator[Finding]:
    discovery = Discovery(environ)
    facts = {name: environ[name] for name in (SERVERS, SUPER_CLIENT) if name in environ}
    finding = partial(Finding, "ros_discovery", subject="ROS discovery", facts=facts)
    if discovery.is_broken and not is_off(environ):
        yield finding(grade=Grade.ERROR, text=discovery.found, remedy=f"export {SERVERS}=10.0.0.1:11811")
    problems = discovery.problems()
    # Several servers are for redundancy.
    bad = Grade.ERROR if all(problems.values()) else Grade.WARNING
    for server, problem in problems.items():
        if problem:
            remedy = RosText.SERVER_REMEDY(place=server.place, port=server.port, host=server.host)
            yield finding(grade=bad, text=problem, remedy=remedy)
        else:
            yield finding(grade=Grade.OK, text=DiscoveryText.ANSWERS(server=server))


def _large_messages(environ: Mapping[str, str], large_test: Sequence[str]) -> Iterator[Finding]:
    if importlib.util.find_spec("rclpy") is None:
        return
    surroundings = large_messages.surroundings(environ)
    ran = subprocess.run(large_test, capture_output=True, text=True, timeout=2 * _WITHIN, check=False, env=surroundings)  # noqa: S603 -- own program
    finding = partial(Finding, "large_messages", subject="large messages")
    if ran.returncode or not ran.stdout:
        problem = (ran.stderr.splitlines() or ["no result"])[-1]
        yield finding(grade=Grade.UNKNOWN, text=RosText.LARGE_NOT_MEASURED(problem=problem))
        return
    # The last line only: Fast DDS writes its faults to standard output, too.
    facts = json.loads(ran.stdout.splitlines()[-1])
    finding = partial(finding, facts=facts | {"size": large_messages.SIZE})
    text = RosText.LARGE(arrived=facts["arrived"], sent=facts["sent"], size=large_messages.SIZE / 1e6)
    if facts["arrived"] < facts["sent"]:
        variable, name = profile_for_large(environ)
        installed = _CONFIGS / name
        file = installed if installed.exists() else f"…/{installed.name}"
        remedy = RosText.LARGE_REMEDY(variable=variable, file=file)
        yield finding(grade=Grade.NOTE, text=RosText.LARGE_LOST(found=text), remedy=remedy)
    elif facts["sent"]:
        yield finding(grade=Grade.OK, text=text)
    else:
        yield finding(grade=Grade.UNKNOWN, text=RosText.NOT_DISCOVERED())


def _security(environ: Mapping[str, str]) -> Iterator[Finding]:
    security = Security(environ)
    if not security.is_on:
        return
    facts = {name: environ[name] for name in environ if name.startswith("ROS_SECURITY_")}
    finding = partial(Finding, "ros_security", subject="ROS security", facts=facts)
    if problem := security.problem:
        grade = Grade.ERROR if security.is_enforced else Grade.WARNING
        yield finding(grade=grade, text=problem, remedy=security.remedy)
    else:
        yield finding(grade=Grade.OK, text=RosText.KEYS(keystore=security.keystore, enclave=security.enclave))

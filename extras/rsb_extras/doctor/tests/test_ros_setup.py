"""Findings of `rsb-console doctor` about ROS. Programs that crash, hang or fail replace the self-test."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from tests.support import surroundings
from tests.support.discovery_server import discovery_server
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.model.finding import Finding, Grade, examine
from rsb_bridge.ros.memory import LARGE_MESSAGES, profile_variable
from rsb_extras.doctor import ros_setup
from rsb_extras.doctor.tests import doctor_places


def found(code: str, environ: dict[str, str] | None = None, program: str | None = None) -> list[Finding]:
    checks = (
        ros_setup.checks(environ or {})
        if program is None
        else ros_setup.checks(environ or {}, (sys.executable, "-c", program))
    )
    return list(examine(check for check in checks if check.code == code))


def test_the_real_self_test() -> None:
    (finding,) = found("ros")
    assert (finding.grade, finding.facts["middleware"]) == (Grade.OK, "rmw_fastrtps_cpp")
    assert finding.facts["distribution"] in {"jazzy", "kilted"}


@pytest.mark.parametrize(
    ("program", "within"),
    [
        ("import os; os.kill(os.getpid(), 11)", "SIGSEGV"),
        ("import time; time.sleep(60)", "0.5 s"),
        ("raise SystemExit('no library')", "no library"),
        ("", ""),
        ('print(\'{"error": "it differs", "seconds": 0}\')', "it differs"),
    ],
)
def test_what_ends_or_stops_self_test_is_found(program: str, within: str, monkeypatch: pytest.MonkeyPatch) -> None:
    doctor_places.ROS_SETUP_WITHIN.set(monkeypatch, 0.5 if "sleep" in program else 20.0)
    (finding,) = found("ros", program=program)
    assert finding.grade == Grade.ERROR
    assert within in finding.text
    assert finding.remedy


def test_what_is_lost_is_listed() -> None:
    (finding,) = found("ros", program='print(\'{"middleware": "a", "shortfalls": ["no calls"], "seconds": 0}\')')
    assert (finding.code, finding.grade, finding.text) == ("ros_limited", Grade.WARNING, "no calls")


def test_ros_without_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "numpy")
    (works, lacks) = found("ros")
    assert (works.grade, lacks.code, lacks.grade) == (Grade.OK, "ros_numpy", Grade.WARNING)


def test_without_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "rclpy")
    (finding,) = found("ros", program="raise SystemExit('not run')")
    assert finding.grade == Grade.ERROR
    assert "rsb-console[ros]" in finding.remedy


def opt_ros(root: Path, distribution: str, python: str) -> Path:
    """Make what an installation of ROS has of setup files and rclpy. Return the folder for ``PYTHONPATH``."""
    prefix = root / "opt/ros" / distribution
    rclpy = prefix / "lib" / f"python{python}" / "site-packages/rclpy"
    rclpy.mkdir(parents=True)
    (rclpy / "__init__.py").touch()
    (prefix / "setup.bash").touch()
    return rclpy.parent


OURS = f"{sys.version_info.major}.{sys.version_info.minor}"


def found_in(root: Path) -> Finding:
    checks = ros_setup.checks({}, (sys.executable, "-c", "raise SystemExit('not run')"), root=root)
    (finding,) = examine(check for check in checks if check.code == "ros")
    return finding


def test_ros_that_is_not_sourced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "rclpy")
    opt_ros(tmp_path, "another", "3.1")
    assert (found_in(tmp_path).grade, found_in(tmp_path).facts.get("python")) == (Grade.ERROR, "3.1")
    opt_ros(tmp_path, "jazzy", OURS)
    finding = found_in(tmp_path)
    setup = str(tmp_path / "opt/ros/jazzy/setup.bash")
    assert (finding.grade, finding.facts) == (Grade.ERROR, {"setups": [setup]})
    assert setup in finding.remedy


def test_ros_that_is_sourced_and_for_another_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its setup file adds its packages to ``PYTHONPATH``, so that this Python finds rclpy."""
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    monkeypatch.syspath_prepend(opt_ros(tmp_path, "jazzy", "3.1"))
    finding = found_in(tmp_path)
    assert (finding.grade, finding.facts) == (Grade.ERROR, {"python": "3.1", "prefix": str(tmp_path / "opt/ros/jazzy")})
    assert "python3.1" in finding.remedy


def test_a_middleware_that_is_not_installed() -> None:
    (finding,) = found("ros", {"RMW_IMPLEMENTATION": "rmw_nonsense_cpp"}, "raise SystemExit('not run')")
    assert (finding.grade, "rmw_nonsense_cpp" in finding.text) == (Grade.ERROR, True)


@pytest.mark.parametrize(
    ("environ", "grades"),
    [
        ({}, [Grade.OK]),
        ({"ROS_DOMAIN_ID": " 5 ", "ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}, [Grade.OK]),
        ({"ROS_DOMAIN_ID": "five"}, [Grade.ERROR]),
        ({"ROS_DOMAIN_ID": "233"}, [Grade.ERROR]),
        ({"ROS_DOMAIN_ID": "150"}, [Grade.WARNING]),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "WORLD"}, [Grade.WARNING]),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, [Grade.ERROR]),
        ({"ROS_LOCALHOST_ONLY": "1"}, [Grade.OK, Grade.WARNING]),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/no/such.xml"}, [Grade.OK, Grade.WARNING]),
    ],
)
def test_the_environment(environ: dict[str, str], grades: list[Grade]) -> None:
    findings = found("ros_domain", environ)
    assert [each.grade for each in findings] == grades
    assert all(each.remedy for each in findings if each.grade != Grade.OK)
    assert findings[0].facts == environ


def test_sessions_own_domain_counts_more_than_environments() -> None:
    checks = ros_setup.checks({"ROS_DOMAIN_ID": "five"}, own_domain=3)
    (finding,) = examine(check for check in checks if check.code == "ros_domain")
    assert finding.grade == Grade.OK
    assert says(finding.text, ros_setup.RosText.DOMAIN, domain=3)


def test_a_profile_that_exists(tmp_path: Path) -> None:
    (tmp_path / "a.xml").touch()
    (finding,) = found("ros_domain", {"FASTDDS_DEFAULT_PROFILES_FILE": str(tmp_path / "a.xml")})
    assert finding.grade == Grade.OK


def test_discovery_servers_are_asked() -> None:
    port, other = free_port(), free_port()
    listed = f"127.0.0.1:{port};127.0.0.1:{other}"
    with discovery_server(port):
        findings = found("ros_discovery", {"ROS_DISCOVERY_SERVER": listed})
    assert [each.grade for each in findings] == [Grade.OK, Grade.WARNING]
    assert findings[0].facts == {"ROS_DISCOVERY_SERVER": listed}
    findings = found("ros_discovery", {"ROS_DISCOVERY_SERVER": listed})
    assert [each.grade for each in findings] == [Grade.ERROR, Grade.ERROR]
    assert str(other) in findings[1].text + findings[1].remedy
    (finding,) = found("ros_discovery", {"ROS_DISCOVERY_SERVER": "127.0.0.1:a"})
    assert finding.grade == Grade.ERROR
    assert found("ros_discovery", {}) == []


def test_secured_domain_needs_keys(tmp_path: Path) -> None:
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    (finding,) = found("ros_security", secured)
    assert (finding.grade, finding.facts) == (Grade.WARNING, secured)
    (finding,) = found("ros_security", secured | {"ROS_SECURITY_STRATEGY": "Enforce"})
    assert (finding.grade, str(tmp_path) in finding.remedy) == (Grade.ERROR, True)
    (tmp_path / "enclaves").mkdir()
    (finding,) = found("ros_security", secured)
    assert finding.grade == Grade.OK
    assert found("ros_security", {}) == []


PROFILE = Path(__file__).parents[4] / "configs" / LARGE_MESSAGES[profile_variable(os.environ)]


def test_large_messages_cross_within_machine_with_profile() -> None:
    """With the middleware's defaults, mostly none of five does."""
    profile = os.environ | {profile_variable(os.environ): str(PROFILE)}

    def crossed() -> Finding | None:  # on a busy machine not at once
        return next((each for each in found("large_messages", profile) if each.facts["arrived"] == 5), None)

    finding = eventually(crossed)
    assert (finding.grade, finding.facts) == (Grade.OK, {"sent": 5, "arrived": 5, "size": 3_000_000})


@pytest.mark.parametrize(
    ("printed", "grades"),
    [
        ('{"sent": 5, "arrived": 2}', [Grade.NOTE]),
        ('{"sent": 0, "arrived": 0}', [Grade.UNKNOWN]),
        ("", [Grade.UNKNOWN]),
    ],
)
def test_result_of_large_messages(printed: str, grades: list[Grade]) -> None:
    program = (sys.executable, "-c", f"print({printed!r}, end='')")
    checks = [each for each in ros_setup.checks({}, large_test=program) if each.code == "large_messages"]
    findings = list(examine(checks))
    assert [each.grade for each in findings] == grades
    if "2" in printed:
        assert "2 of 5 best-effort messages of 3 MB" in findings[0].text
        assert PROFILE.name in findings[0].remedy

"""Secured domains whose keys this process lacks."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from tests.ros.domains import DOMAIN
from tests.support.wording import says

from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import RosError, RosProblem
from rsb_bridge.ros.security import Security, SecurityText

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.model.wording import Wording


@pytest.mark.parametrize(
    ("is_named", "has_folder", "text"),
    [
        (False, False, SecurityText.NO_KEYSTORE),
        (True, False, SecurityText.NO_ENCLAVE),
        (True, True, SecurityText.NOT_JOINED),
    ],
)
def test_enforced_domain_is_not_joined(
    is_named: bool, has_folder: bool, text: Wording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names variable, keystore and enclave, and does not ask for another rsb-console."""
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/bridges/robot1")
    if is_named:
        monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    if has_folder:
        (tmp_path / "enclaves/bridges/robot1").mkdir(parents=True)
    with pytest.raises(RosError) as raised:
        RosNode(DOMAIN, "robot1").start()
    named = {"keystore": tmp_path, "enclave": "/bridges/robot1"} if is_named else {}
    assert says(raised.value, text, **named)


def test_permissive_domain_is_joined_unsecured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    node = RosNode(DOMAIN, "robot1")
    node.start()
    with pytest.raises(RosError, match=re.escape(RosProblem.NO_MIRROR_SECURED())):
        node.mirrors.add("/lidar")
    node.stop()
    assert any(says(each, SecurityText.UNSECURED) for each in node.shortfalls)


def test_domain_that_has_keys_or_needs_none(tmp_path: Path) -> None:
    (tmp_path / "enclaves/a").mkdir(parents=True)
    environment = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
        "ROS_SECURITY_ENCLAVE_OVERRIDE": "/a",
    }
    assert Security(environment).problem == ""
    assert Security(environment | {"ROS_SECURITY_ENABLE": "false"}).problem == ""
    assert says(Security(environment | {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/b"}).problem, SecurityText.NO_ENCLAVE)

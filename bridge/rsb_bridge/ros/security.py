"""Secured domains of ROS (SROS 2), by the environment: the keystore and the enclave of this process."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Mapping


class SecurityText(Wording):
    """Texts about secured domains, for operators, and the remedies."""

    NOT_JOINED = "{reason}: ROS_SECURITY_ENABLE is true, with keystore {keystore} and enclave {enclave}: {remedy}"
    NO_KEYSTORE = "ROS_SECURITY_ENABLE is true, but ROS_SECURITY_KEYSTORE is not set"
    NO_ENCLAVE = "ROS_SECURITY_ENABLE is true, but keystore {keystore} has no enclave {enclave}"
    UNSECURED = "{problem}: the bridge is not secured, and hears no secured node: {remedy}"
    CREATE = "ros2 security create_enclave {keystore} {enclave}, or correct ROS_SECURITY_ENCLAVE_OVERRIDE"
    SET_KEYSTORE = "export ROS_SECURITY_KEYSTORE, or unset ROS_SECURITY_ENABLE"


class Security:
    """Security of nodes, as the environment demands it.

    Attributes:
        is_on: whether nodes are to be secured.
        is_enforced: whether a node without keys must not start; else it joins unsecured.
        keystore: its folder, or empty if it is not named.
        problem: why this process has no keys, or empty if it seems to have them, or needs none.
        remedy: a command for that.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.is_on = environment.get("ROS_SECURITY_ENABLE", "") == "true"
        self.is_enforced = environment.get("ROS_SECURITY_STRATEGY", "") == "Enforce"
        self.keystore = environment.get("ROS_SECURITY_KEYSTORE", "")
        self.enclave = environment.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "") or "/"
        self.problem = ""
        self.remedy = SecurityText.CREATE(keystore=self.keystore, enclave=self.enclave)
        if not self.is_on:
            return
        if not self.keystore:
            self.problem, self.remedy = SecurityText.NO_KEYSTORE(), SecurityText.SET_KEYSTORE()
        elif not Path(self.keystore, "enclaves", self.enclave.lstrip("/")).is_dir():
            self.problem = SecurityText.NO_ENCLAVE(keystore=self.keystore, enclave=self.enclave)

    def unsecured(self) -> str:
        """Return the reason why ROS joins the domain unsecured, or an empty string."""
        if not self.problem or self.is_enforced:
            return ""
        return SecurityText.UNSECURED(problem=self.problem, remedy=self.remedy)

    def why_not_joined(self, reason: str) -> str:
        """Explain why the domain could not be joined, by rcl's reason."""
        if not self.is_on:
            return reason
        if self.problem:
            return f"{self.problem}: {self.remedy}"
        return SecurityText.NOT_JOINED(
            reason=reason.rstrip(". "), keystore=self.keystore, enclave=self.enclave, remedy=self.remedy
        )

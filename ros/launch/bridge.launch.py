"""Runs a bridge without a console: ``ros2 launch rsb_console bridge.launch.py session:=robot1.yaml``."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration

_YES_NO = ("true", "false")
_ENDS_WITHIN = "10"  # s, twice what a bridge takes at most to say goodbye to its peers


def generate_launch_description() -> LaunchDescription:
    """One bridge; what the arguments do is shown by ``ros2 launch -s``."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("session", description="session file, from the folder of `ros2 launch`"),
            DeclareLaunchArgument("log_format", default_value="text", choices=("text", "json")),
            DeclareLaunchArgument("status_every", default_value="5", description="s from one status line to the next"),
            DeclareLaunchArgument(
                "control", default_value="", description="path of the control socket, if not the usual"
            ),
            DeclareLaunchArgument("respawn", default_value="false", choices=_YES_NO, description="start it again"),
            DeclareLaunchArgument("respawn_delay", default_value="5", description="s until it is started again"),
            DeclareLaunchArgument(
                "required", default_value="false", choices=_YES_NO, description="end everything launched with it"
            ),
            OpaqueFunction(function=_bridge),
        ]
    )


def _bridge(context: LaunchContext) -> list[ExecuteProcess]:
    def given(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    program = Path(get_package_prefix("rsb_console"), "lib", "rsb_console", "rsb-console")
    command = [str(program), "run", str(Path(given("session")).expanduser()), "--no-ui"]
    command += ["--log-format", given("log_format"), "--status-every", given("status_every")]
    if control := given("control"):
        command += ["--control", control]
    return [
        ExecuteProcess(
            cmd=command,
            name="rsb_console",
            output="screen",
            sigterm_timeout=_ENDS_WITHIN,
            respawn=given("respawn") == "true",
            respawn_delay=float(given("respawn_delay")),
            on_exit=[Shutdown(reason="the bridge has ended")] if given("required") == "true" else None,
        )
    ]

"""Names of messages' types: short ones, and their forms."""

from __future__ import annotations

import difflib
import re

from rsb_bridge.model.wording import Wording

# common_interfaces of ROS 2 Jazzy, and what else nearly every robot publishes.
_PACKAGES = {
    "actionlib_msgs": "GoalID GoalStatus GoalStatusArray",
    "diagnostic_msgs": "DiagnosticArray DiagnosticStatus KeyValue",
    "geometry_msgs": """
        Accel AccelStamped AccelWithCovariance AccelWithCovarianceStamped Inertia InertiaStamped Point Point32
        PointStamped Polygon PolygonInstance PolygonInstanceStamped PolygonStamped Pose Pose2D PoseArray
        PoseStamped PoseWithCovariance PoseWithCovarianceStamped Quaternion QuaternionStamped Transform
        TransformStamped Twist TwistStamped TwistWithCovariance TwistWithCovarianceStamped Vector3
        Vector3Stamped VelocityStamped Wrench WrenchStamped
    """,
    "nav_msgs": "Goals GridCells MapMetaData OccupancyGrid Odometry Path",
    "rosgraph_msgs": "Clock",
    "sensor_msgs": """
        BatteryState CameraInfo ChannelFloat32 CompressedImage FluidPressure Illuminance Image Imu JointState
        Joy JoyFeedback JoyFeedbackArray LaserEcho LaserScan MagneticField MultiDOFJointState MultiEchoLaserScan
        NavSatFix NavSatStatus PointCloud PointCloud2 PointField Range RegionOfInterest RelativeHumidity
        Temperature TimeReference
    """,
    "shape_msgs": "Mesh MeshTriangle Plane SolidPrimitive",
    "std_msgs": """
        Bool Byte ByteMultiArray Char ColorRGBA Empty Float32 Float32MultiArray Float64 Float64MultiArray Header
        Int16 Int16MultiArray Int32 Int32MultiArray Int64 Int64MultiArray Int8 Int8MultiArray
        MultiArrayDimension MultiArrayLayout String UInt16 UInt16MultiArray UInt32 UInt32MultiArray UInt64
        UInt64MultiArray UInt8 UInt8MultiArray
    """,
    "stereo_msgs": "DisparityImage",
    "tf2_msgs": "TFMessage",
    "trajectory_msgs": "JointTrajectory JointTrajectoryPoint MultiDOFJointTrajectory MultiDOFJointTrajectoryPoint",
    "visualization_msgs": """
        ImageMarker InteractiveMarker InteractiveMarkerControl InteractiveMarkerFeedback InteractiveMarkerInit
        InteractiveMarkerPose InteractiveMarkerUpdate Marker MarkerArray MenuEntry MeshFile UVCoordinate
    """,
}

SHORT_NAMES: dict[str, str] = {
    name: f"{package}/msg/{name}" for package, names in _PACKAGES.items() for name in names.split()
}
"""Full type name by short name; no two of these packages share one."""

# Packages and types are named alike in ROS 2's interface naming rules; srv and action hold the messages that service
# events and actions travel in.
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)")


class TypeNameProblem(Wording):
    INVALID = "{name!r} is not a message type: write it as package/msg/Name"
    SHORT_NAME_UNKNOWN = "{name!r} is not a known short type name: write it as package/msg/Name"
    SHORT_NAME_MISSPELT = "{name!r} is not a known short type name: did you mean {names}?"


def split_type_name(type_name: str) -> tuple[str, str, str]:
    """Take ``pkg/msg/Name`` apart.

    Returns:
        Package, kind (``msg``, or ``srv`` or ``action`` for the messages inside those) and name.

    Raises:
        ValueError: it is not of that form.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise ValueError(TypeNameProblem.INVALID(name=type_name))
    package, kind, name = match.groups()
    return package, kind, name


def expand_type_name(name: str) -> str:
    """Return the full name of a type, given the full or a short one.

    Args:
        name: ``pkg/msg/Name``, ``pkg/Name``, or the bare name of a common type (``LaserScan``).

    Returns:
        ``pkg/msg/Name``. Whether it is installed is not looked up.

    Raises:
        ValueError: no such short name, or none of these forms; the message suggests a name.
    """
    if "/" not in name:
        if name in SHORT_NAMES:
            return SHORT_NAMES[name]
        close = [SHORT_NAMES[match] for match in difflib.get_close_matches(name, SHORT_NAMES)]
        problem = TypeNameProblem.SHORT_NAME_MISSPELT if close else TypeNameProblem.SHORT_NAME_UNKNOWN
        raise ValueError(problem(name=name, names=" or ".join(close)))
    if name.count("/") == 1:
        name = name.replace("/", "/msg/")
    split_type_name(name)
    return name

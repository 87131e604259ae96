"""Names of doctor that its tests replace."""

from __future__ import annotations

from tests.support.places import Place

INSTALLED = Place("rsb_extras.doctor.machine", "installed")
LITTLE_SHARED_MEMORY = Place("rsb_extras.doctor.machine", "_LITTLE_SHARED_MEMORY")
LOCKED_WITHIN = Place("rsb_extras.doctor.machine", "_LOCKED_WITHIN")
ROS_SETUP_WITHIN = Place("rsb_extras.doctor.ros_setup", "_WITHIN")
INTERFACE_ADDRESS = Place("rsb_extras.doctor.machine", "_address")
INTERFACE_FLAGS = Place("rsb_extras.doctor.machine", "_flags")
CONGESTION_CONTROL = Place("rsb_extras.doctor.machine", "congestion_control")
GRANTED_RECEIVE_BUFFER = Place("rsb_extras.doctor.machine", "granted_receive_buffer")
OPEN_NEWS = Place("rsb_extras.doctor.machine", "open_news")
FURTHER_WAYS = Place("rsb_extras.doctor.session_needs", "_further_ways")
ADDRESSES = Place("rsb_extras.doctor.session_needs", "addresses")
MULTIPATH_PROBLEM = Place("rsb_extras.doctor.session_needs", "multipath.problem")
INTERFACES = Place("rsb_extras.doctor.machine", "socket.if_nameindex")
OPEN_FILES = Place("rsb_extras.doctor.machine", "resource.getrlimit")
DISK_USAGE = Place("rsb_extras.doctor.machine", "shutil.disk_usage")
FILE_SYSTEM = Place("rsb_extras.doctor.machine", "os.statvfs")
RUN = Place("rsb_extras.doctor.machine", "subprocess.run")

"""The checks of `rsb-console doctor`: of a machine, of its ROS, and of what a session needs."""

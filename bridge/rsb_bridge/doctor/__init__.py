"""What `rsb-console doctor` finds out about a machine, its ROS and what a session needs of them."""

"""The ROS side of the bridge. Importing this package does not import rclpy; `node` does."""

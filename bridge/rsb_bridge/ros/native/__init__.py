"""ROS's libraries from the inside: rclpy's extension module, rcl, rosidl's type supports and Fast CDR.

Names, signatures and struct layouts that ROS does not document, or may change with a distribution, are used here alone.
`self_test` finds out at start which of them hold.
"""

"""A fleet of robots: the sources of their states, the memory of robots that left, and changes from robot to robot."""

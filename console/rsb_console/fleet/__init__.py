"""A fleet of robots: where what is known of them comes from, what is remembered, and changes from robot to robot."""

"""Reading recordings: MCAP and sqlite3 files, and folders of them as rosbag2 writes them, none of which is trusted."""

"""The ROS package for a colcon workspace: what `ros2 run` and `ros2 launch` need. The program itself comes by pipx."""

from setuptools import setup

setup(
    name="rsb_console",
    version="1.0.0",
    packages=[],
    py_modules=[],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/rsb_console"]),
        ("share/rsb_console", ["package.xml"]),
        ("share/rsb_console/launch", ["launch/bridge.launch.py"]),
    ],
    scripts=["rsb-console"],
    zip_safe=True,
)

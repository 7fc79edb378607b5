"""The same call over ROS 2 in three ways: see docs/ros.md."""

"""ROS 2: photos come from topics, and answers, states and diagnostics go to topics.

    session     a node that spins in a thread of its own, which logs a callback's exceptions and goes on
    topics      a subscription to images: what comes, what does not fit, and what its stamps do
    camera      a Camera whose photos come from a topic
    position    the drone's place from MAVROS's or PX4's topics
    node        the lifecycle node of `upwash ros`

rclpy calls its callbacks in the thread of the session. They only hand values over to the event loop, and the loop
publishes: rclpy's publishers may be used from any thread. Nothing here sends a command to a vehicle.

No other room imports rclpy, and this room does so only if a configuration asks for ROS. ROS itself installs rclpy,
for the Python of the system: it is no dependency, and no extra.
"""

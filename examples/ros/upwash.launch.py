"""`ros2 launch upwash.launch.py config:=drone.toml`: the node, started again if it ends with an error.

Not tried: the `launch` package is not among the wheels that upwash is tested with.
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node of `upwash ros`, with the camera's topic as an argument."""
    images = LaunchConfiguration("images")
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value="drone.toml"),
            DeclareLaunchArgument("images", default_value="/camera/image/compressed"),
            ExecuteProcess(
                cmd=[
                    *("upwash", "ros", "--config", LaunchConfiguration("config")),
                    *("--ros-args", "-r", ["/camera/image/compressed:=", images]),
                ],
                output="screen",
                respawn=True,
                respawn_delay=2.0,
            ),
        ]
    )

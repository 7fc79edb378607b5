"""The MAVLink commands that act on a payload, and do not move, arm or reconfigure the vehicle itself.

Numbers and names are those of MAVLink's common message set (MAV_CMD). A mission may send no other command: it flies
the vehicle by methods that keep to the fence.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

DO_DIGICAM_CONTROL = 203
DO_GIMBAL_MANAGER_PITCHYAW = 1000
IMAGE_START_CAPTURE = 2000

PAYLOAD_COMMANDS: Mapping[int, str] = MappingProxyType(
    {
        181: "DO_SET_RELAY",
        182: "DO_REPEAT_RELAY",
        183: "DO_SET_SERVO",
        184: "DO_REPEAT_SERVO",
        187: "DO_SET_ACTUATOR",
        202: "DO_DIGICAM_CONFIGURE",
        DO_DIGICAM_CONTROL: "DO_DIGICAM_CONTROL",
        204: "DO_MOUNT_CONFIGURE",
        205: "DO_MOUNT_CONTROL",
        206: "DO_SET_CAM_TRIGG_DIST",
        211: "DO_GRIPPER",
        214: "DO_SET_CAM_TRIGG_INTERVAL",
        216: "DO_SPRAYER",
        405: "ILLUMINATOR_ON_OFF",
        530: "SET_CAMERA_MODE",
        531: "SET_CAMERA_ZOOM",
        532: "SET_CAMERA_FOCUS",
        534: "SET_CAMERA_SOURCE",
        DO_GIMBAL_MANAGER_PITCHYAW: "DO_GIMBAL_MANAGER_PITCHYAW",
        1001: "DO_GIMBAL_MANAGER_CONFIGURE",
        IMAGE_START_CAPTURE: "IMAGE_START_CAPTURE",
        2001: "IMAGE_STOP_CAPTURE",
        2003: "DO_TRIGGER_CONTROL",
        2500: "VIDEO_START_CAPTURE",
        2501: "VIDEO_STOP_CAPTURE",
        31010: "USER_1",
        31011: "USER_2",
        31012: "USER_3",
        31013: "USER_4",
        31014: "USER_5",
        42600: "DO_WINCH",
    }
)
MOST_PARAMETERS = 7

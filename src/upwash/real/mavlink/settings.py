"""When an action counts as complete, and how long the driver waits."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class DriverPatience:
    """How long the driver waits for reports and answers."""

    answer_s: float = 1.0  # for the answer to a command, before it is repeated
    effect_s: float = 2.5  # for the mode or the motors to change, before the command is repeated
    attempts: int = 8
    others_s: float = 2.5  # for the heartbeats of other vehicles, which come once a second
    signed_s: float = 4.0  # for any answer of a vehicle that signs its messages
    quiet_after_s: float = 2.5  # without any message, the link counts as lost, and attempts no longer count
    dead_after_s: float = 10.0  # without any message, TCP reconnects, and the vehicle may have another port
    lost_after_s: float = 120.0  # without any message, the verb in progress fails


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """When an action counts as complete, and when it has taken too long; silences of the link do not count."""

    arrival_distance_m: float = 1.0
    arrival_speed_m_s: float = 0.5
    progress_m: float = 0.5
    progress_s: float = 3.0  # without that progress in this time, the target is repeated
    speed_tolerance: float = 1.1  # times the ground speed, above which the speed is repeated
    speed_again_s: float = 5.0
    ready_timeout_s: float = 120.0  # for the checks before arming
    arm_again_s: float = 2.0
    ask_again_s: float = 5.0  # for the reasons why it cannot be armed
    words_s: float = 0.5  # for its reasons, which come in separate messages
    margin_s: float = 60.0  # of a flight, on top of its distance at the slowest speeds below
    slowest_share: float = 1 / 3  # of the ground speed, against the wind
    slowest_vertical_m_s: float = 0.4
    return_altitude_m: float = 100.0  # the vehicle may climb to this height before it returns
    patience: DriverPatience = field(default_factory=DriverPatience)

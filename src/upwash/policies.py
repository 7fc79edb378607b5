"""What a policy of one's own is written with: docs/own-policy.md.

Public are the names in `__all__`, as those of `upwash`.
"""

from __future__ import annotations

from upwash.core.geo import Circle, Measured, Position
from upwash.core.knowledge.servers import State
from upwash.core.operation import Operation
from upwash.core.planning.acts import Gap, LateAct
from upwash.core.planning.backlog import Stay, WaitPlace
from upwash.core.planning.earliest import Lane, Line, Take, WaitingCall
from upwash.core.planning.forecast import Forecast
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer
from upwash.core.policies.look_ahead import LookAhead
from upwash.core.policies.policy import (
    BuiltInRules,
    CallInputs,
    Choice,
    Coming,
    Deadline,
    Decision,
    Inputs,
    Lightened,
    Local,
    LocationAware,
    Opportunistic,
    Option,
    Policy,
    Remote,
    Situation,
    Wait,
    WaitRule,
)

__all__ = [
    "BuiltInRules",
    "CallInputs",
    "CheckTimes",
    "Choice",
    "Circle",
    "Coming",
    "ComingCall",
    "Deadline",
    "Decision",
    "Forecast",
    "Gap",
    "Inputs",
    "Lane",
    "LateAct",
    "Lightened",
    "Line",
    "Local",
    "LocationAware",
    "LookAhead",
    "Measured",
    "Offer",
    "Operation",
    "Opportunistic",
    "Option",
    "Policy",
    "Position",
    "Remote",
    "Situation",
    "State",
    "Stay",
    "Take",
    "Wait",
    "WaitPlace",
    "WaitRule",
    "WaitingCall",
]

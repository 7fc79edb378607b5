"""What the parts of the machine share: what the drone knows, when and where it is, and what it does then."""

from __future__ import annotations

from dataclasses import dataclass, field

from upwash.core.geo import Position
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import Server, ServerTable, Trigger
from upwash.core.policies.policy import Policy
from upwash.core.selection.commands import Effect
from upwash.core.selection.lanes import Lanes
from upwash.core.selection.recovery import Recovery
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog import schema


@dataclass(slots=True, eq=False)
class Moment:
    """What the drone knows at one time and place, and the effects of what happens there, in their order."""

    policy: Policy
    settings: SelectionSettings
    table: ServerTable
    estimates: Estimates
    recovery: Recovery
    lanes: Lanes = field(default_factory=Lanes)
    now_s: float = 0.0
    here: Position = field(default_factory=lambda: Position(0.0, 0.0))
    effects: list[Effect] = field(default_factory=list)
    changed: bool = True  # what the policy chooses from, since it last chose

    def locate(self, position: Position, now_s: float) -> None:
        """Go on to that time and place, where nothing has happened yet."""
        is_known = self.now_s == now_s and self.here is position
        self.now_s, self.here, self.effects = now_s, position, []
        if not is_known and (self.table.locate(position, now_s) | self.estimates.locate(position)):
            self.changed = True

    def step(self, server: Server, trigger: Trigger, why: str = "") -> None:
        """Change the server's state; the log's event has the mean delays that are expected now."""
        before, estimates = server.state, self.estimates
        server.apply(trigger, now_s=self.now_s)
        self.effects.append(
            schema.STEPS[trigger](
                server=server.name,
                before=before,
                after=server.state,
                why=why,
                check=server.check,
                local_mean_call_s=estimates.mean_call_s(),
                mean_call_s={each.name: estimates.mean_call_s(each.name) for each in self.table.in_range},
                position=self.here,
            )
        )


class Part:
    """A part of the machine, which shares the moment with the others."""

    def __init__(self, moment: Moment) -> None:
        self._moment = moment
        self._policy, self._settings = moment.policy, moment.settings
        self._table, self._estimates = moment.table, moment.estimates
        self._recovery, self._lanes = moment.recovery, moment.lanes

    @property
    def _now_s(self) -> float:
        return self._moment.now_s

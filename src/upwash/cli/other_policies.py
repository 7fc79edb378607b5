"""What other policies would have done: an option of the commands that show flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from upwash.errors import UsageError
from upwash.eventlog.log import EventLog
from upwash.eventlog.results import RunResult

OTHERS_FLY = "fly other policies in this world to compare; its programs run (default: none)"


def others_flown(logs: Sequence[Path], scenario: Path | None) -> Mapping[str, RunResult]:
    """What every policy does in the world of the scenario, flown for the one log; empty without a scenario."""
    if scenario is None:
        return {}
    if len(logs) != 1:
        raise UsageError(
            f"--scenario {scenario} is the world of one log, and {len(logs)} are given: give one"
        )
    from upwash.lab.explanation import replay

    return replay(EventLog(logs[0]), scenario).runs

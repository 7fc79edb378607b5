"""upwash explain: says why each call of a flight ran where it ran."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import OneOf, option, reads, whole
from upwash.cli.other_policies import OTHERS_FLY
from upwash.lab.explanation import CallChoice, show_explanation

ARGUMENTS = {
    "log LOG": reads("an event log, of `fly`, `demo` or `simulate`"),
    "--scenario FILE": reads(OTHERS_FLY),
    "--drone NAME": "the drone of that world whose policy changes (default: the log's)",
    "calls": OneOf(
        {
            "--waypoint N": option("the calls of that waypoint alone", type=whole),
            "--worst N": "only the N calls that lost most against the best place expected for them",
        }
    ),
}


def run(options: argparse.Namespace) -> None:
    """Explain the calls."""
    wanted = CallChoice(options.waypoint, options.worst)
    show_explanation(options.log, scenario=options.scenario, drone=options.drone, wanted=wanted)

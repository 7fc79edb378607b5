"""upwash demo: flies the demonstration."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import (
    CALLS,
    FOLDER,
    LIVE,
    count,
    live_of,
    new_run_folder,
    option,
    policy_instead_of,
    reads,
    require_linux,
)
from upwash.errors import UsageError
from upwash.support.input_files import read_named_text
from upwash.support.loading import extra

_MOST_RUNTIME_BYTES = 100_000
_MOST_DRONES = 8  # most computers cannot render photos for more


def _drones(text: str) -> int:
    number = count(text)
    if number > _MOST_DRONES:
        raise argparse.ArgumentTypeError(f"{number} drones are too many: give a number up to {_MOST_DRONES}")
    return number


_DRONES = f"fly N drones at once, each with its own program (default: 1; at most {_MOST_DRONES})"
_STAY_OR_GO = "whether to fly on before an answer is there, instead of policy.stay_or_go"
ARGUMENTS = {
    "--drones N": option(_DRONES, type=_drones, default=1),
    **FOLDER,
    "--runtime FILE": reads("a table [runtime] for both daemons, such as containers"),
    **policy_instead_of("the demonstration's"),
    "--moving": "take the photos in flight, along rows without stops",
    "--stay-or-go": option(_STAY_OR_GO, choices=("stay", "go", "learn")),
    **CALLS,
    **LIVE,
}


def run(options: argparse.Namespace) -> bool:
    """Fly the demonstration; true where every flight was completed."""
    require_linux("demo")
    if options.calls and options.drones > 1:
        raise UsageError("--calls prints the calls of one drone: leave it out, or give --drones 1")
    with extra("detector"):
        from upwash.cli.demonstration import fly_demonstration, read_demonstration
    config = read_demonstration(policy=options.policy, stay_or_go=options.stay_or_go, moving=options.moving)
    folder = options.folder or new_run_folder()
    runtime = read_named_text(options.runtime, most_bytes=_MOST_RUNTIME_BYTES) if options.runtime else ""
    if options.drones == 1:
        fly_demonstration(folder, config, runtime=runtime, live=live_of(options), calls=options.calls)
        return True
    with extra("emulation"):
        from upwash.cli.demonstration_fleet import fly_fleet
    return fly_fleet(folder, config, options.drones, runtime=runtime, live=live_of(options))

"""An emulation as the command runs it: enclosed, with its outcome printed at the end."""

from __future__ import annotations

from pathlib import Path

import msgspec
from rich.console import Console

from upwash.config.drone_file import read_drone_config
from upwash.emulation.enclosure import run_enclosed
from upwash.emulation.native import native_program, wifi_of
from upwash.emulation.request import (
    POSITION_LAG_LIMIT_S,
    RADIO_LAG_LIMIT_S,
    EmulationOutcome,
    EmulationRequest,
    left_out,
    read_outcome,
)
from upwash.errors import MissionStopped, UpwashError, UsageError
from upwash.support.loading import module_command
from upwash.support.sentences import say


def run_emulation(request: EmulationRequest) -> bool:
    """Emulates and prints how it goes; returns whether every flight was completed and what was measured is valid."""
    console = Console(markup=False)
    if read_outcome(request.folder) is not None:
        raise UsageError(f"{request.folder} holds another run: name a new --folder")
    drones = request.read()  # errors show before the set-up
    if request.radio == "ns3":
        native_program("ghosts")
        for server in drones[0].config.servers:
            wifi_of(server)
    if request.computers == "containers":
        from upwash.emulation.containers import require_containers

        require_containers()
    for file in request.scenarios:
        if missing := left_out(read_drone_config(file)):
            console.print(f"{file.name}: not emulated: {', '.join(missing)}", soft_wrap=True)
    request.folder.mkdir(parents=True, exist_ok=True)
    code = _run(request)
    outcome = read_outcome(request.folder)
    if outcome is None:
        raise UpwashError(
            f"the emulation was not completed (exit code {code}); the logs in {request.folder} say why"
        )
    if outcome.interrupted:
        raise MissionStopped("Ctrl-C")
    _print(outcome, console)
    console.print(f"everything of the run: {request.folder}", soft_wrap=True)
    return outcome.completed and outcome.valid


def _run(request: EmulationRequest) -> int:
    _, *program = module_command("upwash.emulation")
    if not request.autopilots:
        return run_enclosed(*program, request.encoded())
    with Path("/proc/self/ns/net").open("rb") as own:  # only then is there any way out
        request = msgspec.structs.replace(request, outside=own.fileno())
        return run_enclosed(*program, request.encoded(), handles=(own.fileno(),))


def _print(outcome: EmulationOutcome, console: Console) -> None:
    radio = f"at most {1000 * outcome.radio_lag_s:.1f} ms late (limit {1000 * RADIO_LAG_LIMIT_S:.0f})"
    positions = (
        f"at most {1000 * outcome.position_lag_s:.0f} ms late (limit {1000 * POSITION_LAG_LIMIT_S:.0f})"
    )
    say(f"radio {outcome.radio}: {radio}; positions {positions}", console)
    if not outcome.valid:
        console.print("NOT VALID: this machine was too busy to keep up", style="bold red", soft_wrap=True)

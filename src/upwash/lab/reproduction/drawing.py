"""The thesis's figures 4.4 to 4.12, from missions flown here."""

from __future__ import annotations

from pathlib import Path

from upwash.lab.reproduction.cells import (
    EXPERIMENTS,
    SETUPS,
    Cell,
    Experiment,
    fly,
    local_only,
    parameters,
)
from upwash.lab.reproduction.figures import draw_call_delays, draw_map
from upwash.lab.reproduction.printed import printed_figures
from upwash.lab.run import Run

_SEEDS = range(1, 31)


def draw_figures(folder: Path) -> list[Path]:
    """Draws them into the folder; returns the files.

    Where the thesis says how many waits of a figure were in vain, the mission is that of the first seed with as many.
    """
    first = folder / "figure_4.4.png"
    draw_map(parameters("hitl"), first, "Figure 4.4: waypoints, server coverage and flight direction")
    drawn = [first]
    shown = [(setup, experiment) for setup in SETUPS for experiment in EXPERIMENTS]
    for number, (setup, experiment) in enumerate(shown, start=5):
        file = folder / f"figure_4.{number}.png"
        seed, run = _shown(setup, experiment)
        speed = "s2 is slower than s1" if experiment.slow_s2 else "s2 is equally fast to s1"
        place = "HITL/SITL" if setup == "hitl" else "simulation"
        mode = f"call delay in the {experiment.mode} processing mode"
        draw_call_delays(
            run.events,
            reference=fly(local_only(setup, experiment), seed).events,
            file=file,
            title=f"Figure 4.{number}: {mode}, {speed} ({place}; seed {seed})",
        )
        drawn.append(file)
    return drawn


def _shown(setup: str, experiment: Experiment) -> tuple[int, Run]:
    cell = Cell(setup, experiment, "location-aware")
    first = fly(cell, _SEEDS[0])
    printed = printed_figures()
    in_vain, waits = (
        printed.get((experiment.name, setup, name)) for name in ("waits_in_vain", "waits_decided")
    )
    if in_vain is None:
        return _SEEDS[0], first
    for seed in _SEEDS:
        run = first if seed == _SEEDS[0] else fly(cell, seed)
        totals = run.result.totals
        if totals.waits_failed == in_vain and waits in (None, totals.waits):
            return seed, run
    return _SEEDS[0], first

"""Flies the thesis's eight cells in real time, one after another, and prints them beside `simulate` and the thesis.

    sudo .venv/bin/python -m bench.validate --radio table                # all twelve: seven hours
    sudo .venv/bin/python -m bench.validate --radio ns3 --in containers --only equal-servers-light/simulation
    .venv/bin/python -m bench.validate --report                          # only what is there

The figures of each valid cell are kept in bench/results/validation, with its command. A kept cell is not flown again:
after an interruption the same command goes on with the next cell. `python -m bench.promises` brings them into
docs/reproduction.md.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import msgspec
from bench.program import command_line
from bench.results import FOLDER, Result, leave
from rich.console import Console
from rich.table import Table

from upwash import read_log, read_result
from upwash.config.drone import DroneConfig, GridConfig, ServerConfig
from upwash.emulation.programs import write_config
from upwash.emulation.request import (
    ComputerKind,
    EmulationOutcome,
    EmulationRequest,
    RadioKind,
    emulated,
    read_outcome,
)
from upwash.emulation.run import run_emulation
from upwash.eventlog.results import RunResult
from upwash.lab.reproduction.cells import SETUPS, ThesisCell, scenario, timed_cells
from upwash.lab.reproduction.quantities import printed_figures
from upwash.lab.run import simulate
from upwash.services.solar_park import Park, View, photograph

A_WAIT_S = 0.05  # less is the clock's
PHOTOS, QUICK_PHOTOS = 10, 1
WIFI = {"hitl": "disc54", "simulation": "disc12"}
KEPT = FOLDER / "validation"


class Field(NamedTuple):
    """What the cells are flown in."""

    radio: RadioKind
    computers: ComputerKind


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one emulated cell, beside its simulation and the thesis's figures."""

    cell: str
    radio: RadioKind
    computers: ComputerKind
    emulated_min: float
    simulated_min: float
    thesis_min: float
    calls: int
    alike: int  # at the same place as in the simulation
    remote_s: float | None  # the median of remote calls that did not wait; None without any
    simulated_remote_s: float | None
    radio_lag_s: float
    position_lag_s: float
    valid: bool  # not so late that its times mean nothing


def cells() -> Iterator[ThesisCell]:
    """Table 4.1's cells: with offloading, and without where s2's load makes no difference."""
    for setup in SETUPS:
        yield from timed_cells(setup)


def name_of(cell: ThesisCell) -> str:
    """A cell's name, such as equal-servers-light/hitl, or local-only-light/hitl."""
    experiment = cell.experiment
    return (
        f"{f'local-only-{experiment.mode}' if cell.policy == 'local-only' else experiment.name}/{cell.setup}"
    )


def kept_as(cell: ThesisCell, field: Field) -> Path:
    """Where the cell's figures are kept."""
    return KEPT / f"{name_of(cell).replace('/', '-')}-{field.radio}-{field.computers}.json"


def config_of(
    cell: ThesisCell, radio: RadioKind, photos: Path | None = None, *, quick: bool = False
) -> DroneConfig:
    """The cell's scenario as it is emulated, with photos from the folder; by ns-3, over the WiFi of its set-up."""
    config = emulated(scenario(cell, seed=1))
    if quick:
        config = shortened(config)
    config = msgspec.structs.replace(config, camera=msgspec.structs.replace(config.camera, folder=photos))
    if radio == "table":
        return config
    servers = tuple(over_wifi(server, WIFI[cell.setup]) for server in config.servers)
    return msgspec.structs.replace(config, servers=servers)


def shortened(config: DroneConfig) -> DroneConfig:
    """The scenario with two waypoints, low above the ground."""
    grid = GridConfig(columns=2, rows=1, spacing_m=2.0)
    mission = msgspec.structs.replace(config.mission, grid=grid, altitude_m=2.0)
    return msgspec.structs.replace(config, mission=mission)


def over_wifi(server: ServerConfig, radio: str) -> ServerConfig:
    """The server with a radio that takes its own time: what is left of the true delay is the computing."""
    slower_by_s = {
        service: {key: call_s - server.remote_call_s[service][key] for key, call_s in calls_s.items()}
        for service, calls_s in server.truth.remote_call_s.items()
    }
    processing_s = {
        service: {key: s + slower_by_s.get(service, {}).get(key, 0.0) for key, s in by_key.items()}
        for service, by_key in server.processing_s.items()
    }
    truth = msgspec.structs.replace(server.truth, radio=radio, remote_call_s={}, processing_s=processing_s)
    return msgspec.structs.replace(server, truth=truth)


def render_photos(folder: Path, count: int) -> None:
    """Renders what all cells photograph, unless it is there: rendered in flight, a photo would take its own time."""
    folder.mkdir(parents=True, exist_ok=True)
    park = Park(1)
    for number in range(count):
        file = folder / f"{number:02}.jpg"
        if not file.exists():
            file.write_bytes(photograph(park, View(20.0 * number, 0.0, 20.0), shot=number).jpeg)


def fly(cell: ThesisCell, field: Field, folder: Path, photos: Path, *, quick: bool) -> Figures | None:
    """Emulates the cell; None where it was not completed."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    file = folder / "scenario.toml"
    write_config(file, config_of(cell, field.radio, photos, quick=quick))
    request = EmulationRequest(scenarios=(file,), radio=field.radio, computers=field.computers, folder=folder)
    run_emulation(request)
    outcome = read_outcome(folder)
    if outcome is None or not outcome.completed:
        return None
    return figures_of(cell, field, read_result(read_log(folder / "drone.jsonl")), outcome, quick=quick)


def figures_of(
    cell: ThesisCell, field: Field, flown: RunResult, outcome: EmulationOutcome, *, quick: bool
) -> Figures:
    """The flight beside its simulation."""
    simulated = simulate(config_of(cell, field.radio, quick=quick)).result
    quantity = "local_only" if cell.policy == "local-only" else "offloading"
    return Figures(
        cell=name_of(cell),
        radio=field.radio,
        computers=field.computers,
        emulated_min=round(flown.mission_time_s / 60, 3),
        simulated_min=round(simulated.mission_time_s / 60, 3),
        thesis_min=printed_figures()[cell.experiment.name, cell.setup, f"mission_time_{quantity}"],
        calls=len(simulated.calls),
        alike=alike(flown, simulated),
        remote_s=remote_s(flown),
        simulated_remote_s=remote_s(simulated),
        radio_lag_s=outcome.radio_lag_s,
        position_lag_s=outcome.position_lag_s,
        valid=outcome.valid,
    )


def alike(flown: RunResult, simulated: RunResult) -> int:
    """How many calls ran at the same place."""
    places = {call.waypoint: call.place for call in simulated.calls}
    return sum(call.place == places[call.waypoint] for call in flown.calls)


def remote_s(result: RunResult) -> float | None:
    """The median delay of remote calls that did not wait."""
    delays_s = [call.delay_s for call in result.calls if call.place != "local" and call.waited_s < A_WAIT_S]
    return round(median(delays_s), 4) if delays_s else None


WIDTH = 160  # a row of long names that is not valid stands on one line
COLUMNS = (
    "cell",
    "radio",
    "in",
    "emulated",
    "simulated",
    "thesis",
    "places alike",
    "remote delay",
    "late at most",
)


def row_of(figures: Figures) -> tuple[str, ...]:
    """The figures as they are printed, in the order of `COLUMNS`; late are the radio and the positions."""
    delay = "-"
    if figures.remote_s is not None and figures.simulated_remote_s is not None:
        delay = f"{figures.remote_s:.3f} / {figures.simulated_remote_s:.3f} s"
    late = f"{1000 * figures.radio_lag_s:.0f} ms, {1000 * figures.position_lag_s:.0f} ms"
    return (
        figures.cell,
        figures.radio,
        figures.computers,
        f"{figures.emulated_min:.2f}",
        f"{figures.simulated_min:.2f}",
        f"{figures.thesis_min:g}",
        f"{figures.alike} of {figures.calls}",
        delay,
        late if figures.valid else f"{late}: NOT VALID",
    )


def kept() -> Iterator[tuple[Result, Figures]]:
    """The cells flown until now, in the order of the thesis."""
    for cell in cells():
        for file in sorted(KEPT.glob(f"{name_of(cell).replace('/', '-')}-*.json")):
            result = msgspec.json.decode(file.read_bytes(), type=Result)
            yield result, msgspec.convert(result.figures, Figures)


def report(rows: Sequence[Figures]) -> None:
    """Prints the figures as a table."""
    table = Table(title="minutes")
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "cell" else "right")
    for figures in rows:
        table.add_row(*row_of(figures))
    Console(width=max(Console().width, WIDTH)).print(table)


def main() -> None:
    """Flies what is missing, and reports."""
    names = [name_of(cell) for cell in cells()]
    parser = command_line("validate", (__doc__ or "").partition("\n")[0])
    parser.add_argument("--radio", choices=("table", "ns3"), default="table")
    parser.add_argument("--in", dest="computers", choices=("namespaces", "containers"), default="namespaces")
    parser.add_argument("--only", choices=names, action="append", metavar="CELL", help=", ".join(names))
    parser.add_argument("--runs", type=Path, default=Path("runs/validation"), help="where the runs' files go")
    parser.add_argument("--report", action="store_true", help="fly nothing")
    options = parser.parse_args()
    field = Field(options.radio, options.computers)
    if options.quick:
        with tempfile.TemporaryDirectory(prefix="upwash-validation-") as folder:
            flown = fly_all(field, Path(folder), options.only or names[:1], quick=True)
        report(flown)
        return
    if not options.report:
        only = [each for each in options.only or names if not kept_as(cell_of(each), field).exists()]
        fly_all(field, options.runs.absolute(), only, quick=False)
    report([figures for _, figures in kept()])


def cell_of(name: str) -> ThesisCell:
    """The cell of that name."""
    return next(cell for cell in cells() if name_of(cell) == name)


def fly_all(field: Field, runs: Path, names: Sequence[str], *, quick: bool) -> list[Figures]:
    """Flies these cells, and keeps the figures of what is valid and whole."""
    render_photos(runs / "photos", QUICK_PHOTOS if quick else PHOTOS)
    flown = []
    for name in names:
        folder = runs / field.radio / field.computers / name
        figures = fly(cell_of(name), field, folder, runs / "photos", quick=quick)
        if figures is not None:
            flown.append(figures)
            if figures.valid and not quick:
                command = (
                    f"python -m bench.validate --radio {field.radio} --in {field.computers} --only {name}"
                )
                leave(kept_as(cell_of(name), field), command=command, figures=figures)
    return flown


if __name__ == "__main__":
    main()

"""Flies the thesis's eight cells in real time, one after another, and prints them beside `simulate` and the thesis.

    sudo .venv/bin/python bench/validate.py --radio table                # all eight: three and a half hours
    sudo .venv/bin/python bench/validate.py --radio ns3 --only equal-servers-light/simulation
    .venv/bin/python bench/validate.py --report                          # only what is there

A cell that was flown and is valid is not flown again: the same command goes on where it was interrupted.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from statistics import median

import msgspec
from rich.console import Console
from rich.table import Table

from upwash.config import DroneConfig, ServerConfig
from upwash.emulation.files import write_drone_file
from upwash.emulation.order import Order, RadioKind, emulated
from upwash.emulation.outcome import read_outcome
from upwash.emulation.run import run_emulation
from upwash.flying import read_log
from upwash.lab.reproduction import EXPERIMENTS, SETUPS, Cell, scenario
from upwash.lab.run import simulate
from upwash.results import RunResult
from upwash.services.solar_park import Park, View, photograph

A_WAIT_S = 0.05  # less is the clock's
PHOTOS = 10
WIFI = {"hitl": "disc54", "simulation": "disc12"}


def cells() -> Iterator[Cell]:
    """Table 4.1's cells with offloading."""
    for setup in SETUPS:
        for experiment in EXPERIMENTS:
            yield Cell(setup, experiment, "location-aware")


def name_of(cell: Cell) -> str:
    """A cell's name, such as equal-servers-light/hitl."""
    return f"{cell.experiment.name}/{cell.setup}"


def config_of(cell: Cell, radio: RadioKind, photos: Path | None = None) -> DroneConfig:
    """The cell's scenario as it is emulated, with photos from the folder; by ns-3, over the WiFi of its set-up."""
    config = emulated(scenario(cell, seed=1))
    config = msgspec.structs.replace(config, camera=msgspec.structs.replace(config.camera, folder=photos))
    if radio == "table":
        return config
    servers = tuple(over_wifi(server, WIFI[cell.setup]) for server in config.servers)
    return msgspec.structs.replace(config, servers=servers)


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


def render_photos(folder: Path) -> None:
    """Renders what all cells photograph, unless it is there: rendered in flight, a photo would take its own time."""
    folder.mkdir(parents=True, exist_ok=True)
    park = Park(1)
    for number in range(PHOTOS):
        file = folder / f"{number:02}.jpg"
        if not file.exists():
            file.write_bytes(photograph(park, View(20.0 * number, 0.0, 20.0), shot=number).jpeg)


def fly(cell: Cell, radio: RadioKind, folder: Path, photos: Path) -> None:
    """Emulates the cell unless that was done; what was not valid is done again."""
    outcome = read_outcome(folder)
    if outcome is not None and outcome.valid and outcome.completed:
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    file = folder / "scenario.toml"
    write_drone_file(file, config_of(cell, radio, photos))
    run_emulation(Order(scenarios=(file,), radio=radio, folder=folder))


def printed_min() -> dict[str, float]:
    """The thesis's minutes by cell."""
    text = (files("upwash.lab") / "thesis" / "printed.csv").read_text(encoding="utf-8")
    return {
        f"{row['experiment']}/{row['setup']}": float(row["value"])
        for row in csv.DictReader(text.splitlines())
        if row["quantity"] == "mission_time_offloading"
    }


def report(runs: Path, radio: RadioKind) -> None:
    """Prints what was emulated so far."""
    table = Table(title=f"radio {radio}: minutes")
    for column in ("cell", "emulated", "simulated", "thesis", "places alike", "remote delay", "lag"):
        table.add_column(column, justify="left" if column == "cell" else "right")
    for cell in cells():
        name = name_of(cell)
        folder = runs / radio / name
        outcome = read_outcome(folder)
        if outcome is None:
            continue
        flown, simulated = read_log(folder / "drone.jsonl"), simulate(config_of(cell, radio)).result
        table.add_row(
            name,
            f"{flown.mission_time_s / 60:.2f}",
            f"{simulated.mission_time_s / 60:.2f}",
            f"{printed_min()[name]:g}",
            f"{alike(flown, simulated)} of {len(simulated.calls)}",
            f"{remote_s(flown):.3f} / {remote_s(simulated):.3f} s",
            f"{1000 * outcome.radio_lag_s:.1f} ms{'' if outcome.valid else ', NOT VALID'}",
        )
    Console().print(table)


def alike(flown: RunResult, simulated: RunResult) -> int:
    """How many calls ran at the same place."""
    places = {call.waypoint: call.place for call in simulated.calls}
    return sum(call.place == places[call.waypoint] for call in flown.calls)


def remote_s(result: RunResult) -> float:
    """The median delay of remote calls that did not wait."""
    return median(call.delay_s for call in result.calls if call.place != "local" and call.waited_s < A_WAIT_S)


def main() -> None:
    """Flies what is missing, and reports."""
    names = [name_of(cell) for cell in cells()]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--radio", choices=("table", "ns3"), default="table")
    parser.add_argument("--only", choices=names, action="append", metavar="CELL", help=", ".join(names))
    parser.add_argument("--runs", type=Path, default=Path("runs/validation"), help="where the runs are kept")
    parser.add_argument("--report", action="store_true", help="fly nothing")
    options = parser.parse_args()
    runs = options.runs.absolute()
    if not options.report:
        render_photos(runs / "photos")
    for cell in cells():
        if not options.report and name_of(cell) in (options.only or names):
            fly(cell, options.radio, runs / options.radio / name_of(cell), runs / "photos")
    report(options.runs, options.radio)


if __name__ == "__main__":
    main()

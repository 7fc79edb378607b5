"""Tables of goodput by distance, computed by ns-3: transfers of one request at each distance, one for each seed."""

from __future__ import annotations

import csv
import io
import os
import subprocess
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, pstdev

from upwash.emulation.native import WifiSettings, native_program
from upwash.errors import UpwashError
from upwash.support.output_files import write_file

_COLUMNS = (
    *("distance_m", "runs", "ok", "goodput_mbit_s", "goodput_std", "goodput_min", "goodput_max"),
    *("transfer_s", "transfer_min_s", "transfer_max_s", "round_trip_s"),
)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The transfers of a table: radio, distances, size and seeds, on which the table depends."""

    settings: WifiSettings
    distances_m: Sequence[float]
    request_bytes: int
    seeds: int


@dataclass(frozen=True, slots=True)
class Transfers:
    """The transfers over one distance, a value per seed; infinite if nothing got through."""

    distance_m: float
    request_bytes: int
    transfer_s: Sequence[float]
    round_trip_s: Sequence[float]

    @property
    def goodput_mbit_s(self) -> Sequence[float]:
        """The goodput in Mbit/s, a value per seed; 0 if nothing got through."""
        return [8e-6 * self.request_bytes / seconds for seconds in self.transfer_s]


def measure(measurement: Measurement, *, measured: Callable[[], object]) -> list[Transfers]:
    """Simulates all transfers on all cores, calling `measured` after each distance."""
    program = native_program("goodput")

    def at(distance_m: float) -> Transfers:
        transfers = _run(program, measurement, distance_m)
        measured()
        return transfers

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(at, measurement.distances_m))


def _run(program: Path, measurement: Measurement, distance_m: float) -> Transfers:
    done = subprocess.run(  # noqa: S603 - our own program
        [
            str(program),
            *measurement.settings.words(),
            *(f"{distance_m:g}", str(measurement.request_bytes), "1", str(measurement.seeds)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise UpwashError(f"{program.name} ended with {done.returncode}: {done.stderr.strip()}")
    pairs = [tuple(map(float, line.split())) for line in done.stdout.splitlines()]
    return Transfers(
        distance_m,
        measurement.request_bytes,
        transfer_s=[transfer_s for transfer_s, _ in pairs],
        round_trip_s=[round_trip_s for _, round_trip_s in pairs],
    )


def write_table(file: Path, measurement: Measurement, table: Sequence[Transfers]) -> None:
    """Writes a csv file that a scenario can name as its radio; comments contain the measurement's settings."""
    lines = io.StringIO()
    lines.writelines(f"# {line}\n" for line in _header(measurement))
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(map(_row, table))
    write_file(file, lines.getvalue().encode())


def _header(measurement: Measurement) -> Iterator[str]:
    settings = measurement.settings
    yield f"ns-3: {settings.standard}, ad hoc, data {settings.data_mode}, control {settings.control_mode}"
    yield f"log-distance path loss: {settings.loss_at_1m_db:.3f} dB at 1 m, exponent {settings.loss_exponent:g}"
    yield f"one TCP transfer of {measurement.request_bytes} bytes; seeds 1 to {measurement.seeds}"


def _row(transfers: Transfers) -> list[str]:
    goodput = transfers.goodput_mbit_s
    through = [seconds for seconds in transfers.transfer_s if seconds < float("inf")]
    back = [seconds for seconds in transfers.round_trip_s if seconds < float("inf")]
    return [
        f"{transfers.distance_m:g}",
        str(len(goodput)),
        str(len(through)),
        *(f"{value:.3f}" for value in (fmean(goodput), pstdev(goodput), min(goodput), max(goodput))),
        *(f"{value:.4f}" for value in ((fmean(through), min(through), max(through)) if through else ())),
        *([""] * 3 if not through else []),
        f"{fmean(back):.4f}" if back else "",
    ]

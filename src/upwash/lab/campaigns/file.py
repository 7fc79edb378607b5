"""The file that a campaign writes: a CSV row per run, kept as the runs come in.

A note beside it names its campaign, as a file with rows of two campaigns would be worthless.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import msgspec

from upwash.config.reading import Document
from upwash.errors import NotWritten, UsageError
from upwash.lab.campaigns.sweep import ParameterSweep
from upwash.lab.scenario import told
from upwash.report.exports import as_csv
from upwash.support.loading import extra
from upwash.support.output_files import append_whole, flush_to_disk, write_file
from upwash.support.software import software
from upwash.support.text import counted


class CampaignRow(msgspec.Struct, frozen=True):
    """One run; its results are empty if the run broke off."""

    values: tuple[str, ...]  # of the settings
    seed: int
    policy: str
    mission_time_s: float | None = None
    completed: bool = False
    failure: str = ""
    calls: int | None = None
    local: int | None = None
    remote: int | None = None
    waits: int | None = None
    waits_failed: int | None = None
    switches: int | None = None
    fallbacks: int | None = None
    service_delay_s: float | None = None
    went_on: int | None = None  # where a drone may go on before answers are there
    turns_back: int | None = None
    hidden_s: float | None = None
    bound_s: float | None = None
    bound_with_joins_s: float | None = None
    energy_wh: float | None = None
    flight_wh: float | None = None
    hover_wh: float | None = None
    computing_wh: float | None = None
    radio_wh: float | None = None
    completed_drones: int | None = None  # of several
    worst_s: float | None = None
    jain: float | None = None
    bound_shared_s: float | None = None
    lighter: int | None = None  # calls, with mission.lighter
    first_answers: int | None = None  # with two answers
    first_alone: int | None = None
    in_time: int | None = None  # with deadlines
    late: int | None = None
    second_servers: int | None = None


ENERGY = ("energy_wh", "flight_wh", "hover_wh", "computing_wh", "radio_wh")


def _may_go(document: Document) -> bool:
    policy = document.get("policy")
    return isinstance(policy, dict) and policy.get("stay_or_go", "stay") != "stay"


def _of_services(key: str) -> Callable[[Document], bool]:
    return lambda document: any(key in service for service in document.get("service", ()))


_OF_SOME: Mapping[tuple[str, ...], Callable[[Document], bool]] = {  # columns, and which scenarios fill them
    ENERGY: lambda document: "energy" in document,
    ("completed_drones", "worst_s", "jain", "bound_shared_s"): lambda document: "drone" in document,
    ("lighter",): lambda document: "lighter" in document["mission"],
    ("went_on", "turns_back", "hidden_s"): _may_go,
    ("first_answers", "first_alone"): _of_services("two_answers"),
    ("in_time", "late", "second_servers"): _of_services("deadline"),
}
_SOME = frozenset(itertools.chain(*_OF_SOME))
_COLUMNS = tuple(name for name in CampaignRow.__struct_fields__[1:] if name not in _SOME)


class Note(msgspec.Struct, frozen=True):
    """Which campaign a file belongs to, what its scenario said, and which upwash flew it last."""

    scenario: str
    settings: dict[str, tuple[object, ...]]
    fingerprint: str
    upwash: str = ""
    commit: str = ""
    configuration: Document = {}


class CampaignFile:
    """The rows of a campaign, in memory and in its file."""

    def __init__(self, out: Path, sweep: ParameterSweep) -> None:
        self.rows: list[CampaignRow] = []
        self.sweep = sweep
        self._csv_file = out.with_suffix(".csv")
        self._parquet_file = out if out.suffix == ".parquet" else None
        documents = [combination.document for combination in sweep.combinations]
        of_some = [names for names, fills in _OF_SOME.items() if any(map(fills, documents))]
        self._columns = (*_COLUMNS, *itertools.chain(*of_some))

    @classmethod
    def open(cls, out: Path, sweep: ParameterSweep) -> CampaignFile:
        """Begins the file or continues it; `out` ends in .csv or .parquet, which is written from a .csv beside it.

        Raises UsageError for a file of another campaign, or of none.
        """
        if out.suffix not in (".csv", ".parquet"):
            raise UsageError(f"{out} is no .csv or .parquet file: give a name with one of these endings")
        if out.suffix == ".parquet":
            with extra("parquet"):
                import pyarrow  # noqa: F401
        file = cls(out, sweep)
        csv_file = file._csv_file
        try:
            file._claim()
            if csv_file.exists():
                _drop_torn_row(csv_file)
                file.rows = _read(csv_file, file._columns, settings=len(sweep.settings))
            if not csv_file.exists() or csv_file.stat().st_size == 0:
                _write(csv_file, [file._header()])
        except OSError as error:
            raise UsageError(f"{csv_file} cannot be written: {error.strerror}") from error
        if any(row.seed > sweep.seeds for row in file.rows):
            most = max(row.seed for row in file.rows)
            raise UsageError(
                f"{csv_file} has the seeds up to {most} already: ask for as many, or name another file"
            )
        return file

    def append(self, rows: Iterable[CampaignRow]) -> None:
        """Keeps these rows: from now on no interruption loses them."""
        new = list(rows)
        try:
            _write(self._csv_file, [self._cells(row) for row in new])
        except OSError as error:
            kept = (
                f"it has the {counted(len(self.rows), 'run')} before, and the same command goes on from there"
            )
            raise NotWritten(self._csv_file, error, kept) from error
        self.rows += new

    def finish(self) -> None:
        """Sorts the rows by combination and seed, and writes the Parquet file where one is wanted."""
        order = {combination.values: number for number, combination in enumerate(self.sweep.combinations)}
        self.rows.sort(key=lambda row: (order[row.values], row.seed))
        rows = [self._header(), *map(self._cells, self.rows)]
        write_file(self._csv_file, as_csv(rows).encode())
        if self._parquet_file is not None:
            write_file(self._parquet_file, _as_parquet(self._csv_file))

    def _header(self) -> list[str]:
        return [*self.sweep.keys, *self._columns]

    def _cells(self, row: CampaignRow) -> list[str]:
        return [*row.values, *(_cell(getattr(row, column)) for column in self._columns)]

    def _claim(self) -> None:
        """Raise UsageError if the note beside the file names another campaign; else write the note."""
        sweep = self.sweep
        note_file = self._csv_file.with_suffix(".campaign.json")
        note = Note(
            sweep.file.name,
            {setting.key: setting.values for setting in sweep.settings},
            sweep.fingerprint,
            *software(),
            told(sweep.combinations[0].document),
        )
        if self._csv_file.exists():
            found = None
            with contextlib.suppress(OSError, msgspec.MsgspecError):
                found = msgspec.json.decode(note_file.read_bytes(), type=Note)
            if found is None or found.fingerprint != note.fingerprint:
                raise UsageError(
                    f"{self._csv_file} is of {_described(found)}: name another file with --out, or remove it"
                )
        write_file(note_file, msgspec.json.format(msgspec.json.encode(note)) + b"\n")


def _described(note: Note | None) -> str:
    if note is None:
        return "no campaign"
    settings = "".join(f", {key} = {list(values)}" for key, values in note.settings.items())
    return f"another campaign, or of another state of its scenario ({note.scenario}{settings})"


def _read(csv_file: Path, columns: Sequence[str], *, settings: int) -> list[CampaignRow]:
    try:
        with csv_file.open(newline="", encoding="utf-8") as lines:
            rows = list(csv.reader(lines))[1:]
        return [_row(cells, columns, settings) for cells in rows]
    except (msgspec.ValidationError, ValueError, csv.Error) as error:
        raise UsageError(
            f"{csv_file} was changed by hand, or damaged: {error}; remove it and begin again"
        ) from None


def _row(cells: Sequence[str], columns: Sequence[str], settings: int) -> CampaignRow:
    named = dict(zip(columns, cells[settings:], strict=True))
    texts = {name: cell for name, cell in named.items() if cell or name == "failure"}
    return msgspec.convert({"values": cells[:settings], **texts}, CampaignRow, strict=False)


def _cell(value: object) -> str:
    return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _write(csv_file: Path, rows: Iterable[Sequence[str]]) -> None:
    with csv_file.open("ab", buffering=0) as file:
        append_whole(file.fileno(), as_csv(rows).encode())  # at once, so that a kill tears a row at most
        flush_to_disk(file.fileno())


def _drop_torn_row(csv_file: Path) -> None:
    """Cut off a last row without its line end, which a killed campaign leaves."""
    with csv_file.open("rb+") as file:
        file.truncate(file.read().rfind(b"\n") + 1)


def _as_parquet(csv_file: Path) -> bytes:
    from pyarrow import BufferOutputStream, parquet, string
    from pyarrow import csv as arrow_csv

    texts = arrow_csv.ConvertOptions(column_types={"policy": string(), "failure": string()})
    written = BufferOutputStream()
    parquet.write_table(arrow_csv.read_csv(csv_file, convert_options=texts), written)
    content: bytes = written.getvalue().to_pybytes()
    return content

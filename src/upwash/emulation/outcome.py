"""What an emulation came to, as it is left in the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from upwash.emulation.request import RadioKind
from upwash.launch.flight_program import INTERRUPTED
from upwash.support.output_files import write_file

RADIO_LAG_LIMIT_S = 0.02  # more, and the radio's times mean nothing
POSITION_LAG_LIMIT_S = 0.5  # more, and a drone is metres away from where its radio believes it to be
_FILE = "emulation.json"


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How far an emulation was ever behind the clock, and each flight's exit code; the rest is in the event logs."""

    radio: RadioKind
    radio_lag_s: float
    position_lag_s: float
    exit_codes: Mapping[str, int]

    @property
    def valid(self) -> bool:
        """Whether nothing was so late that what was measured means nothing."""
        return self.radio_lag_s <= RADIO_LAG_LIMIT_S and self.position_lag_s <= POSITION_LAG_LIMIT_S

    @property
    def completed(self) -> bool:
        """Whether every flight ended as it should."""
        return not any(self.exit_codes.values())

    @property
    def interrupted(self) -> bool:
        """Whether a flight was ended by a Ctrl-C."""
        return INTERRUPTED in self.exit_codes.values()

    def write(self, folder: Path) -> None:
        """Leaves it in the folder."""
        record = msgspec.structs.asdict(self) | {"valid": self.valid}
        write_file(folder / _FILE, msgspec.json.format(msgspec.json.encode(record)) + b"\n")


def read_outcome(folder: Path) -> Outcome | None:
    """What the emulation of the folder came to; None where it did not come to its end."""
    file = folder / _FILE
    return msgspec.json.decode(file.read_bytes(), type=Outcome) if file.exists() else None

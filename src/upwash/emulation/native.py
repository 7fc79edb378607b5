"""The ns-3 programs of native/, and the WiFi that they simulate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from upwash.config.drone import ServerConfig
from upwash.config.places import true_range_m
from upwash.errors import UsageError

_BUILT = Path(__file__).parents[3] / "native" / "build"
_RANGE_M = 100.0  # of the settings below


@dataclass(frozen=True, slots=True)
class WifiSettings:
    """An ad-hoc network at one constant rate, with log-distance path loss."""

    standard: str
    data_mode: str
    control_mode: str
    loss_at_1m_db: float
    loss_exponent: float

    def words(self) -> tuple[str, ...]:
        """The settings as command-line arguments of the ns-3 programs."""
        return (
            self.standard,
            self.data_mode,
            self.control_mode,
            f"{self.loss_at_1m_db:.3f}",
            f"{self.loss_exponent:g}",
        )

    def ending_at(self, range_m: float) -> WifiSettings:
        """The same network with its range ending at another distance, by another loss at 1 m."""
        loss_db = self.loss_at_1m_db + 10 * self.loss_exponent * math.log10(_RANGE_M / range_m)
        return WifiSettings(self.standard, self.data_mode, self.control_mode, loss_db, self.loss_exponent)


# "About 12 Mbit/s" ends sharply at 101 m; "54 Mbit/s nominal" softly between 95 and 110 m.
WIFI = {
    "disc12": WifiSettings("802.11a", "OfdmRate18Mbps", "OfdmRate6Mbps", 46.677, 2.56),
    "disc54": WifiSettings("802.11g", "ErpOfdmRate54Mbps", "ErpOfdmRate6Mbps", 40.046, 2.58),
}


def wifi_of(server: ServerConfig) -> WifiSettings:
    """The WiFi settings of the server's radio, ending at its range; raises UsageError for any other radio."""
    settings = WIFI.get(server.truth.radio)
    if settings is None:
        raise UsageError(
            f'server {server.name}: ns-3 cannot simulate the radio "{server.truth.radio}": '
            f"write radio = one of {', '.join(WIFI)} in [server.truth], or use --radio table"
        )
    range_m = true_range_m(server)
    return settings if range_m is None else settings.ending_at(range_m)


def native_program(name: str) -> Path:
    """The path of a built ns-3 program; raises UsageError if it is not built."""
    program = _BUILT / name
    if not program.exists():
        raise UsageError(
            f"{program} is not built: install Debian's g++ and libns3-dev, then run `make native` in upwash's sources"
        )
    return program

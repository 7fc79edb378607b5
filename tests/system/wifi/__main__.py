"""`python -m tests.system.wifi FOLDER [CASE ...]`: builds the machine in the folder if needed, flies, prints.

Building takes about 4 minutes, booting one, each flight about one.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table
from tests.system.wifi.flights import Found
from tests.system.wifi.machine import build, flights, is_built, why_not

TIMEOUT_S = 3600.0


def main() -> int:
    """Ends with 1 if a flight was not as expected."""
    if not sys.argv[1:]:
        print(__doc__, file=sys.stderr)
        return 2
    if trouble := why_not():
        print(trouble, file=sys.stderr)
        return 2
    folder, cases = Path(sys.argv[1]), sys.argv[2:]
    if not is_built(folder):
        print("building the machine", file=sys.stderr)
        build(folder)
    found = Path(tempfile.mkdtemp(prefix="flights-", dir=folder))
    flown = flights(folder, cases, found, timeout_s=TIMEOUT_S)
    Console().print(table(flown))
    print(f"logs: {found}")
    return int(not flown or any(flight.wrong for flight in flown))


def table(flown: list[Found]) -> Table:
    """A row for each flight."""
    rows = Table(
        "flight", "waypoints", "join (s)", "hand-over (s)", "calls on servers", "told", "wrong", box=None
    )
    for flight in flown:
        rows.add_row(
            flight.case,
            str(flight.reached),
            ", ".join(f"{join_s:.1f}" for join_s in flight.joins_s),
            "" if flight.hand_over_s is None else f"{flight.hand_over_s:.1f}",
            f"{flight.remote} of {flight.calls}",
            "; ".join(flight.told),
            flight.wrong,
        )
    return rows


if __name__ == "__main__":
    sys.exit(main())

"""Writes the names of PX4's events by number, from the event metadata that a build of PX4 leaves behind.

    python -m bench.px4_events build/px4_sitl_default/events/all_events.json > src/upwash/real/mavlink/px4_events.csv

The driver's words for an event that `upwash/mavlink/px4_events.csv` does not tell better. Calibration's are left out.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

_COMPONENT = 1  # the autopilot's number in an event's id, above its low 24 bits


def main(metadata: Path) -> None:
    """Prints a table of numbers and names."""
    components = json.loads(metadata.read_text())["components"]
    names = {
        int(number) | (_COMPONENT << 24): event["name"]
        for component, facts in components.items()
        if int(component) == _COMPONENT
        for group, events in facts["event_groups"].items()
        if group != "calibration"
        for number, event in events["events"].items()
    }
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["number", "name"])
    table.writerows(sorted(names.items()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Writes docs/safety-case.md from promises, tests and kept results: `python site/safety_case.py`."""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "safety-case.md"
_RESULTS = ROOT / "bench" / "results"
_PLANTED = ROOT / "tests" / "sim" / "planted.json"
_PROMISE = re.compile(r"^\| (\d+) \| \*\*(.+?)\.\*\* .+ \| ([A-Z ]+) \|$", re.MULTILINE)
_LIMIT = re.compile(r"^\| \| \*(.+?)\*: .+ \| \|$", re.MULTILINE)
_SCORE = re.compile(r"^\| (\S+) \| \d+ \| (\d+) \| (\d+) \| (\d+) \| (\d*) ?\|$", re.MULTILINE)
_KINDS = {
    "C": "properties of the deciding core",
    "W": "simulated worlds",
    "R": "real processes",
    "K": "kill -9",
    "H": "hostile input",
}
_HEAD = """\
# Safety case

<!-- written by site/safety_case.py from site/safety_case.toml, the promises and kept results -->

**Claim.** A flight with upwash ends badly only if upwash breaks a [promise](promises.md) or one of the
[conditions](#when-a-flight-ends-badly) C1, C2, ... holds. We know of no other cause.

*Badly* means a collision, an unchosen landing, a command against the pilot, or an action of the mission that
is done twice, elsewhere or never. The list was made from the promises, the limits and the questions of one reader. It
has no likelihoods and no severities.

**Scope.** Multicopters of ArduCopter and PX4, companion computers with Linux. The programs flew in simulated worlds,
against [stand-ins](vehicle.md), and with real autopilots in their own simulations. **Nothing has flown in the air.**
What else was not tried: [limits](promises.md). Motors, sensors and estimators of the autopilot, a lost or jammed GPS,
and the places of take-off and landing are the autopilot's and the pilot's, not upwash's.

| word | meaning |
|---|---|
| world | a mission that is drawn from a seed and simulated, with the real programs and with faults at drawn moments |
| planted defect | an error that is put into upwash by hand, to see whether the checks of the promises find it |
| mutant | a small change of the source by a program, to see whether a test fails |
| stand-in | a program that answers as an autopilot does, held to recordings of real ones |

These show that checks and tests find such errors, not that no error is left. Each figure names its commit and day.
"""
_REAL = """\
## Real autopilots

In their own simulations, with their own logs of what they received:
[ArduCopter 4.7.0-dev, PX4 1.16.1, the dead man](vehicle.md) and [rows](rows.md). People make these flights by hand;
tests do not repeat them. What they showed is in the stand-ins. Tests hold the stand-ins to recordings of both
autopilots.
"""
_CONCERNS_THE_END = (
    "autopilot",
    "the autopilot's link",
    "plans",
    "safe ends",
    "targets of others",
    "positions in doubt",
    "the reserve",
    "the clock",
    "late answers",
)


def page() -> str:
    """The page as it should be."""
    source = tomllib.loads((ROOT / "site" / "safety_case.toml").read_text())
    return "\n".join(
        (
            _HEAD,
            *_hazards(source["hazard"]),
            *_promises(source["tests"], source["checked"]),
            _REAL,
            *_campaigns(),
            *_gaps(),
        )
    )


def _hazards(hazards: list[dict[str, Any]]) -> Iterator[str]:
    yield "## When a flight ends badly\n"
    number = 0
    for hazard in hazards:
        against = ", ".join(f"[{promise}](#promise-{promise})" for promise in hazard["unless"])
        yield f"### {hazard['what']}\n"
        yield f"{hazard['because']}\n"
        yield f"It happens only if upwash breaks a promise ({against}), or one of these conditions holds:\n"
        for condition in hazard["ends_badly_if"]:
            number += 1
            yield f"- **C{number}.** {condition[0].upper()}{condition[1:]}."
        yield ""


def _promises(tests: Mapping[str, list[str]], checked: Mapping[str, str]) -> Iterator[str]:
    text = (ROOT / "docs" / "promises.md").read_text()
    notes = {number: note for numbers, note in checked.items() for number in numbers.split(", ")}
    planted = _planted()
    yield "## Promises and their evidence\n"
    for number, name, kinds in sorted(_PROMISE.findall(text), key=lambda promise: int(promise[0])):
        yield f'### <span id="promise-{number}"></span>{number}. {name}\n'
        yield f"- checked in: {', '.join(_KINDS[kind] for kind in kinds.split())}"
        yield f"- tests beside the worlds: {', '.join(f'`{file}`' for file in tests[number])}"
        if found := planted.get(number):
            yield f"- planted defects that break it, and are found: {'; '.join(found)}"
        if note := notes.get(number):
            yield f"- how it is checked, and what is not: {note}"
        yield ""


def _planted() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for defect in _kept(_PLANTED)["figures"]:
        for promise in defect["promises"]:
            found.setdefault(str(promise), []).append(defect["what"])
    return found


def _campaigns() -> Iterator[str]:
    yield "## Campaigns\n\n| | figures | commit, day |\n|---|---|---|"
    for what, file, say in (
        ("[simulated worlds](promises.md#in-simulated-worlds)", _RESULTS / "chaos.json", _chaos),
        ("planted defects", _PLANTED, _planted_found),
        ("[real processes](promises.md#on-real-processes-and-real-links)", _RESULTS / "faults.json", _faults),
        ("[attacks](hostile-input.md)", _RESULTS / "hostile.json", _attacks),
        ("[decoders](hostile-input.md)", _RESULTS / "fuzz.json", _fuzz),
        ("a daemon for ten minutes", _RESULTS / "soak.json", _soak),
    ):
        result = _kept(file)
        ran = f"{what}: `{result['command']}`"
        yield f"| {ran} | {say(result['figures'])} | {result['commit']}, {result['day']} |"
    yield f"| mutants: `python -m tests.mutation PACKAGE` | {_mutants()} | `tests/mutation/score.md` |\n"


def _kept(file: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(file.read_text())
    return result


def _chaos(figures: Any) -> str:
    flown = f"{figures['worlds']:,} worlds, {figures['flights']:,} flights, {figures['calls']:,} calls"
    return f"{flown}: {len(figures['broken'])} broken promises"


def _planted_found(figures: Any) -> str:
    return f"{sum(bool(defect['promises']) for defect in figures)} of {len(figures)} found"


def _faults(figures: Any) -> str:
    flown = f"{figures['flights']} flights of two drones, {figures['calls']:,} calls"
    return f"{flown}: {figures['broken']} broken promises"


def _attacks(figures: Any) -> str:
    return f"{len(figures)} attacks: honest calls took at most twice their time"


def _fuzz(figures: Any) -> str:
    runs, findings = (sum(one[key] for one in figures) for key in ("runs", "findings"))
    return f"{len(figures)} decoders, {runs:,} inputs: {findings} findings"


def _soak(figures: Any) -> str:
    return f"{figures['calls']:,} calls: {figures['failed']} failed"


def _mutants() -> str:
    planted: Counter[str] = Counter()
    found: Counter[str] = Counter()
    for package, of, killed, argued, since in _SCORE.findall(
        (ROOT / "tests" / "mutation" / "score.md").read_text()
    ):
        planted[package] += int(of) - int(argued)
        found[package] += int(killed) + int(since or 0)
    rows = ", ".join(f"{package} {found[package]} of {planted[package]}" for package in planted)
    return f"tests find {rows}; without those that change nothing visible"


def _gaps() -> Iterator[str]:
    limits = _LIMIT.findall((ROOT / "docs" / "promises.md").read_text())
    if missing := set(_CONCERNS_THE_END) - set(limits):
        raise ValueError(f"docs/promises.md has no limit that is called {', '.join(sorted(missing))}")
    named = ", ".join(_CONCERNS_THE_END)
    yield f"## Not covered\n\nOf [the limits](promises.md), those that concern a flight's end: {named}.\n"


if __name__ == "__main__":
    PAGE.write_text(page())

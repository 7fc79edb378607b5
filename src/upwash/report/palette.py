"""The colours of all pages and figures, on light and on dark ground.

Those of the servers and those of the drones were searched for: any two of a set, the grey of the drone's own calls
among the former, are at least 12 apart (CIEDE2000) for people of normal sight and for those who lack one kind of cone
(Machado, Oliveira and Fernandes 2009, severity 1). tests/report/test_palette.py says so, and what contrast they have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours as #rrggbb: `places` are of the drone and then of servers, `drones` of several drones.

    `band` is the ground of cards. `ready`, `check`, `listed` and `idle` are of a server's states, `alarm` is the
    ground of what a person has to act on, with the text `on_alarm`, and `caution` of what a person should know.
    """

    paper: str
    ink: str
    soft: str
    line: str
    band: str
    ready: str
    check: str
    listed: str
    idle: str
    alarm: str
    on_alarm: str
    caution: str
    places: Sequence[str]
    drones: Sequence[str]

    def of_server(self, index: int) -> str:
        """The colour of the server of that index, by the order of the names; after the last the first comes again."""
        return self.places[1 + index % (len(self.places) - 1)]

    def of_place(self, server: str | None, servers: Sequence[str]) -> str:
        """The colour of one of the servers, or of the drone."""
        return self.places[0] if server is None else self.of_server(servers.index(server))


LIGHT = Theme(
    paper="#ffffff", ink="#1d2327", soft="#5a6570", line="#d9dee3", band="#f4f6f8",
    ready="#86c79b", check="#f2c14e", listed="#c2410c", idle="#9aa4ae",
    alarm="#b00020", on_alarm="#ffffff", caution="#fdecc8",
    places=("#6b7280", "#973c0c", "#280cf9", "#205652", "#773a8a", "#c4696d", "#599a00", "#008bf1", "#420f55"),
    drones=("#267b3a", "#c3206e", "#5051fe", "#472e16", "#0238af", "#d70100", "#454e44", "#002438"),
)  # fmt: skip
DARK = Theme(
    paper="#14181c", ink="#e6e9ec", soft="#a3adb7", line="#343b43", band="#1c2227",
    ready="#2a7044", check="#85600c", listed="#e06d36", idle="#6b7680",
    alarm="#c62828", on_alarm="#ffffff", caution="#4a3a12",
    places=("#a7b0ba", "#f88922", "#936af8", "#2fa57e", "#d7a5ff", "#dd1e1e", "#f8f39e", "#cbfaec", "#9a6995"),
    drones=("#129b81", "#ff3c76", "#a36ff1", "#b0af07", "#76c6fc", "#ffbd99", "#c3ff05", "#f9e9e4"),
)  # fmt: skip
_GROUNDS = (
    "paper", "ink", "soft", "line", "band", "ready", "check", "listed", "idle", "alarm", "on_alarm", "caution",
)  # fmt: skip


def components(colour: str) -> tuple[float, float, float]:
    """Red, green and blue of #rrggbb, each from 0 to 1."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red / 255, green / 255, blue / 255


def stylesheet() -> str:
    """The colours as CSS: --paper, --place-0 (the drone) and so on, and a class place-0, drone-1, ... of each."""
    classes = [f".place-{index} {{ color: var(--place-{index}); }}" for index in range(len(LIGHT.places))]
    classes += [
        f".drone-{number} {{ --of: var(--drone-{number}); color: var(--drone-{number}); }}"
        for number in range(1, 1 + len(LIGHT.drones))
    ]
    counts = f"--servers: {len(LIGHT.places) - 1}; --drones: {len(LIGHT.drones)};"  # that have a colour of their own
    return "\n".join(
        [
            f":root {{ color-scheme: light dark; {counts} {_variables(LIGHT)} }}",
            f"@media (prefers-color-scheme: dark) {{ :root {{ {_variables(DARK)} }} }}",
            f"@media print {{ :root {{ color-scheme: light; {_variables(LIGHT)} }} }}",
            f":root.paper {{ color-scheme: light; {_variables(LIGHT)} }}",
            *classes,
            "",
        ]
    )


def _variables(theme: Theme) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in _named(theme))


def _named(theme: Theme) -> Iterator[tuple[str, str]]:
    for name in _GROUNDS:
        yield name.replace("_", "-"), getattr(theme, name)
    for index, colour in enumerate(theme.places):
        yield f"place-{index}", colour
    for number, colour in enumerate(theme.drones, start=1):
        yield f"drone-{number}", colour

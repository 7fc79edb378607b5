"""What commands print on a narrow terminal: no line is wider, no word is broken, and nothing is left out."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest
from rich.console import Console

from upwash.cli.demonstration_fleet import DemonstratedFlight, print_results
from upwash.cli.main import main
from upwash.cli.status import print_status
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.rpc.protocol import DaemonStatus, PartStatus, ReloadStatus, StatusReply

SCENARIOS = Path(__file__).parents[2] / "scenarios"
WIDE = 400
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
PLURAL = re.compile(r"(?<![\d.,])1 (?!is\b|was\b|has\b|as\b)[a-z]{2,}s\b(?<!ss)")
TIMED = ("━", " to fly, each ", "drawn: ")  # bars, and how long this machine takes

ONE_OF_EACH = """
[mission]
program = "survey"
mode = "heavy"
altitude_m = 20.0
ground_speed_m_s = 4.0
waypoints_m = [[10.0, 0.0]]

[noise]
call = 0.05

[[service]]
name = "detector"
local_call_s = { heavy = 10.0 }

[[server]]
name = "s1"
east_m = 0.0
north_m = 0.0
range_m = 50.0
check_s = 0.5
check_running_s = 0.5
remote_call_s = { heavy = 0.5 }
"""


def many(servers: int) -> str:
    """The scenario with as many servers, which have long names, and as many waypoints."""
    head, _, server = ONE_OF_EACH.partition("[[server]]")
    places = [[40.0 * number, 0.0] for number in range(1, 1 + servers)]
    head = re.sub(r"waypoints_m = .*", f"waypoints_m = {places}", head)
    names = [(f"roof-of-building-{number}", 40.0 * number) for number in range(1, 1 + servers)]
    return head + "".join(
        f"[[server]]{server}".replace('"s1"', f'"{name}"').replace("east_m = 0.0", f"east_m = {east_m}")
        for name, east_m in names
    )


def words(text: str) -> set[str]:
    return set(re.split(r"[\s;.─]+", text)) - {"", "saved"}  # which a row need not have


def assert_fits(narrow: str, wide: str, columns: int) -> None:
    lines = narrow.splitlines()
    assert max(map(len, lines)) <= columns, max(lines, key=len)
    assert not PLURAL.findall(narrow)
    assert words(narrow) == words(wide)


@pytest.fixture
def scenarios(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with scenarios, in which commands run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal
    Path("one.toml").write_text(ONE_OF_EACH)
    Path("ten.toml").write_text(many(10))
    Path("fleet.toml").write_text(many(10) + '[[drone]]\nname = "heron"\n[[drone]]\nname = "egret"\n')
    return tmp_path


@pytest.mark.parametrize(
    "commands",
    [
        ["simulate one.toml --log one.jsonl", "explain one.jsonl", "report one.jsonl -o one.html"],
        ["simulate ten.toml --calls --log ten.jsonl", "explain ten.jsonl --worst 3"],
        [f"simulate {SCENARIOS / 'two-services.toml'} --calls"],
        ["simulate fleet.toml"],
        ["check one.toml --seeds 1"],
        ["check ten.toml --seeds 1"],
        ["check fleet.toml --seeds 1"],
        ["compare one.toml ten.toml --seeds 1 --workers 1"],
        ["compare fleet.toml --seeds 1 --workers 1"],
        [
            "campaign one.toml --seeds 1 --workers 1 --out runs.csv --set policy.name=local-only,location-aware"
        ],
        [
            "campaign ten.toml --seeds 2 --workers 1 --out runs.csv --set policy.name=local-only,location-aware "
            "--set server.roof-of-building-1.truth.join_s=3.5,5 --set noise.call=0.05"
        ],
    ],
    ids=lambda commands: (
        " ".join(commands[0].split("/")[-1].split()[:3]) if isinstance(commands, list) else None
    ),
)
def test_a_command_prints_all_of_it_on_a_narrow_terminal(
    scenarios: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    commands: list[str],
) -> None:
    printed = {}
    paths = [r"\s?".join(map(re.escape, str(file))) for file in sorted(scenarios.glob("*.toml"))]
    path = re.compile(f"(?:{'|'.join(paths)})(?:\n(?=,))?")  # which is long, and may be broken
    for width in (WIDE, 80, 60):
        monkeypatch.setenv("COLUMNS", str(width))
        for command in commands:
            assert main(command.split()) in (0, 1)
        Path("runs.csv").unlink(missing_ok=True)
        lines = ESCAPES.sub("", capsys.readouterr().out).splitlines()
        assert max(map(len, lines)) <= width
        shown = "\n".join(line for line in lines if not any(mark in line for mark in TIMED))
        printed[width] = path.sub("PATH", shown)
    for width in (80, 60):
        assert_fits(printed[width], printed[WIDE], width)


def assert_all_fits(print_to: Callable[[Console], None]) -> None:
    printed = {}
    for width in (WIDE, 80, 60):
        output = io.StringIO()
        print_to(Console(file=output, width=width, force_terminal=True, markup=False, color_system=None))
        printed[width] = output.getvalue()
    for width in (80, 60):
        assert_fits(printed[width], printed[WIDE], width)


@pytest.mark.parametrize("drones", [1, 12])
def test_the_state_of_a_daemon_fits_a_narrow_terminal(drones: int) -> None:
    names = [f"field-team-drone-{number}" for number in range(1, 1 + drones)]
    host = AdmissionController({"s1": ServerOffer(frozenset({"scale"}), slots=1)})
    host.start("s1", "scale", Client(names[0]), now_s=0.0)
    host.at("s1").ready("scale", 1, "unix:/run/upwash/services/scale.sock", now_s=1.0)
    for name in names:
        host.availability("s1", ["scale"], Client(name), now_s=2.0)
    now = datetime(2026, 11, 29, tzinfo=UTC)
    why = "/etc/upwash/keys/revoked.txt has no entry any more: restore it, or restart the daemon"
    runs = DaemonStatus(
        version="1.0",
        commit="c0ffee" * 6,
        code="0a" * 32,
        sandbox="bubblewrap",
        time=now,
        clock_is_kept=None,
        revoked=1,
        parts={
            "revocations": PartStatus("0b" * 32, now, why),
            "service scale": PartStatus("0c" * 32, now),
        },
        reload=ReloadStatus(now, "process 1 of user upwash", now),
    )
    reply = StatusReply(9.0, host.servers(now_s=3.0), refusals=[], certificates=[], daemon=runs)
    assert_all_fits(lambda console: print_status(reply, console))


@pytest.mark.parametrize("servers", [1, 10])
def test_the_results_of_a_fleet_fit_a_narrow_terminal(tmp_path: Path, servers: int) -> None:
    Path(tmp_path / "one.toml").write_text(ONE_OF_EACH)
    assert main(["simulate", str(tmp_path / "one.toml"), "--log", str(tmp_path / "one.jsonl")]) == 0
    flights = {"drone-1": DemonstratedFlight.of(tmp_path / "one.jsonl", 0)}
    names = [f"server-{number}" for number in range(1, 1 + servers)]
    assert_all_fits(lambda console: print_results(flights, names, console))

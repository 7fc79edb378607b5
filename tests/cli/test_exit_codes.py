"""How commands end: each kind of end has a code of its own, and the pages say the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.cli.exit_codes import MEANINGS, ExitCode
from upwash.cli.main import main
from upwash.errors import (
    AutopilotOverruled,
    AutopilotTimeout,
    MissionFailed,
    MissionStopped,
    NotKept,
    ReserveReached,
    UsageError,
)

ROOT = Path(__file__).parents[2]
CONFIG = """
[mission]
program = "survey"
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
waypoints_m = [[0, 50]]
"""


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (AutopilotTimeout("goto", "it did not arrive"), 1),
        (MissionFailed("the mission program raised ValueError"), 1),
        (UsageError("no such mission"), 2),
        (NotKept("flown, and its log is not whole"), 3),
        (ReserveReached("20 % is left in the battery"), 4),
        (AutopilotOverruled("mission", "the pilot has the vehicle"), 5),
        (MissionStopped("Ctrl-C"), 130),
        (KeyboardInterrupt(), 130),
    ],
)
def test_each_end_of_a_flight_has_its_code(
    error: BaseException,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def flown(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("upwash.cli.fly.fly_with_progress", flown)
    (tmp_path / "drone.toml").write_text(CONFIG)
    assert main(["fly", "--config", str(tmp_path / "drone.toml"), "--log", str(tmp_path / "log")]) == code
    assert str(error).removeprefix("mission: ") in capsys.readouterr().err


def test_the_help_and_the_page_name_every_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["fly", "--help"])
    told, page = capsys.readouterr().out, (ROOT / "docs" / "flight-ends.md").read_text()
    for code in ExitCode:
        assert f"{code:<4}{MEANINGS[code]}" in told
        assert f"| {code:d} | " in page.partition("## How a command ends")[2]


def test_a_command_that_there_is_not_is_refused_with_the_nearest_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["-v", "simulte", "thesis.toml"]) == ExitCode.USAGE
    assert 'unknown command "simulte"; did you mean "simulate"?' in capsys.readouterr().err

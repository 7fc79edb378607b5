"""What upwash writes and reads again: cut off anywhere, it is read, or refused in a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.cli.exit_codes import ExitCode
from upwash.cli.main import main

SCENARIO = """
[mission]
program = "survey"
mode = "heavy"
home = { latitude_deg = 39.36, longitude_deg = 22.95 }
waypoints_m = [[0, 0], [20, 0]]
[[service]]
name = "detector"
local_call_s = { light = 1.0, heavy = 3.0 }
[[server]]
name = "s1"
range_m = 50
east_m = 0
north_m = 0
remote_call_s = 0.5
[policy]
stay_or_go = "learn"
demand_map = "demands.json"
[event]
every = 2
"""
_RESUMED = "fly --config drone.toml --autopilot udpout:127.0.0.1:9 --resume"
WRITTEN = {
    "an event log": ("simulate s.toml --log flown.jsonl", "flown.jsonl", "report flown.jsonl --json"),
    "a log, continued": ("simulate s.toml --log flown.jsonl", "flown.jsonl", f"{_RESUMED} flown.jsonl"),
    "a map of demands": ("simulate s.toml --keep-demands", "demands.json", "simulate s.toml --keep-demands"),
    "a campaign": ("campaign s.toml --seeds 1 --out c.csv", "c.csv", "campaign s.toml --seeds 1 --out c.csv"),
    "a campaign's note": (
        "campaign s.toml --seeds 1 --out c.csv",
        "c.campaign.json",
        "campaign s.toml --seeds 1 --out c.csv",
    ),
    "a drawn world": ("worlds --seeds 1 --out .", "world-1.toml", "simulate world-1.toml"),
    "a list of revoked": ("keys k --drone d1", "k/revoked.txt", "keys k --revoke d1"),
    "an authority": ("keys k --drone d1", "k/authority.pem", "keys k --drone d2"),
    "an authority's key": ("keys k --drone d1", "k/authority.key", "keys k --drone d2"),
    "a certificate": ("keys k --drone d1", "k/d1.pem", "keys k"),
}
_PARTS = 12  # of each file, of which the first ones are there


def cut(file: Path) -> list[bytes]:
    """The file cut off at places all over it, and as a disk without power leaves it."""
    whole = file.read_bytes()
    places = [*range(3), *(len(whole) * part // _PARTS for part in range(1, _PARTS)), len(whole) - 1]
    return [*(whole[:place] for place in places), bytes(len(whole))]


@pytest.mark.parametrize("name", WRITTEN)
def test_a_file_that_is_cut_off_anywhere_is_read_or_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(SCENARIO)
    Path("drone.toml").write_text(SCENARIO.partition("[event]")[0] + "[camera]\npark_seed = 1\n")
    write, written, read = WRITTEN[name]
    assert main(write.split()) == ExitCode.DONE
    for content in cut(Path(written)):
        Path(written).write_bytes(content)
        capsys.readouterr()
        code = main(read.split())
        said = capsys.readouterr().err
        assert code in (ExitCode.DONE, ExitCode.FAILURE, ExitCode.USAGE)
        assert (code == ExitCode.DONE) or said.splitlines()[-1].startswith("upwash: ")

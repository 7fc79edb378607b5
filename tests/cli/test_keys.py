"""What `upwash keys` shows of a folder."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from upwash.cli.main import main


def test_it_lists_holders_roles_ends_and_fingerprints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["keys", str(tmp_path), "--server", "s1", "--drone", "d1", "--days", "30"]) == 0
    assert main(["keys", str(tmp_path), "--revoke", "d1"]) == 0
    capsys.readouterr()
    assert main(["keys", str(tmp_path)]) == 0
    authority, d1, s1 = capsys.readouterr().out.splitlines()
    for line, expected in (
        (authority, r"authority  authority  until \d{4}-\d\d-\d\d  3651 days  [0-9a-f]{64}"),
        (d1, r"d1  drone  until \d{4}-\d\d-\d\d  revoked  [0-9a-f]{64}"),
        (s1, r"s1  server  until \d{4}-\d\d-\d\d  29 days  [0-9a-f]{64}"),
    ):
        assert re.fullmatch(expected, line)
    digits = s1.split()[-1]
    assert main(["keys", str(tmp_path), "--revoke", digits]) == 0
    assert digits in (tmp_path / "revoked.txt").read_text()


@pytest.mark.parametrize("days", ["0", "-1", "3653", "1e3", "inf", "99999999999999999999", ""])
def test_days_that_cannot_be_are_refused(
    tmp_path: Path, days: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["keys", str(tmp_path), "--drone", "d1", f"--days={days}"])
    assert "a number of days from 1 to 3652" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("arguments", "said"), [([], "name a folder"), (["."], "no certificates here")])
def test_without_certificates_it_says_how_to_begin(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["keys", *arguments]) == 2
    assert said in capsys.readouterr().err

"""Files that commands leave, and standard streams that take nothing."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from upwash.errors import NotWritten
from upwash.support.output_files import append_whole, write_file
from upwash.support.standard_streams import Forgiving


class Full(io.StringIO):
    def write(self, _: str) -> int:
        raise OSError(28, "No space left on device")


def cut_after(most_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on `os.write` has room for that many bytes, as a disk that fills up."""
    write, room = os.write, [most_bytes]

    def cut(file: int, data: bytes) -> int:
        if not room[0]:
            raise OSError(28, "No space left on device")
        written = write(file, data[: room[0]])
        room[0] -= written
        return written

    monkeypatch.setattr(os, "write", cut)


def test_a_file_is_made_with_its_folder_and_replaced_with_its_mode_kept(tmp_path: Path) -> None:
    file = tmp_path / "new" / "file"
    write_file(file, b"one")
    file.chmod(0o640)
    write_file(file, b"two")
    assert (file.read_bytes(), file.stat().st_mode & 0o777) == (b"two", 0o640)
    assert [each.name for each in file.parent.iterdir()] == ["file"]
    previous = os.umask(0)
    try:
        write_file(tmp_path / "secret", b"", mode=0o600)
    finally:
        os.umask(previous)
    assert (tmp_path / "secret").stat().st_mode & 0o777 == 0o600


def test_a_link_is_followed_and_what_is_no_file_is_written_to(tmp_path: Path) -> None:
    file, link, pipe = tmp_path / "file", tmp_path / "link", tmp_path / "pipe"
    file.write_bytes(b"one")
    link.symlink_to(file)
    write_file(link, b"two")
    assert link.is_symlink() and file.read_bytes() == b"two"
    os.mkfifo(pipe)
    with os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as reading:
        write_file(pipe, b"three")
        assert reading.read() == b"three"
    with pytest.raises(NotWritten, match=r"/dev/full: cannot be written \(No space left"):
        write_file(Path("/dev/full"), b"four")
    with pytest.raises(NotWritten, match=r"cannot be written \(Is a directory\)"):
        write_file(tmp_path, b"five")


@pytest.mark.parametrize("room_bytes", [0, 1, 4])
def test_without_room_a_file_is_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room_bytes: int
) -> None:
    file = tmp_path / "file"
    cut_after(room_bytes, monkeypatch)
    with pytest.raises(NotWritten, match="nothing of it was left there"):
        write_file(file, b"12345")
    assert list(tmp_path.iterdir()) == []
    file.write_bytes(b"before")
    with pytest.raises(NotWritten, match="what was there before is unchanged"):
        write_file(file, b"12345")
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"file": b"before"}


def test_what_was_cut_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"one\n")
    cut_after(3, monkeypatch)
    with file.open("ab", buffering=0) as opened:
        with pytest.raises(OSError, match="No space left"):
            append_whole(opened.fileno(), b"two, three\n")
        assert file.read_bytes() == b"one\n"
        monkeypatch.undo()
        append_whole(opened.fileno(), b"two\n")
    assert file.read_bytes() == b"one\ntwo\n"


def test_a_stream_that_takes_nothing_raises_nothing_and_knows_why() -> None:
    stream = Forgiving(Full())
    print("one", file=stream)
    stream.flush()
    assert stream.trouble is not None and stream.trouble.errno == 28
    assert not stream.isatty()


@pytest.mark.parametrize(
    ("output", "code", "said"),
    [
        ("/dev/full", 3, "upwash: standard output cannot be written (No space left on device)\n"),
        ("/dev/null", 0, ""),
    ],
)
@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ("keys", "keys", "--drone", "heron")])
def test_output_that_is_lost_is_told_by_the_exit_code(
    tmp_path: Path, arguments: tuple[str, ...], output: str, code: int, said: str
) -> None:
    command = [sys.executable, "-m", "upwash", *arguments]
    with Path(output).open("w") as stdout:
        done = subprocess.run(
            command, cwd=tmp_path, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (code, said)


def test_streams_that_are_closed_are_nobodys_files(tmp_path: Path) -> None:
    command = f"exec {sys.executable} -m upwash keys keys --drone heron <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, check=False).returncode == 0
    assert (tmp_path / "keys" / "heron.key").read_text().startswith("-----BEGIN PRIVATE KEY-----\n")
    assert (tmp_path / "keys" / "heron.key").read_text().endswith("-----END PRIVATE KEY-----\n")

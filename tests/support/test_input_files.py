"""Files that a user names are read within bounds, whatever they are."""

from __future__ import annotations

import os
import socket
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.config.kept_maps import CoverageFile
from upwash.config.reading import read_document
from upwash.errors import UpwashError
from upwash.eventlog.log import read as read_log
from upwash.mavlink.signing import key_of
from upwash.plans import read_plan
from upwash.real.trust.credentials import read_credentials, read_revoked
from upwash.real.trust.secrets import read_secret
from upwash.services.darknet.cfg import read_sections
from upwash.sim.radio import read_goodput
from upwash.support.input_files import read_file, read_toml, text_of

ENDLESS = Path("/dev/zero")


@contextmanager
def within_a_second() -> Iterator[None]:
    began_s = time.monotonic()
    yield
    assert time.monotonic() - began_s < 1.0


@contextmanager
def within_a_second_of_work() -> Iterator[None]:
    """Of this thread's own: what waits for nothing may be held up by other programs."""
    began_s = time.thread_time()
    yield
    assert time.thread_time() - began_s < 1.0


def pipe(folder: Path) -> Path:
    """A named pipe that nobody writes to."""
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


def unix_socket(folder: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(folder / "socket"))
    return folder / "socket"


def sparse(folder: Path) -> Path:
    """A file of 1 GB."""
    with (folder / "sparse").open("wb") as file:
        file.truncate(10**9)
    return folder / "sparse"


@pytest.mark.parametrize("made", [lambda _: ENDLESS, lambda _: Path("/dev/ptmx"), pipe, unix_socket, sparse])
def test_what_has_no_end_or_is_no_file_is_refused(tmp_path: Path, made: Callable[[Path], Path]) -> None:
    file = made(tmp_path)
    with within_a_second(), pytest.raises((OSError, ValueError)):
        read_file(file, most_bytes=10**6)


def test_a_file_is_read_whole_up_to_its_bound(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(bytes(200_000))
    assert read_file(file, most_bytes=200_000) == bytes(200_000)
    with pytest.raises(ValueError, match=r"larger than 0\.199999 MB"):
        read_file(file, most_bytes=199_999)


def test_a_pipe_is_read_to_its_end(tmp_path: Path) -> None:
    """As `--config <(generate)` gives one."""
    named = pipe(tmp_path)
    writer = threading.Thread(target=named.write_bytes, args=(b"x" * 200_000,))
    writer.start()
    assert read_file(named, most_bytes=10**6) == b"x" * 200_000
    writer.join()


@pytest.mark.parametrize(
    "read",
    [
        read_drone_config,
        read_daemon_config,
        read_plan,
        read_log,
        read_revoked,
        lambda file: read_credentials(file, file, file),
        lambda file: read_goodput(str(file)),
    ],
)
def test_every_reader_says_in_one_line_that_a_file_has_no_end(read: Callable[[Path], object]) -> None:
    with within_a_second(), pytest.raises(UpwashError) as refused:
        read(ENDLESS)
    assert str(ENDLESS) in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_a_log_that_can_be_read_only_once_is_refused(tmp_path: Path) -> None:
    with within_a_second(), pytest.raises(UpwashError, match="is a device or a pipe"):
        read_log(pipe(tmp_path))


DEEP = [
    ".".join(["a"] * 50_000) + " = 1",
    "[" + ".".join(["a"] * 50_000) + "]",
    "[[" + " . ".join(['"a b"', "'c.d'"] * 25_000) + "]]",
    "x = { " + ".".join(["a"] * 50_000) + " = 1 }",
    "x = " + "[" * 50_000 + "]" * 50_000,
    "x = " + "{a=" * 50_000 + "1" + "}" * 50_000,
]


@pytest.mark.parametrize("text", DEEP, ids=range(len(DEEP)))
def test_a_configuration_that_is_nested_without_end_is_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(f'name = "d1"\n{text}\n')
    with within_a_second_of_work(), pytest.raises(UpwashError) as refused:
        read_drone_config(file)
    assert str(refused.value).startswith(f"{file}: ")
    assert len(str(refused.value)) < 1000
    assert len(str(refused.value).splitlines()) == 1


LONG = {
    "letters": "a" * 999_000,
    "quotes": '"' * 999_000,
    "dots": "a." * 499_000 + "=",
    "lines": '"a\n' * 300_000,
}


@pytest.mark.parametrize("text", LONG.values(), ids=LONG)
def test_looking_for_long_keys_takes_no_longer_than_reading(text: str) -> None:
    with within_a_second_of_work(), pytest.raises(ValueError, match=r"\w"):
        read_toml(text)


@given(st.lists(st.sampled_from(["a", "b-1", '"x.y"', "'z'", ".", " ", "=", "1.5", "[", "]", "\n", ","])))
def test_toml_that_is_not_deep_is_read_as_it_is(parts: list[str]) -> None:
    text = "".join(parts)
    try:
        wanted = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        with pytest.raises(ValueError, match=r"\w"):
            read_toml(text)
    else:
        assert read_toml(text) == wanted


# --- byte order marks ---------------------------------------------------------------------------------------

MARKED = ["utf-8-sig", "utf-16"]


@given(st.text())
def test_a_text_is_the_same_with_and_without_a_byte_order_mark(text: str) -> None:
    text = text.removeprefix("\ufeff")
    assert {text_of(text.encode(encoding)) for encoding in ("utf-8", *MARKED)} == {text}


@pytest.mark.parametrize("content", [b"\xff", b"\xff\xfe{", b"\xef\xbb\xbf\xff"])
def test_what_is_no_text_is_said_to_be_none(content: bytes) -> None:
    with pytest.raises(UnicodeDecodeError):
        text_of(content)


def marked(file: Path, text: str, encoding: str) -> Path:
    file.write_bytes(text.encode(encoding))
    return file


@pytest.mark.parametrize("encoding", MARKED)
def test_configurations_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    drone = (Path(__file__).parents[1] / "config" / "full.toml").read_text()
    server = (Path(__file__).parents[1] / "config" / "daemon.toml").read_text()
    folder = tmp_path / "marked"
    folder.mkdir()
    assert read_document(marked(folder / "drone.toml", drone, encoding)) == tomllib.loads(drone)
    assert read_document(marked(folder / "server.toml", server, encoding)) == tomllib.loads(server)


@pytest.mark.parametrize("encoding", MARKED)
def test_a_table_of_goodput_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    table = marked(tmp_path / f"{encoding}.csv", "distance_m,goodput_mbit_s\n10,50\n20,25\n", encoding)
    assert read_goodput(str(table)) is not None


@pytest.mark.parametrize("encoding", MARKED)
def test_a_coverage_map_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    file = marked(tmp_path / "coverage.json", '{"upwash_coverage": 1}', encoding)
    assert CoverageFile(file).places(None) == {}


@pytest.mark.parametrize("encoding", MARKED)
def test_secrets_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    key = marked(tmp_path / "key", f"{'ab' * 32}\n", encoding)
    key.chmod(0o600)
    assert key_of(read_secret(key)) == bytes.fromhex("ab" * 32)
    revoked = marked(tmp_path / "revoked", f"{'cd' * 32} lost\n", encoding)
    assert read_revoked(revoked) == {"cd" * 32}


def test_a_key_of_32_bytes_may_begin_with_any(tmp_path: Path) -> None:
    key = b"\xff\xfe" + b"a" * 30
    (tmp_path / "key").write_bytes(key)
    (tmp_path / "key").chmod(0o600)
    assert read_secret(tmp_path / "key") == key


@pytest.mark.parametrize("encoding", MARKED)
def test_the_files_of_a_darknet_model_may_begin_with_a_byte_order_mark(encoding: str) -> None:
    (section,) = read_sections(Path("some.cfg"), "[net]\n".encode(encoding))
    assert section.name == "net"

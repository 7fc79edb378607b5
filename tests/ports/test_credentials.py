"""Certificates: how they are made, which are refused, and whom they let in over a real connection."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import grpc
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

from upwash.core.admission.clients import Role
from upwash.errors import CredentialsError, NotWritten, Unreachable, UsageError
from upwash.real.link.link import GrpcDialer
from upwash.real.trust import authority as module
from upwash.real.trust.authority import drop_former_authorities, made_in, make_keys, renew_authority, revoke
from upwash.real.trust.credentials import Credentials, read_credentials, read_revoked, role_of
from upwash.real.trust.secrets import exposure


def read(folder: Path, name: str, *, authority: Path | None = None) -> Credentials:
    return read_credentials(
        (authority or folder) / "authority.pem", folder / f"{name}.pem", folder / f"{name}.key"
    )


def certificate(folder: Path, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / f"{name}.pem").read_bytes())


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A folder with an authority, a daemon that is two servers, and a drone."""
    make_keys(tmp_path, servers=[["s1", "s2"]], drones=["heron"])
    return tmp_path


def test_the_files_written_are_returned(tmp_path: Path) -> None:
    files = make_keys(tmp_path / "new", servers=[["s1"]], drones=["heron"])
    names = ["authority.pem", "authority.key", "revoked.txt", "s1.pem", "s1.key", "heron.pem", "heron.key"]
    assert files == [tmp_path / "new" / name for name in names]


def test_a_certificate_is_good_for_all_its_names_and_a_drones_for_no_server(keys: Path) -> None:
    assert read(keys, "s1").names == ("s1", "s2")
    assert read(keys, "heron").names == ("heron",)
    for name, purposes in (
        ("s1", [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
        ("heron", [ExtendedKeyUsageOID.CLIENT_AUTH]),
    ):
        made = certificate(keys, name)
        usage = made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert list(usage) == purposes
        assert not made.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        public_key = made.public_key()
        assert isinstance(public_key, ec.EllipticCurvePublicKey)
        assert public_key.curve.name == "secp256r1"


def test_the_authority_signs_certificates_and_no_further_authorities(keys: Path) -> None:
    extensions = certificate(keys, "authority").extensions
    constraints = extensions.get_extension_for_class(x509.BasicConstraints)
    assert (constraints.critical, constraints.value.ca, constraints.value.path_length) == (True, True, 0)
    assert extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign


def test_certificates_last_two_years_the_authority_ten_and_clocks_may_be_a_day_off(keys: Path) -> None:
    now = datetime.now(UTC)
    for name, years in (("authority", 10), ("s1", 2), ("heron", 2)):
        made = certificate(keys, name)
        assert made.not_valid_before_utc < now - timedelta(hours=23)
        assert abs(made.not_valid_after_utc - now - timedelta(days=365.25 * years)) < timedelta(days=2)


def test_keys_are_never_readable_by_others_not_even_while_they_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes_at_birth: dict[str, int] = {}
    fdopen = os.fdopen

    def watched(descriptor: int, mode: str) -> Any:
        status = os.fstat(descriptor)
        modes_at_birth[str(Path(f"/proc/self/fd/{descriptor}").readlink())] = status.st_mode & 0o777
        return fdopen(descriptor, mode)

    monkeypatch.setattr(os, "fdopen", watched)
    previous = os.umask(0)
    try:
        make_keys(tmp_path, servers=[["s1"]])
    finally:
        os.umask(previous)
    for name in ("authority.key", "s1.key"):
        file = str((tmp_path / name).resolve())
        assert modes_at_birth[file] == 0o600
        assert Path(file).stat().st_mode & 0o777 == 0o600


def test_an_authority_that_is_there_signs_later_certificates_too(keys: Path) -> None:
    before = (keys / "authority.pem").read_bytes()
    files = make_keys(keys, drones=["stork"])
    assert files == [keys / "stork.pem", keys / "stork.key"]
    assert (keys / "authority.pem").read_bytes() == before
    assert read(keys, "stork").names == ("stork",)


def test_nothing_is_overwritten_and_nothing_written_if_one_file_is_there(keys: Path) -> None:
    before = (keys / "heron.key").read_bytes()
    with pytest.raises(UsageError, match=r"heron\.key: already there.*move it away"):
        make_keys(keys, drones=["stork", "heron"])
    assert (keys / "heron.key").read_bytes() == before
    assert not (keys / "stork.key").exists()


@pytest.mark.parametrize("lost", ["authority.key", "authority.pem"])
def test_half_an_authority_is_not_replaced(keys: Path, lost: str) -> None:
    (keys / lost).unlink()
    with pytest.raises(UsageError, match=rf"{lost}: missing beside .*restore it"):
        make_keys(keys, drones=["stork"])
    assert not (keys / lost).exists()


def test_an_authority_with_the_key_of_another_signs_nothing(keys: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "other")
    (keys / "authority.key").write_bytes((tmp_path / "other/authority.key").read_bytes())
    with pytest.raises(CredentialsError, match=r"authority\.key: not the elliptic-curve key of"):
        make_keys(keys, drones=["stork"])


@pytest.mark.parametrize("name", ["", "a b", "../s1", "s/1", "s1\n", "ü", "*", "x" * 65, "authority"])
def test_a_name_that_cannot_be_a_file_and_a_host_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="name"):
        make_keys(tmp_path / "new", servers=[["s1", name]])
    with pytest.raises(UsageError, match="name"):
        make_keys(tmp_path / "new", drones=[name])
    assert not (tmp_path / "new").exists()


def test_a_name_given_twice_or_not_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="named twice"):
        make_keys(tmp_path, servers=[["s1"]], drones=["s1"])
    with pytest.raises(UsageError, match="without a name"):
        make_keys(tmp_path, servers=[[]])


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"file: cannot be made.*name another folder"):
        make_keys(tmp_path / "file", drones=["heron"])


@pytest.mark.parametrize("name", ["authority.pem", "heron.pem", "heron.key"])
def test_a_missing_or_unreadable_or_foreign_file_is_named(keys: Path, name: str) -> None:
    file = keys / name
    file.write_bytes(b"\x00 not PEM")
    with pytest.raises(CredentialsError, match=rf"{name}: not a PEM .*give the"):
        read(keys, "heron")
    file.unlink()
    with pytest.raises(CredentialsError, match=rf"{name}: no such file: check the path"):
        read(keys, "heron")
    file.mkdir()
    with pytest.raises(CredentialsError, match=rf"{name}: cannot be read"):
        read(keys, "heron")


def test_a_key_that_others_can_read_is_refused_with_the_remedy(keys: Path) -> None:
    key = keys / "heron.key"
    key.chmod(0o644)
    with pytest.raises(CredentialsError) as refused:
        read(keys, "heron")
    assert str(refused.value) == f"{key}: others can read it (mode 0644): `chmod 600 {key}`"
    key.chmod(0o600)
    assert read(keys, "heron").names == ("heron",)
    (keys / "authority.key").chmod(0o604)
    with pytest.raises(CredentialsError, match=r"authority\.key: others can read it \(mode 0604\)"):
        make_keys(keys, drones=["stork"])
    assert not (keys / "stork.key").exists()


def test_a_key_that_is_a_link_into_a_mounted_secret_is_read(keys: Path) -> None:
    (keys / "heron.key").rename(keys / "mounted")
    (keys / "heron.key").symlink_to("mounted")
    (keys / "mounted").chmod(0o400)
    assert read(keys, "heron").names == ("heron",)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file away")
@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604])
def test_one_command_helps_with_a_key_of_another_user(mode: int, keys: Path) -> None:
    key = keys / "heron.key"
    os.chown(key, 61_234, 61_234)
    key.chmod(mode)
    with pytest.raises(CredentialsError, match="can read it") as refused:
        read(keys, "heron")
    subprocess.run(str(refused.value).split("`")[1], shell=True, check=True, timeout=10)
    assert read(keys, "heron").names == ("heron",)


def test_a_key_of_roots_may_be_read_by_the_group_of_a_service_and_nobody_elses() -> None:
    root, user = 0, 1000
    for mode in (0o400, 0o600, 0o700):
        assert exposure(mode, owner=root) == exposure(mode, owner=user) == ""
    for mode in (0o440, 0o640):
        assert exposure(mode, owner=root) == ""
        assert exposure(mode, owner=user) == f"its group can read it (mode {mode:04o})"
        assert exposure(mode, owner=user, in_private_group=True) == ""
    for mode in (0o620, 0o660, 0o650):
        assert exposure(mode, owner=root).startswith("its group can change it")
    for mode in (0o644, 0o606, 0o604):
        assert exposure(mode, owner=root).startswith("others can read it")
    assert exposure(0o601, owner=root).startswith("others can change it")


@pytest.mark.parametrize("name", ["authority.pem", "heron.pem", "heron.key"])
def test_what_is_no_file_or_endless_is_refused_at_once(keys: Path, name: str) -> None:
    file = keys / name
    file.unlink()
    os.mkfifo(file, 0o600)
    with pytest.raises(CredentialsError, match=rf"{name}: cannot be read \(not a file\)"):
        read(keys, "heron")
    file.unlink()
    file.symlink_to("/dev/zero")
    with pytest.raises(CredentialsError, match=rf"{name}: cannot be read \(not a file\)"):
        read(keys, "heron")
    file.unlink()
    file.touch(0o600)
    os.truncate(file, 2**40)
    with pytest.raises(CredentialsError, match=rf"{name}: more than 1 MiB"):
        read(keys, "heron")


def test_a_key_with_a_password_is_refused(keys: Path) -> None:
    key = load_pem_private_key((keys / "heron.key").read_bytes(), None)
    locked = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret"))
    (keys / "heron.key").write_bytes(locked)
    with pytest.raises(CredentialsError, match="without a password"):
        read(keys, "heron")


def test_the_key_of_another_certificate_is_refused(keys: Path) -> None:
    with pytest.raises(CredentialsError, match=r"s1\.key: not the key of .*heron\.pem"):
        read_credentials(keys / "authority.pem", keys / "heron.pem", keys / "s1.key")


def test_a_certificate_of_another_authority_is_refused(keys: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "other")
    with pytest.raises(CredentialsError, match=r"heron\.pem: not issued by .*other/authority\.pem"):
        read(keys, "heron", authority=tmp_path / "other")


def test_an_outdated_certificate_says_since_when(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_for = timedelta(days=-3)
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", timedelta(days=10))
    monkeypatch.setattr(module, "_CERTIFICATE_LASTS", made_for)
    make_keys(tmp_path, drones=["heron"])
    day = (datetime.now(UTC) + made_for).strftime("%Y-%m-%d")
    with pytest.raises(
        CredentialsError, match=rf"heron\.pem: .*heron has expired: .* to {day}.*make a new one"
    ):
        read(tmp_path, "heron")


def test_a_certificate_from_the_future_is_the_clocks_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", timedelta(days=-1))
    make_keys(tmp_path, drones=["heron"])
    with pytest.raises(CredentialsError, match=r"is not valid yet: .*set this computer's clock"):
        read(tmp_path, "heron")


def test_the_key_is_not_shown_in_a_trace(keys: Path) -> None:
    assert "PRIVATE KEY" not in repr(read(keys, "heron"))


def test_an_instance_does_not_load_what_reads_certificates() -> None:
    script = "import sys, upwash.real.instances.instance; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert "cryptography" not in loaded.split()


class _Echo(grpc.GenericRpcHandler):  # type: ignore[misc]  # grpc has no types
    def service(self, handler_call_details: Any) -> Any:
        return grpc.unary_unary_rpc_method_handler(lambda body, _: body)


@contextmanager
def echo_server(shown: Credentials) -> Iterator[int]:
    """A server that demands a certificate of the authority; gives its port."""
    with ThreadPoolExecutor(max_workers=1) as threads:
        server = grpc.server(threads, handlers=[_Echo()])
        demanded = grpc.ssl_server_credentials(
            [(shown.key, shown.certificate)], root_certificates=shown.authority, require_client_auth=True
        )
        port = server.add_secure_port("127.0.0.1:0", demanded)
        server.start()
        try:
            yield port
        finally:
            server.stop(grace=None).wait()


def unreachable(port: int, shown: Credentials, server: str) -> str:
    """Why a link with that certificate reaches no such server there; "" where it is answered."""

    async def ask() -> str:
        link = GrpcDialer("heron", shown, max_message_bytes=1000).dial(f"127.0.0.1:{port}", server=server)
        try:
            await link.request("/upwash/echo", b"hello", timeout_s=10.0)
        except Unreachable as error:
            return str(error)
        finally:
            await link.close()
        return ""

    return asyncio.run(ask())


def test_a_server_that_shows_a_drones_certificate_is_not_believed(keys: Path) -> None:
    make_keys(keys, drones=["stork"])
    with echo_server(read(keys, "stork")) as port:
        assert unreachable(port, read(keys, "heron"), "stork")


def dated(folder: Path, monkeypatch: pytest.MonkeyPatch, *, begun: timedelta, lasts: timedelta) -> None:
    """Makes s9 and egret, whose certificates are valid from `begun` before now on for so long from now."""
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", begun)
    monkeypatch.setattr(module, "_CERTIFICATE_LASTS", lasts)
    make_keys(folder, servers=[["s9"]], drones=["egret"])


def read_undated(folder: Path, name: str) -> Credentials:
    return read_credentials(
        folder / "authority.pem", folder / f"{name}.pem", folder / f"{name}.key", valid_now=False
    )


@pytest.mark.parametrize(
    ("begun", "lasts", "trouble"),
    [
        (timedelta(days=-1), timedelta(days=9), "is not valid yet"),
        (timedelta(days=9), timedelta(days=-1), "has expired"),
    ],
)
def test_a_link_that_fails_for_dates_names_them_and_the_computers_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: timedelta, lasts: timedelta, trouble: str
) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["heron"])
    dated(tmp_path, monkeypatch, begun=begun, lasts=lasts)
    year = datetime.now(UTC).year
    with echo_server(read_undated(tmp_path, "s9")) as port:
        said = unreachable(port, read_undated(tmp_path, "heron"), "s9")
        assert f"its certificate {trouble}; this computer's clock says {year}" in said
        assert "heron" not in said
    egret = read_undated(tmp_path, "egret")
    with echo_server(read_undated(tmp_path, "s1")) as port:
        said = unreachable(port, egret, "s1")
    starts = certificate(tmp_path, "egret").not_valid_before_utc
    assert f"the certificate of egret {trouble}: it is valid from {starts:%Y-%m-%d}" in said
    assert f"this computer's clock says {year}" in said


def test_a_daemon_may_call_another_with_its_own_certificate(keys: Path) -> None:
    make_keys(keys, servers=[["s3"]])
    with echo_server(read(keys, "s1")) as port:
        assert unreachable(port, read(keys, "s3"), "s1") == ""


def test_a_certificate_says_what_it_is_for(keys: Path) -> None:
    make_keys(keys, servers=[["s3"]], drones=["stork"])
    assert read(keys, "s3").is_for("serving") and read(keys, "s3").is_for("calling")
    assert not read(keys, "stork").is_for("serving") and read(keys, "stork").is_for("calling")


def test_what_is_revoked_is_listed_once_by_its_fingerprint(tmp_path: Path) -> None:
    make_keys(tmp_path, drones=["heron", "stork"])
    assert read_revoked(tmp_path / "revoked.txt") == frozenset()
    for _ in range(2):
        assert revoke(tmp_path, ["heron"]) == tmp_path / "revoked.txt"
    revoked = read_revoked(tmp_path / "revoked.txt")
    assert revoked == {certificate(tmp_path, "heron").fingerprint(hashes.SHA256()).hex()}
    revoke(tmp_path, ["stork"])
    assert len(read_revoked(tmp_path / "revoked.txt")) == 2
    with pytest.raises(UsageError, match=r"egret.pem: no such certificate"):
        revoke(tmp_path, ["egret"])


def test_a_certificate_whose_files_are_gone_is_revoked_by_its_fingerprint(tmp_path: Path) -> None:
    make_keys(tmp_path, drones=["heron", "stork"])
    (_, heron, _) = made_in(tmp_path)
    (tmp_path / "heron.pem").unlink()
    (tmp_path / "heron.key").unlink()
    colons = ":".join(re.findall("..", heron.fingerprint.upper()))
    assert read_revoked(revoke(tmp_path, [colons])) == {heron.fingerprint}
    assert read_revoked(revoke(tmp_path, [heron.fingerprint])) == {heron.fingerprint}
    assert "of a holder whose certificate is not here, revoked" in (tmp_path / "revoked.txt").read_text()
    (_, stork) = made_in(tmp_path)
    assert f"{stork.fingerprint}  stork, revoked" in revoke(tmp_path, [stork.fingerprint]).read_text()
    for name in ("heron", heron.fingerprint[:16], "", f"{heron.fingerprint}0"):
        with pytest.raises(UsageError, match="64 digits of a SHA-256 fingerprint"):
            revoke(tmp_path, [name])


def test_what_was_made_is_shown_with_its_role_its_end_and_whether_it_is_revoked(tmp_path: Path) -> None:
    make_keys(tmp_path, servers=[["s1", "s2"]], operators=["alice"])
    make_keys(tmp_path, drones=["heron"], lasts=timedelta(days=90))
    revoke(tmp_path, ["alice"])
    now = datetime.now(UTC)
    assert [
        (each.holder, each.role, (each.ends - now).days, each.is_revoked) for each in made_in(tmp_path)
    ] == [
        ("alice", "operator", 729, True),
        ("authority", "authority", 3651, False),
        ("heron", "drone", 89, False),
        ("s1", "server", 729, False),
    ]


def test_no_certificate_outlives_its_authority(tmp_path: Path) -> None:
    make_keys(tmp_path, drones=["heron"], lasts=timedelta(days=5000))
    heron, authority = read(tmp_path, "heron").expiries.values()
    assert heron == authority


def test_a_list_without_room_for_another_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_keys(tmp_path, drones=["heron", "stork"])
    revoke(tmp_path, ["heron"])
    before = (tmp_path / "revoked.txt").read_bytes()
    monkeypatch.setattr(os, "write", _full_after(100))
    with pytest.raises(
        NotWritten, match=r"revoked\.txt: cannot be written \(No space left on device\): what was"
    ):
        revoke(tmp_path, ["stork"])
    monkeypatch.undo()
    assert (tmp_path / "revoked.txt").read_bytes() == before
    revoke(tmp_path, ["stork"])
    assert (tmp_path / "revoked.txt").read_bytes().startswith(before)


def test_a_list_whose_last_line_was_not_ended_by_hand_is_added_to(tmp_path: Path) -> None:
    make_keys(tmp_path, drones=["heron", "stork"])
    (tmp_path / "revoked.txt").write_text(
        "# by hand\n" + certificate(tmp_path, "stork").fingerprint(hashes.SHA256()).hex()
    )
    revoke(tmp_path, ["heron"])
    assert len(read_revoked(tmp_path / "revoked.txt")) == 2


def _full_after(most_bytes: int) -> Callable[[int, bytes], int]:
    """`os.write` on a disk that has room for that many bytes more."""
    write, room_bytes = os.write, [most_bytes]

    def limited(file: int, data: bytes) -> int:
        if not room_bytes[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = write(file, data[: room_bytes[0]])
        room_bytes[0] -= written
        return written

    return limited


# --- another authority --------------------------------------------------------------------------------------


def test_a_new_authority_signs_and_the_former_is_still_believed(keys: Path) -> None:
    former = certificate(keys, "authority")
    former_key = (keys / "authority.key").read_bytes()
    written = renew_authority(keys)
    kept = keys / f"authority-{former.fingerprint(hashes.SHA256()).hex()[:8]}.key"
    assert written == [keys / "authority.pem", keys / "authority.key", kept]
    assert kept.read_bytes() == former_key
    assert [file.stat().st_mode & 0o777 for file in written] == [0o644, 0o600, 0o600]
    new, old = x509.load_pem_x509_certificates((keys / "authority.pem").read_bytes())
    assert old == former != new
    make_keys(keys, servers=[["s5"]], drones=["stork"])
    for name, issuer in (("heron", old), ("s1", old), ("stork", new), ("s5", new)):
        certificate(keys, name).verify_directly_issued_by(issuer)
        assert read(keys, name).expiries["authority"] == issuer.not_valid_after_utc
    with echo_server(read(keys, "s1")) as port:
        assert unreachable(port, read(keys, "stork"), "s1") == ""
    with echo_server(read(keys, "s5")) as port:
        assert unreachable(port, read(keys, "heron"), "s5") == ""
        assert unreachable(port, read(keys, "stork"), "s5") == ""


def test_an_authority_that_is_dropped_is_believed_no_more(keys: Path) -> None:
    heron = read(keys, "heron")
    renew_authority(keys)
    make_keys(keys, servers=[["s5"]], drones=["stork"])
    both = (keys / "authority.pem").read_bytes()
    assert drop_former_authorities(keys) == keys / "authority.pem"
    alone = (keys / "authority.pem").read_bytes()
    assert both.startswith(alone) and len(alone) < len(both)
    with pytest.raises(CredentialsError, match=r"heron\.pem: not issued by .*authority\.pem"):
        read(keys, "heron")
    with echo_server(read(keys, "s5")) as port:
        believing = Credentials(both, heron.certificate, heron.key)
        assert unreachable(port, believing, "s5")
        assert unreachable(port, read(keys, "stork"), "s5") == ""


def test_an_authority_that_has_expired_can_be_followed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_AUTHORITY_LASTS", timedelta(hours=-1))
    make_keys(tmp_path, drones=["heron"])
    monkeypatch.undo()
    with pytest.raises(CredentialsError, match=r"authority\.pem: .*has expired"):
        make_keys(tmp_path, drones=["stork"])
    renew_authority(tmp_path)
    make_keys(tmp_path, drones=["stork"])
    assert read(tmp_path, "stork").problem_at(datetime.now(UTC)) == ""
    with pytest.raises(CredentialsError, match=r"authority\.pem: .*has expired"):
        read(tmp_path, "heron")


def test_no_authority_is_made_anew_where_there_is_none_or_no_room(
    keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(CredentialsError, match=r"nothing/authority\.pem: no such file"):
        renew_authority(tmp_path / "nothing")
    before = {file: file.read_bytes() for file in keys.iterdir()}
    monkeypatch.setattr(module, "flush_to_disk", _failing(at=3))
    with pytest.raises(NotWritten, match="none of the files were made"):
        renew_authority(keys)
    assert {file: file.read_bytes() for file in keys.iterdir()} == before


@pytest.mark.parametrize("at", [1, 2, 5])
def test_without_room_for_all_keys_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    monkeypatch.setattr(module, "flush_to_disk", _failing(at))
    with pytest.raises(
        NotWritten, match=r"cannot be written \(Input/output error\): none of the files were made"
    ):
        make_keys(tmp_path / "new", servers=[["s1"]], drones=["heron"])
    assert not (tmp_path / "new").exists()
    monkeypatch.undo()
    assert len(make_keys(tmp_path / "new", servers=[["s1"]], drones=["heron"])) == 7


def _failing(at: int) -> Callable[[int], None]:
    """A disk that fails at the file of that number."""
    files: list[int] = []

    def flush(file: int) -> None:
        files.append(file)
        if len(files) == at:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    return flush


# --- what certificates say ----------------------------------------------------------------------------------


def test_a_list_that_names_no_fingerprint_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "revoked.txt"
    file.write_text("# a comment\n\nheron\n")
    with pytest.raises(CredentialsError, match="line 3 does not begin with a SHA-256 fingerprint"):
        read_revoked(file)


def test_certificates_of_operators_and_daemons_say_so_in_their_subjects(tmp_path: Path) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["heron"], operators=["alice"])
    subjects = {
        name: certificate(tmp_path, name).subject.rfc4514_string() for name in ("s1", "heron", "alice")
    }
    assert subjects == {"s1": "CN=s1,OU=server", "heron": "CN=heron", "alice": "CN=alice,OU=operator"}
    assert [role_of(subject) for subject in subjects.values()] == [Role.SERVER, Role.DRONE, Role.OPERATOR]
    assert role_of("CN=x OU=operator,O=OU=server") is Role.DRONE
    usage = certificate(tmp_path, "alice").extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.CLIENT_AUTH]

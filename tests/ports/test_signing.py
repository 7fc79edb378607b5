"""The driver and the stand-in with signed messages, and the files that hold a key."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AGILE, HASTY, HOME
from tests.ports.steps import claim_and_arm
from tests.ports.test_autopilot import FRAME, connection
from tests.system.attacks.flown import Router, free_port

from upwash.cli.main import main
from upwash.errors import AutopilotError, CredentialsError
from upwash.mavlink.signing import Signing, key_of_passphrase
from upwash.real.mavlink import MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.signing import make_signing_key, read_key, read_signing
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import serve_vehicle

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
DAY_S = 86_400.0


def late(key: bytes = KEY) -> Signing:
    """Of a computer whose clock is a day behind."""
    return Signing(key, unix_s=lambda: time.time() - DAY_S)


async def connected(to: str, signing: Signing | None, *, within_s: float = 20.0) -> MavlinkAutopilot:
    return await connect_autopilot(
        to, frame=FRAME, ground_speed_m_s=20.0, heartbeat_timeout_s=within_s, settings=HASTY, signing=signing
    )


@pytest.mark.parametrize("listen", ["udp:127.0.0.1:0", "tcp:127.0.0.1:0"])
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(Signing(KEY), Signing(KEY)), (late(), Signing(KEY)), (Signing(KEY), late())],
    ids=["clocks agree", "ours is behind", "the vehicle's is behind"],
)
async def test_with_one_key_the_vehicle_is_flown(listen: str, ours: Signing, theirs: Signing) -> None:
    vehicle = await serve_vehicle(listen, AGILE, signing=theirs)
    autopilot = await connected(connection(vehicle), ours)
    await claim_and_arm(autopilot)
    await autopilot.takeoff(2.0)
    await autopilot.land()
    await autopilot.close()
    await vehicle.close()


async def test_over_udpin_a_vehicle_whose_clock_is_behind_is_found() -> None:
    port = free_port()
    vehicle = await serve_vehicle("tcp:127.0.0.1:0", AGILE, signing=late())
    async with Router(port).running(vehicle.address):
        autopilot = await connected(f"udpin:127.0.0.1:{port}", Signing(KEY))
        await claim_and_arm(autopilot)
        await autopilot.disarm()
        await autopilot.close()
    await vehicle.close()


async def test_a_px4_is_flown_with_signatures_though_pymavlink_does_not_know_all_that_it_says() -> None:
    settings = Px4Settings(home=HOME, armable_after_s=0.0, parameters={"COM_OBL_RC_ACT": 5})
    vehicle = await serve_vehicle("udp:127.0.0.1:0", settings, signing=Signing(KEY))
    autopilot = await connected(connection(vehicle), Signing(KEY))
    await claim_and_arm(autopilot)
    await autopilot.disarm()
    await autopilot.close()
    await vehicle.close()


@pytest.mark.parametrize(
    ("ours", "theirs", "said"),
    [
        (
            Signing(KEY),
            None,
            r"an autopilot was heard on tcp:.*, and its messages are not signed; give it the key",
        ),
        (Signing(KEY), Signing(OTHER_KEY), r"its messages are signed with another key; give it the key"),
    ],
)
async def test_a_vehicle_without_the_key_is_told_from_one_that_is_not_there(
    *, ours: Signing, theirs: Signing | None, said: str
) -> None:
    vehicle = await serve_vehicle("tcp:127.0.0.1:0", AGILE, signing=theirs)
    with pytest.raises(AutopilotError, match=said):
        await connected(connection(vehicle), ours, within_s=2.5)
    await vehicle.close()


async def test_a_program_without_the_key_is_told_that_the_vehicle_signs() -> None:
    vehicle = await serve_vehicle("tcp:127.0.0.1:0", AGILE, signing=Signing(KEY))
    said = r"system 1.*signs its messages and answers none that is not signed: .*autopilot.signing_key"
    with pytest.raises(AutopilotError, match=said):
        await connected(connection(vehicle), None)
    await vehicle.close()


async def test_a_vehicle_with_a_key_obeys_nobody_without_it() -> None:
    vehicle = await serve_vehicle("tcp:127.0.0.1:0", AGILE, signing=Signing(KEY))
    reader, writer = await asyncio.open_connection("127.0.0.1", int(vehicle.address.rpartition(":")[2]))
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    for packet in arm.pack(codec), Signing(OTHER_KEY).pack(arm, codec), Signing(KEY).pack(arm, codec):
        writer.write(packet)
    codec.robust_parsing = True
    answers = 0
    async with asyncio.timeout(1.5):
        while not answers:
            messages = codec.parse_buffer(await reader.read(4096)) or ()
            answers += sum(message.get_type() == "COMMAND_ACK" for message in messages)
    assert answers == 1
    writer.close()
    await vehicle.close()


# --- files --------------------------------------------------------------------------------------------------


def key_file(folder: Path, content: bytes = KEY) -> Path:
    file = folder / "signing.key"
    file.write_bytes(content)
    file.chmod(0o600)
    return file


def made_at(packet: bytes) -> int:
    return int.from_bytes(packet[-12:-6], "little")


def beat(signing: Signing) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return signing.pack(mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3), codec)


def test_a_program_that_is_started_again_signs_later_than_before_whatever_the_clock_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = key_file(tmp_path)
    before = made_at(beat(read_signing(file)))
    again = Signing.__init__.__kwdefaults__ | {"unix_s": lambda: time.time() - DAY_S}  # type: ignore[operator]
    monkeypatch.setattr(Signing.__init__, "__kwdefaults__", again)
    assert made_at(beat(read_signing(file))) > before


def test_an_old_recording_is_refused_by_a_program_with_a_clock_that_is_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = key_file(tmp_path)
    recorded = beat(Signing(KEY, unix_s=lambda: time.time() - 600))
    beat(read_signing(file))
    again = Signing.__init__.__kwdefaults__ | {"unix_s": lambda: time.time() - DAY_S}  # type: ignore[operator]
    monkeypatch.setattr(Signing.__init__, "__kwdefaults__", again)
    assert read_signing(file).refusal(recorded) is not None


@pytest.mark.parametrize("mode", [0o604, 0o666, 0o620])
def test_a_key_that_others_can_read_or_write_is_refused_with_the_remedy(tmp_path: Path, mode: int) -> None:
    file = key_file(tmp_path)
    file.chmod(mode)
    with pytest.raises(CredentialsError, match=f"mode {mode:04o}.*: `chmod 600 {file}`"):
        read_key(file)


@pytest.mark.parametrize(("content", "said"), [(b"abc", "32 bytes, or 64"), (None, "no such file")])
def test_what_is_no_key_is_named(tmp_path: Path, content: bytes | None, said: str) -> None:
    file = key_file(tmp_path, content or b"")
    if content is None:
        file.unlink()
    with pytest.raises(CredentialsError, match=said):
        read_signing(file)


@pytest.mark.parametrize("broken", ["", "-1", "soon", str(2**48)])
def test_a_broken_time_beside_the_key_is_no_time(tmp_path: Path, broken: str) -> None:
    file = key_file(tmp_path)
    (tmp_path / "signing.key.time").write_text(broken)
    with pytest.raises(CredentialsError, match=r"signing.key.time cannot be kept .*remove the file"):
        read_signing(file)


def test_a_key_that_is_made_is_the_owners_alone_and_the_ground_stations_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "signing.key"
    assert main(["keys", "--signing", str(file)]) == 0
    printed = capsys.readouterr().out
    assert file.stat().st_mode & 0o777 == 0o600
    assert read_key(file) == key_of_passphrase(printed.split()[-1])
    assert main(["keys", "--signing", str(file)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert make_signing_key(tmp_path / "another.key") != printed.split()[-1]

"""Every decoder that faces a network or a file, by name: it takes bytes and raises nothing but its own errors.

Hypothesis and atheris feed the same table: test_decoders.py with each test run, `campaign` for as long as one likes.
"""

from __future__ import annotations

import atexit
import contextlib
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.config import read_drone_config
from upwash.config.daemon import read_daemon_config
from upwash.errors import CredentialsError, GarbledReply, Refused, UsageError
from upwash.eventlog import log as event_log
from upwash.mavlink.signing import Signing
from upwash.plans.reading import read_plan
from upwash.real.authority import keys_in, make_keys
from upwash.real.control import Called, Ended, Ready, Said, from_instance, line
from upwash.real.credentials import read_credentials
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.hearing import Hearing, from_autopilot
from upwash.real.mavlink.peer import Peer
from upwash.real.mavlink.telemetry import Telemetry
from upwash.rpc.protocol import (
    AvailabilityReply,
    AvailabilityRequest,
    LeaveRequest,
    StartReply,
    StartRequest,
    StatusReply,
    decode_reply,
    decode_request,
)
from upwash.rpc.service import spec_of
from upwash.services import Detector
from upwash.services.darknet.layers import read_network
from upwash.services.darknet.weights import WeightsFile
from upwash.services.heads import HEADS_METADATA, Head, encode_heads
from upwash.services.inference import ModelFiles, open_inference
from upwash.services.photo import NotAPhoto, read_photo
from upwash.sim.radio import read_goodput

ROOT = Path(__file__).parents[2]
Decode = Callable[[bytes], object]


@dataclass(frozen=True)
class Decoder:
    """What reads the bytes, what it may raise, and inputs that it understands."""

    decode: Decode
    refuses: tuple[type[Exception], ...]
    understood: tuple[bytes, ...]

    def feed(self, data: bytes) -> None:
        """Raises only what it may not."""
        try:
            self.decode(data)
        except self.refuses:
            return


# --- from a network -----------------------------------------------------------------------------------------


def _in_turn(*decodes: Decode, refuses: type[Exception]) -> Decode:
    """Each has to see the bytes, also those that another refuses."""

    def decode(data: bytes) -> None:
        for each in decodes:
            with contextlib.suppress(refuses):
                each(data)

    return decode


_PROCESS = spec_of(Detector).methods["process_photo"]


def _messages_of_a_vehicle(data: bytes) -> None:
    telemetry = Telemetry()
    for signing in None, Signing(bytes(32)):
        hearing = Hearing(lambda message: telemetry.take(message, 0.0), from_autopilot, signing)
        reader = hearing.reader()
        for start in range(0, len(data), 97):  # as a serial line delivers them
            hearing.take(data[start : start + 97], reader)
        peer = Peer(hearing, moved_after_s=0.0, signed=signing is not None)
        for second in range(2):
            peer.take(data, ("127.0.0.1", second), float(second))
    assert telemetry.mode is None or ARDUCOPTER.mode_name(telemetry.mode)
    assert telemetry.said_since(0) is not None
    assert telemetry.battery_percent is None or 0 <= telemetry.battery_percent <= 100


def _said_by_a_vehicle() -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = (
        mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3),
        mavlink.MAVLink_global_position_int_message(1_000, 393_666_000, 229_507_000, 0, 5_000, 0, 0, 0, 0),
        mavlink.MAVLink_extended_sys_state_message(0, 1),
        mavlink.MAVLink_statustext_message(4, b"ready"),
        mavlink.MAVLink_command_ack_message(400, 0),
    )
    return b"".join(bytes(message.pack(codec)) for message in messages)


# --- from a file --------------------------------------------------------------------------------------------


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="upwash-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _as_file(name: str, read: Callable[[Path], object]) -> Decode:
    def decode(data: bytes) -> object:
        file = _folder() / name
        file.write_bytes(data)
        return read(file)

    return decode


def _goodput(file: Path) -> object:
    read_goodput.cache_clear()  # which remembers a table by its file
    return read_goodput(str(file))


def _keys() -> Path:
    folder = _folder() / "keys"
    if not folder.exists():
        make_keys(folder, servers=[["s1"]], drones=["drone"])
    return folder


def _credentials(file: Path) -> None:
    """In the place of each of the three files."""
    files = keys_in(_keys(), "drone")
    authority, certificate, key = files.authority, files.certificate, files.key
    file.chmod(0o600)
    for given in ((file, certificate, key), (authority, file, key), (authority, certificate, file)):
        with contextlib.suppress(CredentialsError):
            read_credentials(*given)


def _cfg(data: bytes) -> object:
    return read_network(Path("model.cfg"), data)


_SMALL_CFG = b"""[net]
width=32
height=32
channels=3

[convolutional]
filters=2
size=1
stride=1
batch_normalize=1
activation=leaky

[convolutional]
filters=21
size=1
stride=1
activation=linear

[yolo]
mask=0,1,2
anchors=10,13, 16,30, 33,23
classes=2
num=3
"""


def _weights(file: Path) -> None:
    for _ in WeightsFile(file, read_network(Path("model.cfg"), _SMALL_CFG)).parameters():
        pass


def _small_weights() -> bytes:
    header = bytes((0, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0)) + bytes(8)
    return header + bytes(4 * (4 * 2 + 3 * 2 + 21 + 2 * 21))


def _model(file: Path) -> object:
    names = _folder() / "names"
    names.write_text("dog\ncat\n")
    return open_inference(ModelFiles(names=names, onnx=file), threads=1, provider="cpu", engine="onnxruntime")


def model_with(metadata: str) -> bytes:
    """An ONNX model that gives its picture back, with that text as what its outputs mean."""
    import onnx
    from onnx import TensorProto, helper

    picture = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, "height", "width"])
    heads = helper.make_tensor_value_info("heads", TensorProto.FLOAT, [1, 3, "height", "width"])
    graph = helper.make_graph([helper.make_node("Identity", ["picture"], ["heads"])], "g", [picture], [heads])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.helper.set_model_props(model, {HEADS_METADATA: metadata})
    content: bytes = model.SerializeToString()
    return content


def _metadata(data: bytes) -> None:
    file = _folder() / "model.onnx"
    file.write_bytes(model_with(data.decode(errors="replace")))
    _model(file)


_HEADS = encode_heads([Head(output="heads", stride=8, anchors=((10.0, 13.0),))])


def _photo() -> bytes:
    import cv2
    import numpy as np

    encoded: Any = cv2.imencode(".jpg", np.full((24, 32, 3), 90, np.uint8))[1]
    return bytes(encoded.tobytes())


# --- all of them --------------------------------------------------------------------------------------------


def _packed(*messages: msgspec.Struct) -> tuple[bytes, ...]:
    return tuple(map(msgspec.msgpack.encode, messages))


def _bytes_of(*files: str) -> tuple[bytes, ...]:
    return tuple((ROOT / file).read_bytes() for file in files)


@cache
def decoders() -> Mapping[str, Decoder]:
    """Each by its name."""
    keys = _keys()
    return {
        "requests to a daemon": Decoder(
            _in_turn(
                *(
                    partial(decode_request, expected=kind)
                    for kind in (AvailabilityRequest, StartRequest, LeaveRequest)
                ),
                refuses=Refused,
            ),
            (),
            _packed(
                AvailabilityRequest("s1", ["detector"]), StartRequest("s1", "detector"), LeaveRequest("s1")
            ),
        ),
        "replies of a daemon": Decoder(
            _in_turn(
                *(
                    partial(decode_reply, expected=kind, sender="s1")
                    for kind in (AvailabilityReply, StartReply, StatusReply)
                ),
                refuses=GarbledReply,
            ),
            (),
            _packed(AvailabilityReply(True, endpoints={"detector": ":1"}, lease_s=3.0), StartReply(":1")),
        ),
        "requests to a service": Decoder(
            _PROCESS.key_of, (msgspec.MsgspecError,), (_PROCESS.encode((b"photo", "light"), {})[1],)
        ),
        "replies of a service": Decoder(
            _PROCESS.decode,
            (GarbledReply,),
            (msgspec.msgpack.encode({"value": []}),),
        ),
        "reports of an instance": Decoder(
            from_instance.decode,
            (ValueError, RecursionError),
            tuple(line(each) for each in (Ready(":1"), Called("drone"), Said(b"x"), Ended(1))),
        ),
        "messages of a vehicle": Decoder(_messages_of_a_vehicle, (), (_said_by_a_vehicle(),)),
        "a drone's configuration": Decoder(
            _as_file("drone.toml", read_drone_config),
            (UsageError,),
            _bytes_of("scenarios/demonstration.toml", "tests/config/full.toml"),
        ),
        "a daemon's configuration": Decoder(
            _as_file("server.toml", read_daemon_config), (UsageError,), _bytes_of("tests/config/daemon.toml")
        ),
        "a plan": Decoder(
            _as_file("field.plan", read_plan),
            (UsageError,),
            _bytes_of("tests/plans/field.plan", "tests/plans/field.waypoints", "tests/plans/survey.plan"),
        ),
        "an event log": Decoder(
            _as_file("events.jsonl", event_log.read), (UsageError,), (b'{"t":0.5,"event":"armed"}\n',)
        ),
        "a goodput table": Decoder(
            _as_file("goodput.csv", _goodput), (UsageError,), (b"distance_m,goodput_mbit_s\n10,11.5\n20,9\n",)
        ),
        "certificates and keys": Decoder(
            _as_file("one.pem", _credentials),
            (),
            tuple((keys / name).read_bytes() for name in ("authority.pem", "drone.pem", "drone.key")),
        ),
        "a Darknet cfg": Decoder(_cfg, (UsageError,), (_SMALL_CFG,)),
        "Darknet weights": Decoder(_as_file("model.weights", _weights), (UsageError,), (_small_weights(),)),
        "an ONNX model": Decoder(_as_file("whole.onnx", _model), (UsageError,), (model_with(_HEADS),)),
        "an ONNX model's metadata": Decoder(_metadata, (UsageError,), (_HEADS.encode(),)),
        "a photo": Decoder(partial(read_photo, side_px=320), (NotAPhoto,), (_photo(),)),
    }

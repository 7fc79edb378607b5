"""Every decoder that faces a network or a file, by name: it takes bytes and raises nothing but its own errors.

Two feed the same table: test_decoders.py with each test run, `python -m tests.fuzz` for as long as one likes.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import io
import math
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, cast

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from tests.events import line as line_of

from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.config.kept_maps import CoverageFile, DemandFile
from upwash.config.traces import read_battery, read_goodput_trace, read_service_times, read_track, read_wind
from upwash.core.geo import GeoPosition, Position
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.operation import Operation
from upwash.core.planning.demand_map import DemandMap
from upwash.errors import CameraError, CredentialsError, GarbledReply, Refused, UpwashError, UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.results import read_result
from upwash.mavlink.ftp import Opcode, Packet, read_packet
from upwash.mavlink.signing import Signing
from upwash.plans import read_plan
from upwash.real.camera.bag import BagCamera
from upwash.real.camera.calibration import read_calibration
from upwash.real.camera.camera import read_photo_file
from upwash.real.camera.terrain import Terrain
from upwash.real.camera.video import read_frames
from upwash.real.instances.control import Called, Printed, Ready, ServiceEnded, from_instance, line
from upwash.real.instances.foreign import ForeignProgram, ProgramAnswer
from upwash.real.link.direct import frame
from upwash.real.link.limits import PREFACE, FrameCounter
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.receiver import MessageReceiver, Peer, from_autopilot
from upwash.real.mavlink.signing import read_key, read_signing
from upwash.real.mavlink.telemetry import VehicleTelemetry
from upwash.real.trust.authority import keys_in, make_keys
from upwash.real.trust.credentials import read_credentials, read_revoked
from upwash.report.reviews import read_reviews
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
from upwash.rpc.service import ServiceFault, service, spec_of
from upwash.services import Detector
from upwash.services.class_names import parse_names
from upwash.services.darknet.heads import HEADS_METADATA, Head, encode_heads
from upwash.services.darknet.layers import read_network
from upwash.services.darknet.weights import WeightsFile
from upwash.services.inference import ModelFiles, open_inference
from upwash.services.photo import NotAPhoto, read_photo
from upwash.services.ros_image import ENCODINGS, jpeg_of_message
from upwash.sim.radio import read_goodput
from upwash.support.exif import PhotoPlace, own_place, unturned, with_place, with_pose

ROOT = Path(__file__).parents[2]
Decode = Callable[[bytes], object]


_LONGEST_REFUSAL = 2000  # characters


class Broken(AssertionError):
    """A decoder did what it must not; the cause is what it raised."""


@dataclass(frozen=True)
class Decoder:
    """What reads the bytes, what it may raise, inputs that it understands, and what it may take for 1 MB at most."""

    decode: Decode
    refuses: tuple[type[Exception], ...]
    understood: tuple[bytes, ...]
    most_s: float = 1.0  # of the processor
    most_bytes: int = 300_000_000  # beside what the process held before
    tests: int = 100  # inputs in a run of the tests

    def feed(self, data: bytes) -> str:
        """The outcome in words; raises Broken."""
        began_s = time.thread_time()
        outcome = self._outcome(data)
        if (took_s := time.thread_time() - began_s) > self.most_s * max(1.0, len(data) / 1e6):
            raise Broken(f"{len(data)} bytes took {took_s:.1f} s: {outcome[:100]}")
        return outcome

    def _outcome(self, data: bytes) -> str:
        try:
            return type(self.decode(data)).__name__
        except self.refuses as refusal:
            outcome = str(refusal)
            if isinstance(refusal, (UpwashError, NotAPhoto)):  # what people read
                _require_readable(outcome)
            return outcome
        except Exception as error:
            raise Broken(f"raised {type(error).__name__}") from error


def _require_readable(message: str) -> None:
    if len(message) > _LONGEST_REFUSAL:
        raise Broken(f"the message has {len(message)} characters: {message[:200]!a}")
    if "\n" in message:  # the terminal and the log escape all else
        raise Broken(f"the message is not one line: {message[:300]!a}")


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
    telemetry = VehicleTelemetry()
    for signing in None, Signing(bytes(32)):
        hearing = MessageReceiver(lambda message: telemetry.take(message, 0.0), from_autopilot, signing)
        reader = hearing.reader()
        for start in range(0, len(data), 97):  # as a serial line delivers them
            hearing.take(data[start : start + 97], reader)
        peer = Peer(hearing, moved_after_s=0.0, signed=signing is not None)
        for second in range(2):
            peer.take(data, ("127.0.0.1", second), float(second))
    assert telemetry.mode is None or ARDUCOPTER.mode_name(telemetry.mode)
    assert telemetry.said_since(0) is not None
    charges = telemetry.batteries.charges_percent.values()
    assert all(percent is None or 0 <= percent <= 100 for percent in charges)


def _with_right_checksums(data: bytes) -> bytes:
    """The packets of MAVLink 2 in the bytes, each with the checksum that it needs to be looked at."""
    whole, at = bytearray(data), 0
    while (at := whole.find(0xFD, at)) >= 0 and at + 12 <= len(whole):
        end = at + 10 + whole[at + 1]
        known = mavlink.mavlink_map.get(int.from_bytes(whole[at + 7 : at + 10], "little"))
        if known is not None and end + 2 <= len(whole):
            checksum = mavlink.x25crc(whole[at + 1 : end])
            checksum.accumulate(bytes((known.crc_extra,)))
            whole[end : end + 2] = checksum.crc.to_bytes(2, "little")
            at = end
        at += 1
    return bytes(whole)


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


def _answers_of_a_program(data: bytes) -> None:
    """As a stream of frames, and as what stands in a frame of the right length."""
    for stream in (data, len(data).to_bytes(4) + data):
        with contextlib.suppress(EOFError, ValueError):
            ForeignProgram._read(
                cast(ForeignProgram, SimpleNamespace(_most_bytes=2_000_000)), io.BytesIO(stream)
            )


class _Counts:
    """A service whose arguments and results are arrays."""

    def count(self, points: np.ndarray[tuple[int, Literal[3]], np.dtype[np.float32]]) -> NDArray[np.int64]:
        """Counts them."""
        return np.array([len(points)])


_COUNT = spec_of(service(_Counts)).methods["count"]

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


def _as_secret(name: str, read: Callable[[Path], object]) -> Decode:
    def read_own(file: Path) -> object:
        file.chmod(0o600)
        return read(file)

    return _as_file(name, read_own)


def _log_of_every_kind() -> bytes:
    kinds = map(schema.kind_of, schema.EVENTS)
    return b"".join(line_of(kind, float(number)) for number, kind in enumerate(kinds))


def _reviews(file: Path) -> object:
    """Reads the reviews, and puts those of each finding in their order."""
    reviews = read_reviews(file.with_name("events.jsonl"))
    return [sorted(each, key=lambda ranked: ranked.rank) for each in reviews.by_finding.values()]


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


def model_that_detects() -> bytes:
    """An ONNX model as YOLOv8's that finds the same 21 boxes in each picture."""
    import onnx
    from onnx import TensorProto, helper

    picture = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 32, 32])
    boxes = helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 7, 21])
    numbers = helper.make_tensor(
        "numbers", TensorProto.FLOAT, [1, 7, 21], [*range(84), *(score / 63 for score in range(63))]
    )
    node = helper.make_node("Identity", ["numbers"], ["output0"])
    graph = helper.make_graph([node], "g", [picture], [boxes], [numbers])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.helper.set_model_props(model, {"names": "{0: 'dog', 1: 'cat', 2: 'owl'}", "task": "detect"})
    content: bytes = model.SerializeToString()
    return content


def _detect(file: Path) -> object:
    return Detector(model=ModelFiles(onnx=file), threads=1).process_photo(_photo())


def _metadata(data: bytes) -> None:
    file = _folder() / "model.onnx"
    file.write_bytes(model_with(data.decode(errors="replace")))
    _model(file)


_HEADS = encode_heads([Head(output="heads", stride=8, anchors=((10.0, 13.0),))])


def _photo(ending: str = ".jpg", *, progressive: bool = False) -> bytes:
    import cv2

    picture = np.arange(240 * 320 * 3, dtype=np.uint32).astype(np.uint8).reshape(240, 320, 3)
    encoded: Any = cv2.imencode(ending, picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1] if progressive else [])[1]
    return bytes(encoded.tobytes())


def _exif_of_a_camera() -> bytes:
    """With a directory that leads to another one, which leads back, and a thumbnail."""
    entries = b"".join(
        tag.to_bytes(2) + kind.to_bytes(2) + count.to_bytes(4) + value.to_bytes(4)
        for tag, kind, count, value in (
            (0x010F, 2, 20, 100),
            (0x8769, 4, 1, 8),
            (0x0201, 4, 1, 120),
            (0x0202, 4, 1, 40),
        )
    )
    tiff = b"MM\0*\0\0\0\x08" + b"\0\4" + entries + b"\0\0\0\x08" + bytes(120)
    exif = b"Exif\0\0" + tiff
    photo = _photo()
    return photo[:2] + b"\xff\xe1" + (2 + len(exif)).to_bytes(2) + exif + photo[2:]


_SHOT = PhotoPlace(39.3666, 22.9507, 415.25, 271.5, 1.7e9)


def _coverage(file: Path) -> None:
    """Reads the map, and does with it what a flight does."""
    kept = CoverageFile(file)
    known = Coverage(kept.places(GeoPosition(39.4, 22.9)))
    for server in known.servers:
        for place in list(known.places(server))[:10]:
            assert known.at(server, place.position) is not None
            assert place.goodput_bit_s is None or place.goodput_bit_s >= 0
    kept.keep(known, GeoPosition(39.4, 22.9))


def _map() -> bytes:
    file = _folder() / "valid map"
    operation = Operation("detector", "process_photo", "heavy")
    places = (
        MeasuredPlace(Position(30.0 * number, 40.0), 3, 2, 8e6, 3.0, came_to_s={operation: (1.5, 1.0)})
        for number in range(3)
    )
    CoverageFile(file).keep(Coverage({"s1": tuple(places), "s2": ()}), GeoPosition(39.36, 22.95))
    return file.read_bytes()


# --- all of them --------------------------------------------------------------------------------------------


def _packed(*messages: msgspec.Struct) -> tuple[bytes, ...]:
    return tuple(map(msgspec.msgpack.encode, messages))


def _bytes_of(*files: str) -> tuple[bytes, ...]:
    return tuple((ROOT / file).read_bytes() for file in files)


# --- of cameras and simulations: the files that other programs wrote ----------------------------------------

_TYPES = get_typestore(Stores.ROS2_HUMBLE)


def _images(file: Path) -> object:
    """The bag in the file's folder as a camera, for two photos."""

    async def take() -> None:
        camera = BagCamera(file.parent, None, photo_s=0.0, lens=None)
        for _ in range(2):
            with contextlib.suppress(CameraError):
                await camera.take_photo(Position(0.0, 0.0))

    return asyncio.run(take())


def _bag(name: str, plugin: StoragePlugin) -> Path:
    """A bag of three images in a folder."""
    folder = _folder() / name
    shutil.rmtree(folder, ignore_errors=True)
    kinds = _TYPES.types
    with Writer(folder, version=8, storage_plugin=plugin) as bag:
        topic = bag.add_connection("/image", "sensor_msgs/msg/Image", typestore=_TYPES)
        for second in range(3):
            stamp = kinds["builtin_interfaces/msg/Time"](sec=second, nanosec=0)
            head = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
            image = kinds["sensor_msgs/msg/Image"](
                head, 4, 4, encoding="bgr8", is_bigendian=0, step=12, data=np.zeros(48, np.uint8)
            )
            raw = _TYPES.serialize_cdr(image, "sensor_msgs/msg/Image")
            bag.write(topic, second * 10**9, raw)
    return folder


def _bag_decoder(bag: str, plugin: StoragePlugin, file: str) -> Decoder:
    """Of that file of a bag, whose other file is whole."""
    whole = (_bag(bag, plugin) / file).read_bytes()
    slow = 10.0  # rosbags reads YAML in Python
    return Decoder(_as_file(f"{bag}/{file}", _images), (UsageError,), (whole,), most_s=slow, tests=50)


def _image(data: bytes) -> None:
    """As a CompressedImage, and as Images of each encoding whose sizes the data itself names."""
    pixels = np.frombuffer(data, np.uint8)
    with contextlib.suppress(CameraError):
        jpeg_of_message("/image", SimpleNamespace(data=pixels, format="jpeg"))
    high, wide, step, end = (*data[:4], *bytes(4))[:4]
    for encoding in (*ENCODINGS, "unknown"):
        image = SimpleNamespace(
            encoding=encoding, height=high, width=wide, step=step, is_bigendian=end % 2, data=pixels
        )
        with contextlib.suppress(CameraError):
            jpeg_of_message("/image", image)


_CALIBRATION = b"""image_width: 640
image_height: 480
distortion_model: plumb_bob
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]}
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.0, 0.0, 0.0]}
"""


def _terrain(file: Path) -> None:
    with contextlib.closing(Terrain(file, GeoPosition(39.5, 22.5))) as terrain:
        assert math.isfinite(terrain.ground(Position(100.0, 50.0, 30.0)).altitude_m)


def _grid() -> bytes:
    import rasterio
    from rasterio.transform import from_origin

    file = _folder() / "grid.tif"
    form = {
        "driver": "GTiff",
        "width": 16,
        "height": 16,
        "count": 1,
        "dtype": "float32",
        "compress": "deflate",
    }
    with rasterio.open(
        file, "w", crs="EPSG:4326", transform=from_origin(22.0, 40.0, 0.0625, 0.0625), **form
    ) as grid:
        grid.write(np.arange(256, dtype=np.float32).reshape(16, 16), 1)
    return file.read_bytes()


def _film() -> bytes:
    import cv2

    file = _folder() / "film.avi"
    film = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for number in range(4):
        film.write(np.full((48, 64, 3), 60 * number, np.uint8))
    film.release()
    return file.read_bytes()


def _traces(file: Path) -> None:
    for read in (
        read_service_times,
        read_goodput_trace,
        partial(read_track, frame=None),
        read_wind,
        read_battery,
    ):
        with contextlib.suppress(UsageError):
            read(file)


def _demands(file: Path) -> None:
    """Reads the map, and does with it what a flight does."""
    kept, home = DemandFile(file), GeoPosition(39.4, 22.9)
    known = DemandMap(kept.places(home), near_m=20.0)
    assert known.chance(Position(0.0, 0.0), 0.5) >= 0
    kept.keep(known, home)


def _demand_map() -> bytes:
    file = _folder() / "valid demands"
    for north_deg in (39.36, 52.5):
        known = DemandMap((), near_m=20.0)
        known.note(Position(30.0, 40.0), demanded=True)
        DemandFile(file).keep(known, GeoPosition(north_deg, 22.95))
    return file.read_bytes()


def _kept_time(file: Path) -> object:
    key = file.with_name("key")
    key.write_bytes(b"0f" * 32)
    key.chmod(0o600)
    return read_signing(key)


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
        "arrays of a call": Decoder(
            _COUNT.key_of,
            (msgspec.MsgspecError,),
            (_COUNT.encode((np.zeros((4, 3), np.float32),), {})[1],),
        ),
        "frames of a program": Decoder(
            _answers_of_a_program,
            (),
            (
                frame(ProgramAnswer(1, msgspec.Raw(msgspec.msgpack.encode([1, {"a": 2.5}])))),
                msgspec.msgpack.encode(ProgramAnswer(2, fault=ServiceFault("builtins:ValueError", "no"))),
            ),
        ),
        "frames of HTTP/2": Decoder(
            lambda data: FrameCounter().count(data),
            (),
            (PREFACE + b"\0\0\4\1\5\0\0\0\1abcd" + b"\0\0\0\3\0\0\0\0\1",),
        ),
        "replies of a service": Decoder(
            _PROCESS.decode,
            (GarbledReply,),
            (msgspec.msgpack.encode({"value": []}),),
        ),
        "reports of an instance": Decoder(
            from_instance.decode,
            (ValueError, RecursionError),
            tuple(line(each) for each in (Ready(":1"), Called("drone"), Printed(b"x"), ServiceEnded(1))),
        ),
        "messages of a vehicle": Decoder(
            lambda data: _messages_of_a_vehicle(_with_right_checksums(data)),
            (),
            (_said_by_a_vehicle(),),
            tests=15,
        ),
        "files over MAVLink": Decoder(read_packet, (), (Packet(1, 2, Opcode.ACK, 7, 3, b"data").payload(),)),
        "a drone's configuration": Decoder(
            _as_file("drone.toml", read_drone_config),
            (UsageError,),
            _bytes_of(
                "scenarios/demonstration.toml",
                *(f"tests/config/{name}.toml" for name in ("full", "several", "fleet")),
            ),
        ),
        "a daemon's configuration": Decoder(
            _as_file("server.toml", read_daemon_config), (UsageError,), _bytes_of("tests/config/daemon.toml")
        ),
        "a plan": Decoder(
            _as_file("field.plan", read_plan),
            (UsageError,),
            _bytes_of("tests/plans/field.plan", "tests/plans/field.waypoints", "tests/plans/survey.plan"),
        ),
        "a coverage map": Decoder(_as_file("map.json", _coverage), (UsageError,), (_map(),)),
        "a map of demands": Decoder(_as_file("demands.json", _demands), (UsageError,), (_demand_map(),)),
        "a bag (MCAP)": _bag_decoder("images", StoragePlugin.MCAP, "images.mcap"),
        "a bag (SQLite)": _bag_decoder("rows", StoragePlugin.SQLITE3, "rows.db3"),
        "a bag's description": _bag_decoder("described", StoragePlugin.MCAP, "metadata.yaml"),
        "an image of ROS": Decoder(_image, (), (_photo(), _photo(".png"), bytes((4, 4, 12, 0, *range(48))))),
        "a calibration": Decoder(
            _as_file("lens.yaml", read_calibration),
            (UsageError,),
            (_CALIBRATION, b"%YAML:1.0\n---\n" + _CALIBRATION),
        ),
        "a terrain": Decoder(_as_file("terrain.tif", _terrain), (UsageError,), (_grid(),), tests=30),
        "a film": Decoder(
            _as_file("shown.avi", partial(read_frames, most=2)), (CameraError,), (_film(),), tests=10
        ),
        "a photo's file": Decoder(
            _as_file("photo.png", read_photo_file), (CameraError,), (_photo(".png"), _photo())
        ),
        "a trace": Decoder(
            _as_file("trace.csv", _traces),
            (),
            (
                b"operation,seconds\ndetector.process_photo[heavy],0.1\n",
                b"t_s,east_m,north_m,altitude_m\n0,0,0,0\n1,1,2,5\n2,3,4,5\n",
                b"# of a flight\nt_s,percent\n0,100\n10,99.5\n",
                b"t_s,east_m_s,north_m_s\n0,1,-1\n",
                b"east_m,north_m,bit_s\n0,0,1e6\n",
            ),
        ),
        "an event log": Decoder(
            _as_file("events.jsonl", lambda file: read_result(event_log.read(file))),
            (UsageError,),
            (b'{"t":0.5,"event":"armed"}\n', _log_of_every_kind()),
        ),
        "reviews of findings": Decoder(
            _as_file("events.review.jsonl", _reviews),
            (),
            (
                b'{"time":"2026-05-01T12:00:00Z","finding":{"t_s":5.0,"message":0,"index":1},"verdict":"rejected"}\n'
                b'{"time":"2026-05-01T12:00:01+02:00","finding":{"t_s":5.0,"message":0,"index":1},"verdict":"open",'
                b'"label":"weed","note":"by the pole","reviewer":"anna"}\n',
            ),
        ),
        "a goodput table": Decoder(
            _as_file("goodput.csv", _goodput), (UsageError,), (b"distance_m,goodput_mbit_s\n10,11.5\n20,9\n",)
        ),
        "certificates and keys": Decoder(
            _as_file("one.pem", _credentials),
            (),
            tuple((keys / name).read_bytes() for name in ("authority.pem", "drone.pem", "drone.key")),
        ),
        "revoked certificates": Decoder(
            _as_file("revoked", read_revoked), (CredentialsError,), (b"# of 2026\n" + b"0f" * 32 + b" d1\n",)
        ),
        "the time of a signing key": Decoder(
            _as_file("key.time", _kept_time), (CredentialsError,), (b"1234567\n",)
        ),
        "a signing key": Decoder(
            _as_secret("signing", read_key), (CredentialsError,), (b"0f" * 32 + b"\n", bytes(range(32)))
        ),
        "a Darknet cfg": Decoder(
            _cfg, (UsageError,), (_SMALL_CFG, *_bytes_of("src/upwash/services/models/solar_park.cfg"))
        ),
        "Darknet weights": Decoder(_as_file("model.weights", _weights), (UsageError,), (_small_weights(),)),
        "an ONNX model": Decoder(_as_file("whole.onnx", _model), (UsageError,), (model_with(_HEADS),)),
        "an ONNX model that detects": Decoder(
            _as_file("boxes.onnx", _detect), (UsageError,), (model_that_detects(),)
        ),
        "an ONNX model's metadata": Decoder(_metadata, (UsageError,), (_HEADS.encode(),)),
        "an ONNX model's names": Decoder(
            lambda data: parse_names(data.decode(errors="replace")),
            (ValueError,),
            (b"""{0: 'person', 1: "farmer's car"}""", b"['a', 'b\\\\n']"),
        ),
        "a photo": Decoder(
            partial(read_photo, side_px=320),
            (NotAPhoto,),
            (_photo(), _photo(progressive=True), _photo(".png")),
            most_bytes=10**9,
        ),
        "a photo's EXIF": Decoder(
            lambda photo: own_place(
                with_pose(with_place(unturned(photo), _SHOT), (1.0, 2.0, 3.0), (1.0, 1.0))
            ),
            (),
            (_photo(), with_place(_photo(), _SHOT), _exif_of_a_camera()),
        ),
    }

"""The detector: local and remote alike, whatever photo and whatever model it gets. Its network here is random."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from tests.doors import certified_processes, reached
from tests.services.darknet_models import (
    NET,
    UPSAMPLE,
    conv,
    route,
    small,
    write_labels,
    write_model,
    yolov3,
    yolov3_tiny,
)

from upwash.config.daemon import read_daemon_config
from upwash.errors import ConfigError, InstanceError, ModelError, UsageError
from upwash.missions.bundled import load_services
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.runtime import ProcessRuntime
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import Credentials, fingerprint
from upwash.rpc.protocol import service_path
from upwash.rpc.service import spec_of
from upwash.rpc.settings import construct, plain
from upwash.services import Detection, Detector, Mode, ModelFiles, NotAPhoto, Shrink
from upwash.services.darknet.conversion import converted
from upwash.services.darknet.heads import HEADS_METADATA, Head, decode_heads
from upwash.services.inference import Engine, open_inference
from upwash.services.solar_park import TrueBox, render_photo

ENGINES: tuple[Engine, ...] = ("onnxruntime", "ncnn")
MODES: tuple[Mode, ...] = ("light", "heavy")
MAX_MESSAGE_BYTES = 16 * 2**20
CONFIDENCE = 0.3
PROGRAM = "upwash.services:Detector"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ModelFiles:
    folder = tmp_path_factory.mktemp("model")
    cfg, weights = write_model(folder, small())
    return ModelFiles(cfg=cfg, weights=weights, names=write_labels(folder, 2))


@pytest.fixture(scope="module")
def detector(model: ModelFiles) -> Detector:
    return Detector(model=model)


@pytest.fixture(scope="module")
def photo() -> bytes:
    """Nothing in particular: soft blots, and noise, on 1440 x 1080 pixels."""
    rng = np.random.default_rng(5)
    blots = cv2.resize(
        rng.integers(0, 256, (27, 36, 3), np.uint8), (1440, 1080), interpolation=cv2.INTER_CUBIC
    )
    noisy = cv2.add(blots, rng.integers(0, 30, blots.shape, np.uint8))
    return cv2.imencode(".jpg", noisy)[1].tobytes()


# --- what it returns ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_detections_lie_on_the_photo_surest_first(detector: Detector, photo: bytes, mode: Mode) -> None:
    found = detector.process_photo(photo, mode, CONFIDENCE)
    assert 10 < len(found) <= 1000
    assert found == sorted(found, key=lambda each: -each.score)
    assert {each.label for each in found} <= {"thing 0", "thing 1"}
    for each in found:
        assert CONFIDENCE < each.score <= 1
        assert 0 <= each.left_px < each.left_px + each.width_px <= 1440.001
        assert 0 <= each.top_px < each.top_px + each.height_px <= 1080.001


@pytest.mark.parametrize(("mode", "of_the_other"), [("light", "heavy"), ("heavy", "light")])
def test_the_modes_look_at_pictures_of_two_sizes(
    model: ModelFiles, detector: Detector, photo: bytes, mode: Mode, of_the_other: Mode
) -> None:
    other = Detector(model=model, threads=1, light_px=608, heavy_px=320)
    found = labels_and_places(detector.process_photo(photo, mode, CONFIDENCE))
    assert found == labels_and_places(other.process_photo(photo, of_the_other, CONFIDENCE))
    assert found != labels_and_places(detector.process_photo(photo, of_the_other, CONFIDENCE))


def labels_and_places(found: list[Detection]) -> set[tuple[str, int, int]]:
    """What one thread and several agree on: they add up in another order."""
    return {(each.label, round(each.left_px), round(each.top_px)) for each in found if each.score > 0.31}


def test_a_network_that_takes_squares_alone_is_given_squares(
    model: ModelFiles, photo: bytes, tmp_path: Path
) -> None:
    files = ModelFiles(onnx=edited(model, tmp_path, fix_cells), names=model.names)
    assert open_inference(files, threads=1, provider="cpu", engine="onnxruntime").cell_px(608) is None
    found = Detector(model=files, light_px=608).process_photo(photo, "light", CONFIDENCE)
    assert len(found) > 10


@pytest.mark.parametrize("turned", [False, True])
def test_photos_are_looked_at_in_pictures_of_their_shape(model: ModelFiles, turned: bool) -> None:
    inference = open_inference(model, threads=1, provider="cpu", engine="onnxruntime")
    cell_px = inference.cell_px(320)
    assert cell_px == 16
    sides = (320, 240) if turned else (240, 320)
    outputs = inference.run(np.zeros((1, 3, *sides), np.float32))
    assert [output.shape[2:] for output in outputs] == [
        tuple(side // head.stride for side in sides) for head in inference.heads
    ]


def test_a_network_with_a_coarser_layer_inside_is_given_squares(tmp_path: Path) -> None:
    files = coarser_inside(tmp_path)
    inference = open_inference(files, threads=1, provider="cpu", engine="onnxruntime")
    inference.require_side(320)
    assert inference.cell_px(320) is None
    Detector(model=files)


def coarser_inside(folder: Path) -> ModelFiles:
    """A network whose head has a stride of 16, and which has cells of 32 before it."""
    parts = [NET, *[conv(8, 3, 2)] * 5, UPSAMPLE, route(-1, 3), conv(14, 1)]
    parts.append("[yolo]\nanchors=12,12, 30,20\nclasses=2\nnum=2\n")
    cfg, weights = write_model(folder, "".join(parts))
    return ModelFiles(cfg=cfg, weights=weights, names=write_labels(folder, 2))


def test_confidence_thins_out_and_nothing_else(detector: Detector, photo: bytes) -> None:
    everything = detector.process_photo(photo, "light", 0.0)
    assert len(everything) > 100
    some = detector.process_photo(photo, "light", 0.33)
    assert some == [each for each in everything if each.score > 0.33]


@pytest.mark.parametrize("confidence", [-0.1, 1.1, float("nan")])
def test_a_confidence_that_is_none_is_refused(detector: Detector, photo: bytes, confidence: float) -> None:
    with pytest.raises(ValueError, match="give a number from 0 to 1"):
        detector.process_photo(photo, "light", confidence)


def test_detections_travel() -> None:
    found = Detection(label="hot-spot", score=0.9, left_px=1, top_px=2, width_px=3, height_px=4)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode([found]), type=list[Detection]) == [found]


# --- from an instance ---------------------------------------------------------------------------------------

Call = Callable[..., Awaitable[list[Detection]]]
Runtimes = Callable[[], AbstractAsyncContextManager[ProcessRuntime]]


def program(**settings: Any) -> Program:
    """The detector with these settings, as a configuration would have it run."""
    kind = spec_of(Detector).settings
    return Program(PROGRAM, plain(kind(**settings)))


@asynccontextmanager
async def running(what: Program, runtimes: Runtimes, dialer: GrpcDialer, drone: str) -> AsyncIterator[Call]:
    """Starts the detector in a process of its own; yields how it is called."""
    method = spec_of(Detector).methods["process_photo"]
    async with runtimes() as runtime:
        instance = await runtime.start(InstanceSpec("s1", "detector", what), called=lambda _: None)
        link = dialer.dial(reached(instance.endpoint), server="s1")

        async def call(*arguments: object) -> list[Detection]:
            path, (_, request) = service_path("detector", "process_photo"), method.encode(arguments, {})
            reply = await link.request(path, request, timeout_s=60.0)
            return method.result(method.decode(reply))  # type: ignore[return-value]

        try:
            await instance.admit(frozenset({drone}))
            yield call
        finally:
            await link.close()
            await instance.stop()


@pytest.fixture(params=["unix socket", "TLS"])
def way(
    request: pytest.FixtureRequest, tmp_path: Path, credentials: Callable[[str], Credentials]
) -> tuple[Runtimes, GrpcDialer, str]:
    """How an instance is started, called, and told of the drone: as on the drone, and as on a server."""
    if request.param == "TLS":
        return (
            lambda: certified_processes(credentials("s1"), max_message_bytes=MAX_MESSAGE_BYTES),
            GrpcDialer("heron", credentials("heron"), max_message_bytes=MAX_MESSAGE_BYTES),
            fingerprint(credentials("heron").certificate),
        )
    return (
        lambda: nullcontext(
            ProcessRuntime(lambda _: f"unix:{tmp_path}/socket", max_message_bytes=MAX_MESSAGE_BYTES)
        ),
        GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES),
        "heron",
    )


async def test_an_instance_finds_exactly_what_the_object_finds_and_lives_through_wrong_files(
    model: ModelFiles, photo: bytes, way: tuple[Runtimes, GrpcDialer, str]
) -> None:
    detector = Detector(model=model, threads=2)
    giant = cv2.imencode(".jpg", np.zeros((11_000, 11_000), np.uint8))[1].tobytes()
    png = cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes()[:-9]
    wrong = {
        "empty": b"",
        "cut png": png,
        "truncated": photo[: len(photo) // 2],
        "giant": giant,
        "text": b"a photo",
    }

    async with running(program(model=model, threads=2), *way) as call:
        for mode in MODES:
            here = detector.process_photo(photo, mode, CONFIDENCE)
            assert await call(photo, mode, CONFIDENCE) == here
            assert len(here) > 10
        for name, each in wrong.items():
            with pytest.raises(NotAPhoto) as there:
                await call(each, "heavy")
            with pytest.raises(NotAPhoto) as local:
                detector.process_photo(each, "heavy")
            assert str(there.value) == str(local.value), name
        assert await call(photo, "light", CONFIDENCE) == detector.process_photo(photo, "light", CONFIDENCE)


async def test_an_instance_whose_model_is_damaged_does_not_start_and_says_where(
    model: ModelFiles, tmp_path: Path, way: tuple[Runtimes, GrpcDialer, str]
) -> None:
    assert model.weights is not None
    cut = tmp_path / "cut.weights"
    cut.write_bytes(model.weights.read_bytes()[:-1])
    what = program(model=msgspec.structs.replace(model, weights=cut))

    said = r"did not start: .*cut\.weights: layer 18, .* offset \d+: the file ends"
    with pytest.raises(InstanceError, match=said):
        async with running(what, *way):
            pytest.fail("it started")


# --- engines ------------------------------------------------------------------------------------------------


OTHER_LAYERS = [
    ("activation=leaky", "activation=relu"),
    ("activation=leaky", "activation=logistic"),
    ("filters=16\nsize=3\nstride=1\npad=1", "filters=16\nsize=3\nstride=1\npad=1\ngroups=8"),
    ("from=-3\nactivation=linear", "from=-3\nactivation=leaky"),
    ("from=-3\nactivation=linear", "from=-3\nactivation=relu"),
    ("from=-3\nactivation=linear", "from=-3\nactivation=logistic"),
]


@pytest.mark.parametrize(
    "network",
    [
        small(),
        yolov3_tiny(),
        yolov3(spp=True, divisor=16),
        *[small().replace(*change, 1) for change in OTHER_LAYERS],
    ],
)
def test_ncnn_computes_what_onnxruntime_computes(network: str, tmp_path: Path) -> None:
    pytest.importorskip("ncnn")
    classes = 80 if "classes=80" in network else 2
    cfg, weights = write_model(tmp_path, network)
    files = ModelFiles(cfg=cfg, weights=weights, names=write_labels(tmp_path, classes))
    pair = [open_inference(files, threads=2, provider="cpu", engine=engine) for engine in ENGINES]
    for each in pair:
        each.require_side(320)
    for sides in (320, 320), (256, 320), (320, 32):
        picture = np.random.default_rng(3).random((1, 3, *sides), np.float32)
        for onnx_output, ncnn_output in zip(*[each.run(picture) for each in pair], strict=True):
            np.testing.assert_allclose(ncnn_output, onnx_output, rtol=1e-3, atol=1e-3)


def test_ncnn_finds_what_onnxruntime_finds(model: ModelFiles, detector: Detector, photo: bytes) -> None:
    pytest.importorskip("ncnn")
    found = Detector(model=model, engine="ncnn", threads=1).process_photo(photo, "heavy", CONFIDENCE)
    assert labels_and_places(found) == labels_and_places(detector.process_photo(photo, "heavy", CONFIDENCE))


def test_ncnn_needs_whole_cells_of_every_layer(tmp_path: Path) -> None:
    pytest.importorskip("ncnn")
    with pytest.raises(UsageError, match="a picture of 336 pixels is not whole cells of 32"):
        Detector(model=coarser_inside(tmp_path), engine="ncnn", light_px=336)
    Detector(model=coarser_inside(tmp_path), engine="ncnn")


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"model": ModelFiles(onnx=Path("a.onnx"), names=Path("a.names"))}, "runs Darknet models"),
        ({"provider": "cuda"}, "computes on the processor"),
    ],
)
def test_what_ncnn_cannot_run_is_refused(settings: dict[str, Any], problem: str) -> None:
    pytest.importorskip("ncnn")
    with pytest.raises(UsageError, match=problem):
        Detector(engine="ncnn", **settings)


def test_an_engine_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("upwash.services.detector.find_spec", lambda name: None if name == "ncnn" else True)
    with pytest.raises(UsageError, match=r"ncnn is not installed: `pip install 'upwash\[ncnn\]'`"):
        Detector(engine="ncnn")


# --- models -------------------------------------------------------------------------------------------------


def test_a_ready_made_model_finds_what_the_darknet_model_finds(
    model: ModelFiles, detector: Detector, photo: bytes
) -> None:
    assert model.cfg is not None
    assert model.weights is not None
    with converted(model.cfg, model.weights) as file:
        ready = Detector(model=ModelFiles(onnx=file, names=model.names))
    assert ready.process_photo(photo, "heavy") == detector.process_photo(photo, "heavy")


def test_boxes_with_a_description_of_raw_heads_are_refused(model: ModelFiles, tmp_path: Path) -> None:
    picture = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 64, 64])
    cells = helper.make_tensor("cells", TensorProto.FLOAT, [1, 6, 64], [0.0] * 384)
    output = helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 6, 64])
    node = helper.make_node("Identity", ["cells"], ["output0"])
    graph = helper.make_graph([node], "decoded", [picture], [output], [cells])
    file = tmp_path / "v8.onnx"
    opset = helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, ir_version=8, opset_imports=[opset]), file)
    heads = (Head(output="output0", stride=8, anchors=((1.0, 1.0),)),)
    said = r"its outputs are boxes \(output0: 1 x 6 x 64\), which have no anchors: leave heads out"
    with pytest.raises(ModelError, match=said):
        Detector(model=ModelFiles(onnx=file, names=model.names, heads=heads))


def test_what_the_heads_of_a_model_mean_may_be_told_instead(
    model: ModelFiles, detector: Detector, photo: bytes, tmp_path: Path
) -> None:
    bare = edited(model, tmp_path, lambda found: found.ClearField("metadata_props"))
    with pytest.raises(
        ModelError, match=r"its outputs are not understood .* if the setting heads describes them"
    ):
        Detector(model=ModelFiles(onnx=bare, names=model.names))
    told = Detector(model=ModelFiles(onnx=bare, names=model.names, heads=heads_of(model)))
    assert told.process_photo(photo, "heavy") == detector.process_photo(photo, "heavy")


def edited(model: ModelFiles, folder: Path, edit: Callable[[Any], None]) -> Path:
    """The model as one ONNX file, with something done to it."""
    assert model.cfg is not None
    assert model.weights is not None
    with converted(model.cfg, model.weights) as file:
        found = onnx.load(file)
    edit(found)
    onnx.save(found, folder / "edited.onnx")
    return folder / "edited.onnx"


def heads_of(model: ModelFiles) -> tuple[Head, ...]:
    assert model.cfg is not None
    assert model.weights is not None
    with converted(model.cfg, model.weights) as file:
        (metadata,) = onnx.load(file, load_external_data=False).metadata_props
    assert metadata.key == HEADS_METADATA
    return decode_heads(metadata.value)


def fix_input(model: Any) -> None:
    for dimension in model.graph.input[0].type.tensor_type.shape.dim[2:]:
        dimension.dim_value = 608


def fix_cells(model: Any) -> None:
    """As an export for one size does, which flattens its outputs."""
    (first, _) = (output.name for output in model.graph.output)
    (node,) = (each for each in model.graph.node if each.output[0] == first)
    node.output[0] = "raw"
    shape = helper.make_tensor("shape", TensorProto.INT64, [4], [1, 14, 38, 38])
    model.graph.initializer.append(shape)
    model.graph.node.append(helper.make_node("Reshape", ["raw", "shape"], [first]))


def garble_metadata(model: Any) -> None:
    model.metadata_props[0].value = "[3]"


@pytest.mark.parametrize(
    ("edit", "problem"),
    [
        (fix_input, r"it takes only pictures of 608 x 608, not 320"),
        (fix_cells, r"it cannot be run on a picture of 320 \("),
        (garble_metadata, r"its metadata upwash\.heads cannot be read"),
    ],
)
def test_an_onnx_model_that_does_not_fit_is_refused(
    model: ModelFiles, tmp_path: Path, edit: Callable[[Any], None], problem: str
) -> None:
    with pytest.raises(ModelError, match=rf"edited\.onnx: {problem}"):
        Detector(model=ModelFiles(onnx=edited(model, tmp_path, edit), names=model.names), light_px=320)


@pytest.mark.parametrize(
    ("changed", "error", "problem"),
    [
        ({"output": "head3"}, ModelError, r"no output head3; its outputs are head12, head19"),
        (
            {"stride": 32},
            ModelError,
            r"head12 is 1 x 14 x 20 x 20 for a picture of 320, not 1 x 14 x 10 x 10",
        ),
        (
            {"anchors": ((1.0, 2.0),)},
            ModelError,
            r"not 1 x 7 x 20 x 20, as 1 anchor, 2 names and stride 16 say",
        ),
        ({"stride": 33}, UsageError, r"a picture of 320 pixels is not whole cells of 33: give a multiple"),
    ],
)
def test_heads_that_do_not_fit_their_model_are_refused(
    model: ModelFiles, tmp_path: Path, changed: dict[str, Any], error: type[Exception], problem: str
) -> None:
    first, second = heads_of(model)
    wrong = (msgspec.structs.replace(first, **changed), second)
    file = edited(model, tmp_path, lambda _: None)
    with pytest.raises(error, match=problem):
        Detector(model=ModelFiles(onnx=file, names=model.names, heads=wrong))


def test_a_model_that_takes_no_pictures_is_refused(tmp_path: Path) -> None:
    graph = helper.make_graph(
        [helper.make_node("Identity", ["x"], ["y"])],
        "other",
        [helper.make_tensor_value_info("x", TensorProto.INT64, [3])],
        [helper.make_tensor_value_info("y", TensorProto.INT64, [3])],
    )
    file = tmp_path / "model.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), file)
    heads = (Head(output="y", stride=8, anchors=((1.0, 1.0),)),)
    problem = r"its inputs are tensor\(int64\) \[3\]: one of float 1 x 3 x height x width is needed, of 32 or 16 bits"
    with pytest.raises(ModelError, match=problem):
        Detector(model=ModelFiles(onnx=file, names=write_labels(tmp_path, 2), heads=heads))


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, r"cannot be read \(No such file"),
        (b"", "expected the name of a class in every line"),
        (b"one\n\nthree\n", "expected the name of a class in every line"),
        (b"\xff\xfe\x00", "byte 0: not text"),
        (b"one\n", "as 2 anchors, 1 name and stride 16 say"),
        (b"one\ntwo\nthree\n", "as 2 anchors, 3 names and stride 16 say"),
    ],
)
def test_names_that_do_not_fit_are_refused(
    model: ModelFiles, content: bytes | None, problem: str, tmp_path: Path
) -> None:
    names = tmp_path / "some.names"
    if content is not None:
        names.write_bytes(content)
    with pytest.raises(ModelError, match=problem):
        Detector(model=msgspec.structs.replace(model, names=names))


def test_a_names_file_may_have_been_written_on_another_system(model: ModelFiles, tmp_path: Path) -> None:
    names = tmp_path / "some.names"
    names.write_bytes("Löwe \r\ntwo\r\n\r\n".encode())
    Detector(model=msgspec.structs.replace(model, names=names))


@pytest.mark.parametrize(
    "files",
    [
        {"cfg": "a.cfg"},
        {"cfg": "a.cfg", "weights": "a.weights", "onnx": "a.onnx"},
        {},
        {
            "cfg": "a.cfg",
            "weights": "a.weights",
            "heads": [{"output": "y", "stride": 8, "anchors": [[1, 1]]}],
        },
    ],
)
def test_a_configuration_that_names_no_single_network_is_refused(
    files: dict[str, Any], tmp_path: Path
) -> None:
    text = ", ".join(f"{key} = {toml(value)}" for key, value in files.items())
    with pytest.raises(
        ConfigError, match=r"service\[0\]\.settings\.model: (no single network|heads are for onnx)"
    ):
        configured(tmp_path, f'model = {{ names = "a.names"{", " if files else ""}{text} }}')


def toml(value: object) -> str:
    match value:
        case dict():
            return "{ " + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + " }"
        case list():
            return "[" + ", ".join(map(toml, value)) + "]"
        case str():
            return f'"{value}"'
    return str(value)


def configured(folder: Path, settings: str) -> Program:
    """The detector as a daemon's configuration has it run."""
    file = folder / "server.toml"
    file.write_text(
        'listen = "127.0.0.1:0"\nallow_without_certificates = true\n'
        f'[[server]]\nname = "s1"\n[[service]]\nname = "detector"\n[service.settings]\n{settings}\n'
    )
    return load_services(read_daemon_config(file).images)["detector"].program


def test_a_configuration_gives_everything(model: ModelFiles, tmp_path: Path, photo: bytes) -> None:
    cfg, weights = write_model(tmp_path, yolov3_tiny())
    write_labels(tmp_path, 80)
    what = configured(
        tmp_path,
        f'model = {{ cfg = "{cfg.name}", weights = "{weights.name}", names = "model.names" }}\n'
        'threads = 1\nprovider = "cpu"\nlight_px = 96\nheavy_px = 128\n'
        'tiles = "auto"\nmax_photo_mpixels = 50\n',
    )
    made = construct(Detector, spec_of(Detector).settings, what.settings)
    assert made.process_photo(photo, "light", 0.4)[0].label.startswith("thing ")


@pytest.mark.parametrize(
    ("settings", "key", "problem"),
    [
        ("threads = 0", "threads", "an integer from 1 to 1024, found 0"),
        ('provider = "tpu"', "provider", 'expected one of "auto", "cpu", "cuda", found "tpu"'),
        ("light_px = 31", "light_px", "an integer from 32 to 4096, in pixels, found 31"),
        ("tiles = 31", "tiles", '"off", "auto" or an integer from 32 to 4096, in pixels, found 31'),
        ('tiles = "on"', "tiles", '"off", "auto" or an integer from 32 to 4096, in pixels, found "on"'),
        ("max_photo_mpixels = 0", "max_photo_mpixels", "an integer from 1 to 1000, in megapixels, found 0"),
        ("confidence = 0.5", "confidence", 'unknown key "confidence"'),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings: str, key: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refusal:
        configured(tmp_path, settings)
    assert refusal.value.key == f"service[0].settings.{key}"
    assert problem in refusal.value.problem


def test_a_size_that_the_network_cannot_take_is_refused(model: ModelFiles) -> None:
    with pytest.raises(UsageError, match="a picture of 330 pixels is not whole cells of 16"):
        Detector(model=model, light_px=330)


def test_a_provider_that_is_not_installed_says_what_to_install(model: ModelFiles) -> None:
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("onnxruntime-gpu is installed")
    with pytest.raises(
        UsageError, match=r'provider = "cuda" is not in the onnxruntime .*upwash\[detector-gpu\]'
    ):
        Detector(model=model, provider="cuda")


# --- the bundled model --------------------------------------------------------------------------------------


def test_the_bundled_model_finds_most_of_what_is_on_rendered_photos() -> None:
    """How well it does is measured elsewhere, on many more: docs/detector.md."""
    detector = Detector()
    photos = [render_photo(seed) for seed in range(7000, 7006)]
    true = found = 0
    for photo in photos:
        detections = detector.process_photo(photo.jpeg, "heavy")
        true += len(photo.truth)
        found += sum(any(is_hit(detection, fault) for detection in detections) for fault in photo.truth)
    assert true > 10
    assert found >= 0.8 * true


def is_hit(found: Detection, true: TrueBox) -> bool:
    x_px = found.left_px + found.width_px / 2 - true.left_px
    y_px = found.top_px + found.height_px / 2 - true.top_px
    return found.label == true.label and 0 <= x_px <= true.width_px and 0 <= y_px <= true.height_px


# --- what importing costs -----------------------------------------------------------------------------------


def test_importing_the_services_imports_nothing_heavy() -> None:
    heavy = {"cv2", "numpy", "onnx", "onnxruntime"}
    script = f"import sys, upwash.services; print(sorted({heavy} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout
    assert said == "[]\n"


@pytest.mark.parametrize("package", ["cv2", "onnx", "onnxruntime"])
def test_without_its_packages_the_detector_says_what_to_install(
    model: ModelFiles, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UsageError, match=r"pip install 'upwash\[detector\]'"):
        Detector(model=model)


def test_of_a_smaller_photo_the_boxes_are_in_pixels_of_the_whole_one() -> None:
    whole = render_photo(3).jpeg
    smaller = Shrink(px=720, quality=90).process_photo(whole)
    assert len(smaller) < len(whole) / 2
    found, again = (Detector().process_photo(each, confidence=0.5) for each in (whole, smaller))
    assert [box.label for box in again] == [box.label for box in found]
    for box, other in zip(found, again, strict=True):
        assert (box.left_px, box.top_px) == pytest.approx((other.left_px, other.top_px), abs=4.0)
        assert (box.width_px, box.height_px) == pytest.approx((other.width_px, other.height_px), abs=4.0)

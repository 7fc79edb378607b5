"""Darknet's models as ONNX: against OpenCV's own reading of the same files, and files that are none."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.services.darknet_models import (
    NET,
    UPSAMPLE,
    Floats,
    conv,
    opencv_heads,
    pool,
    route,
    small,
    weights_for_opencv,
    write_model,
    yolo,
    yolov3,
    yolov3_tiny,
)

from upwash.errors import ModelError
from upwash.services.darknet.conversion import cache_folder, converted
from upwash.services.darknet.graph import build_model
from upwash.services.darknet.layers import DarknetNetwork, read_network
from upwash.services.darknet.weights import WeightsFile
from upwash.services.detector import SOLAR_PARK

CFG = Path("some.cfg")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache_folder()


def our_heads(cfg: Path, weights: Path, picture: Floats) -> list[Floats]:
    with converted(cfg, weights) as file:
        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    outputs: list[Floats] = session.run(None, {session.get_inputs()[0].name: picture})
    return outputs


def random_picture(side_px: int) -> Floats:
    return np.random.default_rng(3).random((1, 3, side_px, side_px), np.float32)


# --- what it computes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cfg",
    [small(), yolov3_tiny(), yolov3(divisor=4), yolov3(spp=True, divisor=4)],
    ids=["small", "tiny", "yolov3, a quarter of its filters", "spp, a quarter of its filters"],
)
def test_heads_are_those_of_an_independent_reader(cfg: str, tmp_path: Path) -> None:
    assert_same_heads(*write_model(tmp_path, cfg), sides_px=(64, 96))


def test_heads_of_the_bundled_network_are_those_of_an_independent_reader(tmp_path: Path) -> None:
    cfg, weights = SOLAR_PARK.cfg, SOLAR_PARK.weights
    assert cfg is not None
    assert weights is not None
    theirs = weights_for_opencv(cfg, weights, tmp_path)
    assert_same_heads(cfg, weights, sides_px=(320, 608), opencv_weights=theirs)


@pytest.mark.system
def test_heads_of_the_whole_yolov3_are_those_of_an_independent_reader(tmp_path: Path) -> None:
    cfg, weights = write_model(tmp_path, yolov3())
    assert weights.stat().st_size == 248_007_048  # as published
    assert_same_heads(cfg, weights, sides_px=(96,))


def assert_same_heads(
    cfg: Path, weights: Path, *, sides_px: tuple[int, ...], opencv_weights: Path | None = None
) -> None:
    for side_px in sides_px:
        picture = random_picture(side_px)
        ours, theirs = our_heads(cfg, weights, picture), opencv_heads(cfg, opencv_weights or weights, picture)
        assert len(ours) == len(theirs) > 1
        for own, other in zip(ours, theirs, strict=True):
            assert 0.1 < other.std() < 100  # a network that says something
            np.testing.assert_allclose(own, other, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("activation=leaky", "activation=relu"),
        ("activation=leaky", "activation=logistic"),
        ("from=-3\nactivation=linear", "from=4\nactivation=leaky"),
        ("filters=16\nsize=3\nstride=1\npad=1", "filters=16\nsize=3\nstride=1\npadding=1"),
        ("filters=16\nsize=3\nstride=1\npad=1", "filters=16\nsize=3\nstride=1\npad=1\ngroups=8"),
        ("batch_normalize=1\n", ""),
        ("[maxpool]\nsize=2\nstride=1\n", "[maxpool]\nsize=3\nstride=1\npadding=2\n"),
        ("[maxpool]\nsize=2\nstride=2\n", "[maxpool]\nstride=2\n"),
    ],
)
def test_options_mean_what_they_mean_to_an_independent_reader(old: str, new: str, tmp_path: Path) -> None:
    assert old in small()
    cfg, weights = write_model(tmp_path, small().replace(old, new, 1))
    picture = random_picture(64)
    for own, other in zip(our_heads(cfg, weights, picture), opencv_heads(cfg, weights, picture), strict=True):
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("cfg", "layers", "weights_bytes"),
    [(yolov3(), 107, 248_007_048), (yolov3_tiny(), 24, 35_434_956), (yolov3(spp=True), 114, 252_209_544)],
    ids=["yolov3", "tiny", "spp"],
)
def test_the_published_networks_need_weights_of_the_published_sizes(
    cfg: str, layers: int, weights_bytes: int, tmp_path: Path
) -> None:
    network = read_network(CFG, cfg.encode())
    assert len(network.layers) == layers
    weights = tmp_path / "empty.weights"
    weights.write_bytes(header())
    with pytest.raises(ModelError, match=rf"the network {weights_bytes} in all"):
        WeightsFile(weights, network)


def test_weights_of_another_length_are_refused_before_they_are_read(tmp_path: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    os.truncate(weights, 10**12)
    with pytest.raises(ModelError, match="bytes are left after the last layer"), converted(cfg, weights):
        pass


def test_the_old_header_has_a_shorter_counter(tmp_path: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    picture = random_picture(64)
    expected = our_heads(cfg, weights, picture)
    old = tmp_path / "old.weights"
    old.write_bytes(np.array([0, 1, 0, 0], "<i4").tobytes() + weights.read_bytes()[20:])
    for own, other in zip(our_heads(cfg, old, picture), expected, strict=True):
        np.testing.assert_array_equal(own, other)


def test_of_an_option_that_stands_twice_darknet_reads_the_first() -> None:
    twice = (
        small()
        .replace("[net]\n", "[net]\nbatch=1\nbatch=64\n")
        .replace("filters=8\n", "filters=8\nfilters=9\n")
    )
    once, other = (read_network(CFG, text.encode()) for text in (small(), twice))
    assert [layer.operator for layer in other.layers] == [layer.operator for layer in once.layers]


# --- cfg files that are refused -----------------------------------------------------------------------------

LINEAR = "[convolutional]\nfilters=21\nactivation=linear\n"
HEAD = yolo((0, 1, 2), "1,2, 3,4, 5,6", 2)
ONE_CLASS = LINEAR.replace("21", "18") + HEAD.replace("classes=2", "classes=1")


@pytest.mark.parametrize(
    ("text", "where", "problem"),
    [
        ("", "", "does not begin with [net]"),
        ("[convolutional]", "", "does not begin with [net]"),
        ("width=3\n", "line 1", "expected [section] or option=value, found width=3"),
        ("[net]\nwidth\n", "line 2", "expected [section] or option=value, found width"),
        ("[net\n", "line 1", "not a section"),
        ("[net]\nchannels=1\n", "line 1 [net]", "channels=1: expected a whole number from 3 to 3"),
        (NET, "", "it has no [yolo] layer"),
        (
            NET + "[lstm]\n",
            "layer 0, line 6 [lstm]",
            "unknown layer type; supported are convolutional, maxpool",
        ),
        (NET + conv(8, 3) + "[dropout]\n", "layer 1, line 13 [dropout]", "unknown layer type"),
        (
            NET + conv(8, 3) + "dilation=2\n",
            "layer 0, line 6 [convolutional]",
            "unsupported option dilation=2",
        ),
        (
            NET + "[convolutional]\nactivation=mish\n",
            "layer 0",
            "activation=mish: expected one of linear, leaky",
        ),
        (NET + "[convolutional]\n", "layer 0", "activation is missing: expected one of linear, leaky"),
        (NET + "[convolutional]\nfilters=-1\n", "layer 0", "filters=-1: expected a whole number from 1"),
        (NET + "[convolutional]\nfilters=1e3\n", "layer 0", "filters=1e3: expected a whole number from 1"),
        (NET + "[convolutional]\nfilters=" + "9" * 5000, "layer 0", "filters=999"),
        (NET + "[convolutional]\nfilters=4\ngroups=3\nactivation=relu\n", "layer 0", "groups=3 divides"),
        (NET + "[convolutional]\nsize=3\nactivation=relu\n", "layer 0", "its output would not be"),
        (NET + (conv(8, 3, 2)) * 11, "layer 10", "more than 1024 times smaller"),
        (NET + UPSAMPLE, "layer 0", "its output would be finer than the input"),
        (NET + "[route]\n", "layer 0", "layers is missing: expected whole numbers"),
        (NET + route(-1), "layer 0", "layers names layer -1: no earlier layer has this number"),
        (NET + conv(8, 3) + route(1), "layer 1", "layers names layer 1: no earlier layer"),
        (NET + conv(8, 3) + pool(2, 2) + route(-1, -2), "layer 2", "layers 1, 0 differ in size"),
        (NET + conv(8, 3) + conv(4, 3) + "[shortcut]\nfrom=-2\n", "layer 2", "layers 0 and 1 differ in size"),
        (NET + conv(8, 3) + "[shortcut]\nfrom=-1,-1\n", "layer 1", "from names several layers"),
        (
            NET + conv(8, 3) + HEAD,
            "layer 1",
            "the layer before has 8 filters; 3 anchors and 2 classes need 21",
        ),
        (NET + LINEAR + HEAD.replace("num=3", "num=9"), "layer 1", "num does not fit its 3 anchors"),
        (NET + LINEAR + HEAD.replace("mask = 0,1,2", "mask = 3"), "layer 1", "other than 0 to 2"),
        (NET + LINEAR + HEAD.replace("5,6", "5,-6"), "layer 1", "anchors=1,2,3,4,5,-6: expected pairs"),
        (NET + LINEAR + HEAD.replace("5,6", "5"), "layer 1", "anchors=1,2,3,4,5: expected pairs"),
        (NET + LINEAR + HEAD + "scale_x_y=1.05\n", "layer 1", "unsupported option scale_x_y=1.05"),
        (NET + LINEAR + HEAD + conv(8, 3), "layer 2", "it follows a [yolo] layer"),
        (NET + LINEAR + HEAD + route(1), "layer 2", "names layer 1, a [yolo] layer"),
        (NET + LINEAR + HEAD + route(-2) + ONE_CLASS, "", "differ in classes"),
    ],
)
def test_a_cfg_that_cannot_be_computed_exactly_is_refused_with_its_layer(
    text: str, where: str, problem: str
) -> None:
    with pytest.raises(ModelError) as refusal:
        read_network(CFG, text.encode())
    assert refusal.value.where.startswith(where)
    assert problem in refusal.value.problem
    assert str(refusal.value).startswith("some.cfg: ")


def test_what_is_no_text_or_far_too_long_is_refused() -> None:
    with pytest.raises(ModelError, match=r"byte 5: not text: name the \.cfg"):
        read_network(CFG, b"[net]\xff\xfe")
    with pytest.raises(ModelError, match="too many for a cfg"):
        read_network(CFG, b"#" * 2_000_000)


def test_blanks_comments_and_training_options_change_nothing() -> None:
    plain = read_network(CFG, small().encode())
    written = (
        small().replace("=", " =\t").replace("[yolo]", "; a head\n[ yolo ]  # here\n\nlabel_smooth_eps=0.1")
    )
    assert [layer.operator for layer in read_network(CFG, written.encode()).layers] == [
        layer.operator for layer in plain.layers
    ]


LINES = [line for line in small().splitlines() if line]


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_a_mutilated_cfg_is_a_network_or_a_model_error(data: st.DataObject) -> None:
    lines = list(LINES)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "repeat", "swap", "value", "noise"])):
            case "drop":
                del lines[at]
            case "repeat":
                lines.insert(at, data.draw(st.sampled_from(LINES)))
            case "swap":
                lines[at], lines[0] = lines[0], lines[at]
            case "value":
                lines[at] = re.sub(r"=.*", f"={data.draw(st.integers(-9, 10**12))}", lines[at])
            case "noise":
                lines[at] = data.draw(st.text(max_size=20))
    try:
        network = read_network(CFG, "\n".join(lines).encode())
    except ModelError:
        return
    assert network.heads


@given(st.binary(max_size=200))
def test_any_bytes_are_a_network_or_a_model_error(content: bytes) -> None:
    with pytest.raises(ModelError):
        read_network(CFG, content)


# --- weights files that are refused -------------------------------------------------------------------------


def header(major: int = 0, minor: int = 2) -> bytes:
    return np.array([major, minor, 5], "<i4").tobytes() + bytes(8)


@pytest.fixture(scope="module")
def network() -> DarknetNetwork:
    return read_network(CFG, small().encode())


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_model(tmp_path_factory.mktemp("model"), small())[1].read_bytes()


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzzed")


@pytest.fixture
def refused(network: DarknetNetwork, tmp_path: Path) -> Callable[[bytes], ModelError]:
    """How a weights file of that content is refused."""

    def refuse(content: bytes) -> ModelError:
        file = tmp_path / "some.weights"
        file.write_bytes(content)
        with pytest.raises(ModelError) as refusal:
            list(WeightsFile(file, network).parameters())
        return refusal.value

    return refuse


@pytest.mark.parametrize(
    ("cut", "where", "problem"),
    [
        (0, "offset 0", "0 bytes hold no header"),
        (11, "offset 0", "11 bytes hold no header"),
        (12, "layer 0, line 6 [convolutional], offset 20", "the file ends at 12; the layer needs 992 bytes"),
        (1011, "layer 0, line 6 [convolutional], offset 20", "the file ends at 1011"),
        (1012, "layer 2, ", "the file ends at 1012"),
        (-1, "layer 18, ", "the network"),
    ],
)
def test_weights_that_are_cut_off_are_refused_with_layer_and_offset(
    cut: int, where: str, problem: str, content: bytes, refused: Callable[[bytes], ModelError]
) -> None:
    refusal = refused(content[:cut])
    assert refusal.where.startswith(where)
    assert problem in refusal.problem


def test_weights_of_another_network_are_refused(
    content: bytes, refused: Callable[[bytes], ModelError]
) -> None:
    refusal = refused(content + bytes(8))
    assert refusal.where == f"offset {len(content)}"
    assert "8 bytes are left after the last layer" in refusal.problem


def test_a_file_that_is_no_weights_file_is_refused(refused: Callable[[bytes], ModelError]) -> None:
    refusal = refused(b"\xff\xd8\xff\xe0" * 1000)
    assert refusal.where == "offset 0"
    assert "this is no Darknet weights file" in refusal.problem


@pytest.mark.parametrize(
    ("numbers", "where", "problem"),
    [
        ({20: np.nan}, "layer 0, line 6 [convolutional], offset 20", "nan is not a number to compute with"),
        ({1012: -np.inf}, "layer 2, line 16 [convolutional], offset 1012", "-inf is not a number"),
        ({20 + 4 * 27: -1.0}, "layer 0, line 6 [convolutional], offset 128", "a variance of -1"),
        # A large scale, and a variance of 0: the scale is all there is.
        (
            {20 + 4 * 9: 3e38, 20 + 4 * 25: 0.0},
            "layer 0, line 6 [convolutional], offset 20",
            "too large to compute with",
        ),
    ],
)
def test_numbers_that_nothing_can_be_computed_with_are_refused_where_they_stand(
    numbers: dict[int, float],
    where: str,
    problem: str,
    content: bytes,
    refused: Callable[[bytes], ModelError],
) -> None:
    damaged = bytearray(content)
    for at, number in numbers.items():
        damaged[at : at + 4] = np.array([number], "<f4").tobytes()
    refusal = refused(bytes(damaged))
    assert refusal.where == where
    assert problem in refusal.problem


@settings(deadline=None, max_examples=100)
@given(data=st.data())
def test_damaged_weights_are_weights_or_a_model_error(
    data: st.DataObject, content: bytes, network: DarknetNetwork, scratch: Path
) -> None:
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at : at + 4] = data.draw(st.binary(min_size=4, max_size=4))
    file = scratch / "fuzzed.weights"
    file.write_bytes(damaged[: data.draw(st.sampled_from([len(damaged), at, -1]))])
    try:
        found = list(WeightsFile(file, network).parameters())
    except ModelError:
        return
    for each in found:
        assert np.isfinite(each.weights).all()
        assert np.isfinite(each.biases).all()


# --- the cache ----------------------------------------------------------------------------------------------


def test_a_model_is_converted_once(tmp_path: Path, cache: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    with converted(cfg, weights) as first:
        made_ns = first.stat().st_mtime_ns
    with converted(cfg, weights) as second:
        assert second == first
        assert second.stat().st_mtime_ns == made_ns
    assert [each.name for each in cache.iterdir()] == [first.parent.name]
    assert not any(each.stat().st_mode & 0o077 for each in (cache, first.parent))


def test_other_content_is_another_model_whatever_its_name(tmp_path: Path, cache: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    with converted(cfg, weights) as first:
        pass
    write_model(tmp_path, small(), seed=2)
    with converted(cfg, weights) as second:
        assert second != first
    cfg.write_text(small().replace("activation=leaky", "activation=relu", 1))
    with converted(cfg, weights) as third:
        assert third not in (first, second)
    assert len(list(cache.iterdir())) == 3


def test_a_model_that_is_refused_leaves_nothing(tmp_path: Path, cache: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    damaged = bytearray(weights.read_bytes())
    damaged[-4:] = np.array([np.nan], "<f4").tobytes()
    weights.write_bytes(damaged)
    with pytest.raises(ModelError, match="layer 18"), converted(cfg, weights):
        pass
    assert list(cache.iterdir()) == []


def test_where_nothing_can_be_kept_the_model_is_made_for_this_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    cfg, weights = write_model(tmp_path, small())
    with converted(cfg, weights) as made:
        assert made.is_file()
    assert not made.parent.exists()
    assert "cannot be kept" in caplog.text


def test_a_model_that_someone_else_converts_at_the_same_time_is_theirs(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg, weights = write_model(tmp_path, small())
    with converted(cfg, weights) as first:
        pass
    first.rename(first.with_name("hidden"))  # so that it is not found before the work begins

    def slow(network: DarknetNetwork, numbers: str) -> object:
        first.with_name("hidden").rename(first)
        return build_model(network, numbers)

    monkeypatch.setattr("upwash.services.darknet.conversion.build_model", slow)
    with converted(cfg, weights) as second:
        assert second == first
    assert [each.name for each in cache.iterdir()] == [first.parent.name]


def test_files_that_are_not_there_are_named(tmp_path: Path) -> None:
    cfg, weights = write_model(tmp_path, small())
    for missing in (weights, cfg):
        missing.unlink()
        with (
            pytest.raises(ModelError, match=rf"{missing}: cannot be read \(No such file"),
            converted(cfg, weights),
        ):
            pass

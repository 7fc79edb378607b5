"""Whatever the bytes, each decoder gives a value or refuses them with its own error."""

from __future__ import annotations

import random
import ssl
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.fuzz.campaign import fuzz
from tests.fuzz.decoders import Broken, Decoder, decoders, model_with
from tests.fuzz.mutations import mutated

from upwash.errors import CredentialsError, ModelError, UpwashError
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import read_credentials

ODD = (
    b"",
    b"\0",
    b"\xff",
    b"[" * 100_000,
    b'{"a":' * 20_000,
    b"\x91" * 50_000,
    "\ud800".encode(errors="surrogatepass"),
)


def _long(before: bytes, after: bytes) -> bytes:
    return before + b"x" * 100_000 + after


@pytest.mark.parametrize("name", decoders())
def test_inputs_that_are_understood_are(name: str) -> None:
    decoder = decoders()[name]
    for data in decoder.understood:
        decoder.decode(data)


@pytest.mark.parametrize("name", decoders())
@pytest.mark.parametrize("odd", range(len(ODD)))
def test_odd_inputs_are_refused_in_words(name: str, odd: int) -> None:
    decoders()[name].feed(ODD[odd])


@pytest.mark.parametrize("name", decoders())
def test_inputs_that_are_nearly_understood_are_understood_or_refused(name: str) -> None:
    decoder, chance = decoders()[name], random.Random(name)
    for _ in range(decoder.tests):
        decoder.feed(mutated(chance, decoder.understood))


def routes(sources: int) -> bytes:
    """A cfg whose layers have that many times the channels of the layer before, again and again."""
    route = b"[route]\nlayers=" + b",".join([b"-1"] * sources) + b"\n"
    return b"[net]\n[convolutional]\nfilters=1\nactivation=linear\n" + route * 1900


def a_drone_with(*, services: int, servers: int) -> bytes:
    service, server = (
        b'[[service]]\nname = "p%d"\n',
        b'[[server]]\nname = "s%d"\nrange_m = 50\neast_m = 0\nnorth_m = 0\n',
    )
    return b"".join(
        (
            b"[mission]\nwaypoints_m = [[0, 0]]\n",
            *((service + b"local_call_s = 1.0\n") % number for number in range(services)),
            *((server + b"remote_call_s = 0.5\n") % number for number in range(servers)),
        )
    )


FOUND = {
    "5,000 servers": ("a drone's configuration", a_drone_with(services=1, servers=5000)),
    "5,000 services": ("a drone's configuration", a_drone_with(services=5000, servers=1)),
    "4,000 services and servers": ("a drone's configuration", a_drone_with(services=4000, servers=4000)),
    "an answer nested without end": (
        "frames of a program",
        b"\x82\xa2id\1\xa5value" + b"\x91" * 5000 + b"\1",
    ),
    "an event nested without end": (
        "an event log",
        b'{"t":0.5,"event":"armed","a":' + b"[" * 5000 + b"]" * 5000 + b"}\n",
    ),
    "a table of 2,000 columns and 60,000 rows": (
        "a goodput table",
        b"distance_m," + b"x," * 2000 + b"\n" + b"1\n" * 60_000,
    ),
    "a number of 10,000 letters": ("a goodput table", b"distance_m,goodput_mbit_s\n1," + b"x" * 10_000),
    "channels of 4,000 digits": ("a Darknet cfg", routes(100)),
    "a route of 300,000 layers": (
        "a Darknet cfg",
        routes(1) + b"[route]\nlayers=" + b"-1," * 300_000 + b"-1",
    ),
    "an option of 100,000 letters": (
        "a Darknet cfg",
        _long(b"[net]\nchannels=3\n[maxpool]\nsize=1\n", b"=1"),
    ),
    "a section of 100,000 letters": ("a Darknet cfg", _long(b"[net]\n[", b"]")),
    "a waypoint list of 400,000 lines": ("a plan", b"QGC WPL 110\n" + b"0\n" * 400_000),
    "a kind of file of 100,000 letters": (
        "a plan",
        _long(b'{"fileType":"', b'","mission":{"items":[],"plannedHomePosition":null}}'),
    ),
    "a fact of 100,000 letters": ("a coverage map", _long(b'{"upwash_coverage":1,"', b'":1}')),
    "a key of 100,000 letters": ("a drone's configuration", _long(b'name = "d1"\n', b" = 1")),
    "heads of 100,000 letters": (
        "an ONNX model's metadata",
        _long(b'[{"output":"', b'","stride":8,"anchors":[[1,1]]}]'),
    ),
}


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_is_refused(name: str) -> None:
    decoder, data = FOUND[name]
    decoders()[decoder].feed(data)


def test_an_onnx_model_whose_metadata_is_no_text_is_refused() -> None:
    model = model_with("output").replace(b"output", b"out\xff\xfft")
    with pytest.raises(ModelError, match="not text"):
        decoders()["an ONNX model"].decode(model)


def test_a_certificate_whose_key_is_none_is_refused(tmp_path: Path) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["drone"])
    content = ssl.PEM_cert_to_DER_cert((tmp_path / "drone.pem").read_text())
    key = content.index(b"\x03\x42\x00\x04")  # a point on a curve, of 64 bytes
    spoiled = content[: key + 4] + bytes(64) + content[key + 68 :]
    (tmp_path / "drone.pem").write_text(ssl.DER_cert_to_PEM_cert(spoiled))
    with pytest.raises(CredentialsError, match="a key that is understood"):
        read_credentials(tmp_path / "authority.pem", tmp_path / "drone.pem", tmp_path / "drone.key")


def test_a_campaign_counts_inputs_and_keeps_those_that_break_a_decoder(tmp_path: Path) -> None:
    fuzzed = fuzz("a signing key", seconds=1.0, kept=tmp_path)
    assert fuzzed.runs > 0
    assert fuzzed.findings == len(list(tmp_path.iterdir())) == 0


def test_a_decoder_that_does_what_it_must_not_is_broken() -> None:
    def busy(data: bytes) -> None:
        while time.thread_time() < end_s:
            pass

    end_s = time.thread_time() + 0.02
    with pytest.raises(Broken, match="took"):
        Decoder(busy, (), (), most_s=0.01).feed(b"")
    with pytest.raises(Broken, match="raised ValueError"):
        Decoder(int, (), ()).feed(b"x")
    for message in ("a\nb", "x" * 3000):
        with pytest.raises(Broken, match="the message"):
            Decoder(refuse_with(message), (UpwashError,), ()).feed(b"")


def refuse_with(message: str) -> Callable[[bytes], object]:
    def decode(_: bytes) -> None:
        raise UpwashError(message)

    return decode

"""Whatever the bytes, each decoder gives a value or refuses them with its own error."""

from __future__ import annotations

import ssl
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fuzz.decoders import decoders, model_with

from upwash.errors import CredentialsError, ModelError
from upwash.real.authority import make_keys
from upwash.real.credentials import read_credentials

ODD = (
    b"",
    b"\0",
    b"\xff",
    b"[" * 100_000,
    b'{"a":' * 20_000,
    b"\x91" * 50_000,
    "\ud800".encode(errors="surrogatepass"),
)


@st.composite
def spoiled(draw: st.DrawFn, understood: tuple[bytes, ...]) -> bytes:
    """An input that is understood, but for some bytes of it; or any bytes."""
    data = bytearray(draw(st.sampled_from(understood)))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        end = draw(st.integers(start, min(len(data), start + 8)))
        data[start:end] = draw(
            st.binary(max_size=8) | st.sampled_from([b"-1", b"1e999", b"nan", b'"', b"[", b"}"])
        )
    return draw(st.just(bytes(data)) | st.binary(max_size=100))


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
@settings(max_examples=40)
@given(data=st.data())
def test_spoiled_inputs_are_understood_or_refused(name: str, data: st.DataObject) -> None:
    decoder = decoders()[name]
    decoder.feed(data.draw(spoiled(decoder.understood)))


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

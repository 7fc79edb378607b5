"""Arrays of numpy in calls: what arrives, and what is refused where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from upwash.errors import DeclarationError, GarbledReply, UsageError
from upwash.rpc.arrays import require_arrays
from upwash.rpc.service import make_stub, service, spec_of
from upwash.sim.runtime import reply_to

Image = np.ndarray[tuple[int, int, Literal[3]], np.dtype[np.uint8]]
DTYPES = ["?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", "c8", "c16"]


@dataclass
class Region:
    name: str
    pixels: NDArray[np.float32]


@service
class Arrays:
    def same(self, image: Image) -> Image:
        return image

    def whiter(self, image: Image) -> Image:
        image[:] = 255
        return image

    def regions(self, found: list[Region]) -> dict[str, NDArray[np.float32]]:
        return {each.name: each.pixels * 2 for each in found}

    def brightest(self, image: Image) -> int:
        return np.max(image)  # type: ignore[return-value]

    def maybe(self, image: Image | None) -> bool:
        return np.bool_(image is None)  # type: ignore[return-value]

    def wrong(self, rows: int) -> Image:
        return np.zeros((rows, 2, 4), np.uint8)  # type: ignore[return-value]


def made() -> Arrays:
    methods, target = spec_of(Arrays).methods, Arrays()

    def invoke(operation: Any, method: Any, request: bytes, _: object) -> Any:
        _, reply = methods[operation.method].perform(target, request)
        return method.decode(reply)

    return make_stub(Arrays, invoke)


def image(rows: int = 2, columns: int = 4) -> Image:
    return np.arange(rows * columns * 3, dtype=np.uint8).reshape(rows, columns, 3)  # type: ignore[return-value]


def test_an_array_arrives_as_it_was_sent_and_is_the_services_own() -> None:
    sent = image()
    assert np.array_equal(made().same(sent), sent)
    assert np.all(made().whiter(sent) == 255)
    assert np.array_equal(sent, image())


@pytest.mark.parametrize(
    "given_",
    [image()[::2, ::-1], np.asfortranarray(image()), image(0, 0), image().transpose(1, 0, 2)],
    ids=["strides", "columns first", "empty", "transposed"],
)
def test_however_it_lies_in_memory(given_: Image) -> None:
    assert np.array_equal(made().same(given_), given_)


def test_arrays_within_other_types_and_numpys_numbers_arrive() -> None:
    found = made().regions([Region("a", np.array([1.5, 2.5], np.float32))])
    assert found["a"].tolist() == [3.0, 5.0]
    assert made().brightest(image()) == 23
    assert made().maybe(None) is True
    assert made().maybe(image()) is False


def declared(hint: Any) -> type[Any]:
    """A service whose one method returns what it is given, of that type."""

    def look(self: object, photo: Any) -> Any:
        return photo

    look.__annotations__ = {"photo": hint, "return": hint}
    return service(type("Camera", (), {"look": look}))


@given(st.sampled_from(DTYPES), st.lists(st.integers(0, 4), max_size=4), st.randoms())
def test_every_dtype_of_numbers_and_shape_arrives(dtype: str, shape: list[int], chance: Any) -> None:
    camera = declared(NDArray[np.dtype(dtype).type])  # type: ignore[misc]
    sent = np.frombuffer(chance.randbytes(int(np.prod(shape)) * np.dtype(dtype).itemsize), dtype).reshape(
        shape
    )
    if dtype == "?":
        sent = np.asarray(sent.view(np.uint8) % 2 == 1)
    method = spec_of(camera).methods["look"]
    for order in "<>":
        _, request = method.encode((sent.astype(sent.dtype.newbyteorder(order)),), {})  # type: ignore[arg-type]
        _, reply = method.perform(camera(), request)
        arrived = method.result(method.decode(reply))
        assert isinstance(arrived, np.ndarray)
        assert (arrived.dtype, arrived.shape) == (np.dtype(dtype), sent.shape)
        assert np.array_equal(arrived, sent, equal_nan=np.dtype(dtype).kind in "fc")


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (image().astype(np.int16), "expected an array of uint8, found dtype '<i2'"),
        (image()[0], r"expected an array of shape \(any, any, 3\), found \(4, 3\)"),
        (np.zeros((2, 2, 4), np.uint8), r"found \(2, 2, 4\)"),
        ([[1]], "expected an array: a map of dtype, shape and data"),
    ],
)
def test_another_array_than_the_type_hint_says_is_named_to_the_caller(sent: Any, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        made().same(sent)


def test_a_result_of_another_shape_is_a_garbled_reply() -> None:
    with pytest.raises(GarbledReply, match=r"arrays\.wrong\(\).*found \(3, 2, 4\)"):
        made().wrong(3)


@pytest.mark.parametrize(
    "lie",
    [
        {"dtype": "|u1", "shape": [2**62, 2**62, 3], "data": b""},
        {"dtype": "|u1", "shape": [-1, -1, 3], "data": b"abc"},
        {"dtype": "|u1", "shape": [1.0, 1.0, 3], "data": b"abc"},
        {"dtype": "|u1", "shape": [True, 1, 3], "data": b"abc"},
        {"dtype": "|u1", "shape": [1, 1, 3], "data": b"ab"},
        {"dtype": "|u1", "shape": [1, 1, 3], "data": "abc"},
        {"dtype": "|O", "shape": [1, 1, 3], "data": b"\0" * 24},
        {"dtype": "|u1", "shape": [1, 1, 3], "data": b"abc", "more": 1},
        {"shape": [1, 1, 3], "data": b"abc"},
        b"\x93NUMPY",
    ],
    ids=str,
)
def test_what_lies_about_an_array_is_refused_without_making_one(lie: object) -> None:
    method = spec_of(Arrays).methods["same"]
    with pytest.raises(GarbledReply):
        method.decode(msgspec.msgpack.encode({"value": lie}))


@pytest.mark.parametrize(
    "hint",
    [
        np.ndarray,
        NDArray[Any],
        NDArray[np.object_],
        NDArray[np.floating[Any]],
        NDArray[np.str_],
        NDArray[np.datetime64],
        list[NDArray[np.object_]],
    ],
    ids=str,
)
def test_a_type_hint_without_a_dtype_of_numbers_is_refused_with_its_place(hint: Any) -> None:
    def look(self: object, photo: Any) -> None: ...

    look.__annotations__ = {"photo": hint, "return": None}
    with pytest.raises(
        DeclarationError, match=r"service Camera, method look: parameter 'photo' cannot be sent: an array"
    ):
        service(type("Camera", (), {"look": look}))


def test_an_array_without_a_dtype_is_found_behind_a_type_alias() -> None:
    scalar = TypeVar("scalar", bound=np.generic)
    array = TypeAliasType(
        "array", np.ndarray[Any, np.dtype[scalar]], type_params=(scalar,)
    )  # numpy 2.5's NDArray
    require_arrays(list[array[np.uint8]], "it")
    for hint in (array[np.str_], list[TypeAliasType("photo", np.ndarray)]):  # type: ignore[misc]
        with pytest.raises(DeclarationError, match="it cannot be sent: an array"):
            require_arrays(hint, "it")


def test_an_array_without_a_dtype_is_found_within_a_dataclass() -> None:
    @dataclass
    class Layer:
        values: np.ndarray

    with pytest.raises(DeclarationError, match="an array needs its dtype"):
        declared(list[Layer])


def test_a_constructor_takes_no_arrays() -> None:
    class Filter:
        def __init__(self, *, kernel: NDArray[np.float32]) -> None: ...
        def run(self) -> None: ...

    with pytest.raises(UsageError, match="kernel"):
        service(Filter)


def test_a_modelled_service_answers_with_the_smallest_array() -> None:
    method = spec_of(Arrays).methods["same"]
    _, request = method.encode((image(),), {})
    empty = method.result(method.decode(reply_to(method, request)))
    assert isinstance(empty, np.ndarray)
    assert (empty.shape, empty.dtype) == ((0, 0, 3), np.uint8)

"""Declaring a service, and its calls' way over the wire and back."""

from __future__ import annotations

import enum
import importlib
import inspect
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.operation import Operation
from upwash.errors import DeclarationError, GarbledReply, ServiceError, UsageError
from upwash.rpc.service import Method, load_service, make_stub, once, request_of, service, spec_of

Mode = Literal["light", "heavy"]


class Level(enum.IntEnum):
    LOW = 1
    HIGH = 2


class Colour(enum.Enum):
    RED = "red"


@dataclass(frozen=True)
class Box:
    east_m: float
    label: str | None = None


class Detection(msgspec.Struct, frozen=True):
    box: Box
    score: float


class OfUpwash(UsageError):
    """A service's own that derives from one of upwash's."""


class Overheated(Exception):
    """Keeps its facts in its arguments, as most exceptions do."""


class Jammed(Exception):
    """Takes other arguments than it keeps."""

    def __init__(self, channel: int, strength_db: float) -> None:
        super().__init__(f"channel {channel} at {strength_db} dB")


class Fogged(Exception):
    """Words itself from what its constructor kept."""

    def __init__(self, sight_m: float) -> None:
        self.sight_m = sight_m

    def __str__(self) -> str:
        return f"sight {self.sight_m} m"


class Wordless(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


class Unlucky(Exception):
    def __init__(self) -> None:
        raise RuntimeError("cannot be made")


@service(name="eyes", profile_by="mode")
class Eyes:
    """Gives back what it gets, or raises what it was told to."""

    error: BaseException = Overheated("91 °C", 91)

    def look(self, photo: bytes, mode: Mode = "light", *, least: float = 0.5) -> list[Detection]:
        return [Detection(Box(float(len(photo)), mode), least)]

    def sort(self, boxes: dict[str, list[Box]], level: Level, colour: Colour | None) -> dict[int, Box] | None:
        return {level.value: boxes["all"][0]} if colour else None

    def nothing(self) -> None:
        return None

    def rank(self, mode: Level) -> Level:
        return mode

    def fail(self) -> int:
        raise self.error


METHODS = spec_of(Eyes).methods


def perform(target: object, method: Method, request: bytes) -> object:
    """What a remote caller gets."""
    return method.result(method.decode(method.perform(target, request)[1]))


def remote(*operations: Operation) -> Eyes:
    """A stub whose calls go over the wire and back within this process, all as one of `operations`, if any."""

    def invoke(operation: Operation, method: Method, request: bytes, _: object) -> Any:
        key, reply = method.perform(Eyes(), request)
        assert not operations or (operation in operations and operation.key == key)
        return method.decode(reply)

    return make_stub(Eyes, invoke)


def raised_remotely(error: BaseException) -> BaseException:
    """What the caller sees of an exception that the service raises."""
    eyes = Eyes()
    eyes.error = error
    with pytest.raises(BaseException) as caught:
        perform(eyes, METHODS["fail"], METHODS["fail"].encode((), {})[1])
    return caught.value


def fault(type_path: object, message: object = "hot", **more: object) -> bytes:
    """A reply that says that the service raised an exception of that class."""
    return msgspec.msgpack.encode({"fault": {"type": type_path, "message": message, **more}})


def raised_by_reply(reply: bytes) -> BaseException:
    """What the caller sees of a reply that carries a fault."""
    method = METHODS["fail"]
    with pytest.raises(BaseException) as caught:
        method.result(method.decode(reply))
    return caught.value


# --- declaring ----------------------------------------------------------------------------------------------


def takes(hint: object) -> type:
    """A class whose method `look` has a parameter `photo` of that type."""

    class Camera:
        def look(self, photo: Any) -> None:
            """Nothing."""

    Camera.look.__annotations__["photo"] = hint
    return Camera


def returns(hint: object) -> type:
    """A class whose method `look` returns that type."""

    class Camera:
        def look(self) -> Any:
            """Nothing."""

    Camera.look.__annotations__["return"] = hint
    return Camera


UNSENDABLE: list[object] = [
    Any,
    object,
    complex,
    list,
    dict[str, Any],
    list[object],
    Callable[[], int],
    Iterator[int],
    Exception,
    Path,
    list[int] | tuple[int, ...],
    "Unknown",
]


@pytest.mark.parametrize("hint", UNSENDABLE, ids=str)
def test_a_type_that_cannot_be_sent_is_refused_with_its_service_method_and_place(hint: object) -> None:
    with pytest.raises(DeclarationError, match=r"service Camera, method look.*(photo|Unknown)"):
        service(takes(hint))
    with pytest.raises(DeclarationError, match=r"service Camera, method look.*(result|Unknown)"):
        service(returns(hint))


def test_a_type_that_cannot_be_sent_is_found_within_dataclasses_and_recursive_structs() -> None:
    class Tree(msgspec.Struct):
        children: list[Tree]
        root: complex

    globals()["Tree"] = Tree
    with pytest.raises(DeclarationError, match=r"parameter 'photo'.*complex"):
        service(takes(Tree))


def test_a_recursive_type_that_can_be_sent_is_accepted() -> None:
    class Branch(msgspec.Struct):
        children: list[Branch]

    globals()["Branch"] = Branch
    assert spec_of(service(takes(Branch))).methods.keys() == {"look"}


class Unhinted:
    def look(self, photo) -> None:  # type: ignore[no-untyped-def]
        """Nothing."""


class NoResult:
    def look(self, photo: bytes):  # type: ignore[no-untyped-def]
        """Nothing."""


class Starred:
    def look(self, *photos: bytes) -> None:
        """Nothing."""


class Named:
    def look(self, **photos: bytes) -> None:
        """Nothing."""


class Positional:
    def look(self, photos: bytes, /) -> None:
        """Nothing."""


class Coroutine:
    async def look(self) -> None:
        """Nothing."""


class Empty:
    def _look(self) -> None:
        """Nothing."""


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        (Unhinted, "service Unhinted, method look: parameter 'photo' has no type hint"),
        (NoResult, "service NoResult, method look: the result has no type hint"),
        (Starred, "service Starred, method look: parameter 'photos' must be passable by its name"),
        (Named, "service Named, method look: parameter 'photos' must be passable by its name"),
        (Positional, "service Positional, method look: parameter 'photos' must be passable by its name"),
        (Coroutine, "service Coroutine, method look: declare it as a plain blocking method"),
        (Empty, "service Empty has no public method"),
    ],
)
def test_a_class_that_cannot_be_called_from_afar_is_refused(declared: type, said: str) -> None:
    with pytest.raises(DeclarationError, match=said):
        service(declared)


@pytest.mark.parametrize("kind", [staticmethod, classmethod])
def test_a_method_without_self_is_refused_or_can_be_called(kind: Callable[..., Any]) -> None:
    def add(a: int, b: int) -> int:
        return a + b

    def add_of_class(_: type, a: int, b: int) -> int:
        return a + b

    class Adder:
        def nothing(self) -> None:
            """Keeps the class from having no method at all."""

    setattr(Adder, "add", kind(add if kind is staticmethod else add_of_class))  # noqa: B010
    try:
        method = spec_of(service(Adder)).methods["add"]
    except DeclarationError as refusal:
        assert "service Adder, method add" in str(refusal)
    else:
        assert perform(Adder(), method, method.encode((1, 2), {})[1]) == 3


def part(**given: Any) -> type:
    """A service with a method `look` of these parameters, and with that result."""

    def look(self: object, *values: Any) -> Any:
        return values

    result = given.pop("returns", next(iter(given.values()), None))
    names = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in ("self", *given)]
    look.__signature__ = inspect.Signature(names)  # type: ignore[attr-defined]
    look.__annotations__ = {**given, "return": result}
    return service(type("Less", (), {"look": look}))


class Looking:
    def look(self, photo: bytes, mode: Literal["light", "heavy"], sizes: list[int]) -> int:
        return len(photo)

    @once
    def act(self, photo: bytes) -> None: ...


@service
class Acting:
    def act(self, photo: bytes) -> bytes:
        return photo


@service
class Staring:
    def stare(self, photo: bytes) -> bytes:
        return photo


@pytest.mark.parametrize(
    ("before", "said"),
    [
        (bytes, "name a class with @service above it"),
        ("Less", "name a class with @service above it"),
        (Staring, r"Staring\.stare: .*give it the name of the operation"),
        (Acting, r"Acting\.act: calls of a method with @once are never sent"),
        (part(returns=bytes), "it has no parameter"),
        (part(photo=str), "parameter 'photo' .*: write photo: bytes"),
        (part(other=bytes), "parameter 'other' .*: write one of photo, mode, sizes"),
        (part(mode=Literal["light", "heavy"]), "'mode' says which operation it is"),
        (part(photo=bytes, returns=str), "write -> bytes"),
        (part(photo=bytes, sizes=list[int]), r"write -> tuple\[bytes, list\[int\]\]"),
    ],
)
def test_a_part_before_sending_that_does_not_fit_is_refused_with_the_remedy(before: Any, said: str) -> None:
    with pytest.raises(DeclarationError, match=f"service Looking: before_sending.*{said}"):
        service(profile_by="mode", before_sending=before)(Looking)


def test_a_part_before_sending_may_change_several_parameters_and_never_their_types() -> None:
    less = part(photo=bytes, sizes=list[int], returns=tuple[bytes, list[int]])
    operation = spec_of(service(profile_by="mode", before_sending=less)(Looking)).methods["look"]
    changing = spec_of(less).methods["look"]
    request = operation.encode((b"1234", "heavy", [1, 2]), {})[1]
    assert changing.request.decode(operation.request_of_part(request)).sizes == [1, 2]
    smaller = operation.reduced(request, changing.reply.encode({"value": (b"12", [1])}))
    assert smaller == operation.encode((b"12", "heavy", [1]), {})[1]
    for value in ("12", (b"12", ["1"]), (b"12",), None):
        with pytest.raises(GarbledReply):
            operation.reduced(request, changing.reply.encode({"value": value}))


@pytest.mark.parametrize("name", ["speed", "self"])
def test_a_profile_parameter_that_no_method_has_is_refused(name: str) -> None:
    class Camera:
        def look(self, photo: bytes) -> None:
            """Nothing."""

    with pytest.raises(DeclarationError, match=rf"service Camera: no method has the parameter '{name}'"):
        service(profile_by=name)(Camera)


def test_a_service_declares_how_many_calls_an_instance_computes_at_a_time() -> None:
    assert spec_of(Eyes).concurrency == 1
    assert spec_of(service(concurrency=64)(takes(bytes))).concurrency == 64


@pytest.mark.parametrize("concurrency", [0, -1, 65, True, 2.0, "2", None])
def test_a_number_of_calls_at_a_time_that_cannot_be_is_refused_in_one_sentence(concurrency: Any) -> None:
    with pytest.raises(DeclarationError, match=r"\Aservice Camera: .* an integer from 1 to 64\Z"):
        service(concurrency=concurrency)(takes(bytes))


def test_a_service_is_called_after_its_class_or_as_it_says() -> None:
    assert spec_of(Eyes).name == "eyes"
    assert spec_of(service(takes(bytes))).name == "camera"


def test_a_class_that_was_not_declared_itself_is_no_service() -> None:
    class Sharper(Eyes):
        """Inherits the methods; the declaration is Eyes' own."""

    with pytest.raises(UsageError, match="put @service above"):
        spec_of(Sharper)


def test_only_a_class_can_be_loaded_as_a_service() -> None:
    assert load_service("upwash.services:Detector")
    with pytest.raises(UsageError, match="not a class"):
        load_service("upwash.rpc.service:service")
    with pytest.raises(UsageError, match="put @service above"):
        load_service("upwash.core.geo:Position")


# --- calling ------------------------------------------------------------------------------------------------


def test_values_arrive_as_they_were_sent() -> None:
    eyes, box = remote(), Box(1.5)
    assert eyes.look(b"\x00\xff") == [Detection(Box(2.0, "light"), 0.5)]
    assert eyes.sort({"all": [box]}, Level.HIGH, Colour.RED) == {2: box}
    assert eyes.sort({"all": []}, Level.LOW, None) is None
    assert eyes.nothing() is None  # type: ignore[func-returns-value]
    assert type(eyes.rank(Level.HIGH)) is Level


def test_the_request_of_a_stubs_method_is_the_one_that_its_call_would_send() -> None:
    operation, method, request = request_of(remote().look, (b"",), {"mode": "heavy"})
    assert (str(operation), method.name) == ("eyes.look[heavy]", "look")
    assert perform(Eyes(), method, request) == Eyes().look(b"", "heavy")
    with pytest.raises(UsageError, match=r"Eyes\.look is no method of a service: give one of an object that"):
        request_of(Eyes().look, (b"",), {})


def test_defaults_and_keywords_are_those_of_the_method() -> None:
    eyes, here = remote(), Eyes()
    assert eyes.look(least=0.1, photo=b"") == here.look(least=0.1, photo=b"")
    assert eyes.look(b"", "heavy") == here.look(b"", "heavy")


@pytest.mark.parametrize(
    "call",
    [
        lambda eyes: eyes.look(),
        lambda eyes: eyes.look(b"", "light", 0.5),
        lambda eyes: eyes.look(b"", colour=1),
        lambda eyes: eyes.look(b"", photo=b""),
    ],
)
def test_a_call_that_does_not_fit_raises_what_the_object_itself_would(call: Callable[[Any], object]) -> None:
    for eyes in (Eyes(), remote()):
        with pytest.raises(TypeError):
            call(eyes)


def test_an_argument_of_the_wrong_type_is_named_to_the_caller() -> None:
    wrong: Any = "no bytes"
    with pytest.raises(TypeError, match=r"look\(\): Expected.*\$\.photo"):
        remote().look(wrong, least="a lot")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"look\(\): Invalid enum value 'fast'.*\$\.mode"):
        remote().look(b"", "fast")  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        remote().look(object())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "operation"),
    [
        (lambda eyes: eyes.look(b"", "heavy"), Operation("eyes", "look", "heavy")),
        (lambda eyes: eyes.look(b""), Operation("eyes", "look", "light")),
        (lambda eyes: eyes.rank(Level.HIGH), Operation("eyes", "rank", "2")),
        (lambda eyes: eyes.nothing(), Operation("eyes", "nothing", "")),
    ],
)
def test_estimates_are_kept_by_the_value_of_the_profile_argument(
    call: Callable[[Eyes], object], operation: Operation
) -> None:
    call(remote(operation))


def test_a_result_of_another_type_than_declared_is_a_garbled_reply() -> None:
    class Liar:
        def rank(self, mode: Level) -> str:
            return "high"

    method = METHODS["rank"]
    with pytest.raises(
        GarbledReply, match=r"eyes\.rank\(\): what it returned is not what its type hint says"
    ):
        perform(Liar(), method, method.encode((Level.LOW,), {})[1])


def test_a_result_that_cannot_be_encoded_is_the_services_error() -> None:
    class Odd:
        def nothing(self) -> object:
            return object()

    method = METHODS["nothing"]
    with pytest.raises(TypeError, match="object"):
        perform(Odd(), method, method.encode((), {})[1])


# --- exceptions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "error",
    [
        ValueError("not a JPEG"),
        ValueError(),
        ValueError("a", 1, 2.5, None),
        ValueError(["a list"]),
        KeyError("photo"),
        FileNotFoundError(2, "No such file or directory", "model.onnx"),
        Overheated("91 °C", 91),
        Jammed(6, -40.0),
        msgspec.ValidationError("the service's own file is wrong"),
    ],
    ids=repr,
)
def test_an_exception_arrives_as_its_own_class_with_its_message(error: Exception) -> None:
    seen = raised_remotely(error)
    assert (type(seen), str(seen)) == (type(error), str(error))


def test_an_operating_systems_error_arrives_with_its_number_and_file() -> None:
    seen = raised_remotely(FileNotFoundError(2, "No such file or directory", "model.onnx"))
    assert isinstance(seen, FileNotFoundError)
    assert (seen.errno, seen.filename) == (2, "model.onnx")


@pytest.mark.parametrize(
    ("error", "type_name", "message"),
    [
        (Fogged(30.0), f"{__name__}.Fogged", "sight 30.0 m"),
        (ExceptionGroup("two failed", [ValueError()]), "builtins.ExceptionGroup", "two failed"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"), "builtins.UnicodeDecodeError", "can't decode"),
        (SystemExit("the model is gone"), "builtins.SystemExit", "the model is gone"),
        (KeyboardInterrupt(), "builtins.KeyboardInterrupt", ""),
    ],
    ids=lambda value: type(value).__name__,
)
def test_an_exception_that_cannot_be_made_again_arrives_by_name_and_message(
    error: BaseException, type_name: str, message: str
) -> None:
    seen = raised_remotely(error)
    assert isinstance(seen, ServiceError)
    assert seen.type_name == type_name
    assert message in seen.message


@pytest.mark.parametrize(
    "error",
    [ValueError(2**70), ValueError("\udcff"), Overheated(type("Celsius", (float,), {})(91.0)), Wordless()],
    ids=["a large number", "an undecodable file name", "a kind of number", "no words"],
)
def test_an_exception_whose_facts_cannot_be_sent_still_arrives(error: Exception) -> None:
    seen = raised_remotely(error)
    assert type(seen) in (type(error), ServiceError)


def test_an_exception_of_a_class_that_is_not_here_arrives_by_name_and_message() -> None:
    seen = raised_by_reply(fault("their_package.errors:Overheated", "91 °C"))
    assert isinstance(seen, ServiceError)
    assert (seen.type_name, seen.message) == ("their_package.errors.Overheated", "91 °C")


@pytest.mark.parametrize(
    "type_path",
    ["builtins:int", "builtins:SystemExit", "builtins:print", "os:system", "os.path:os.system", "", ":", "x"],
)
def test_only_exception_classes_are_made(type_path: str) -> None:
    assert isinstance(raised_by_reply(fault(type_path)), ServiceError)


@pytest.mark.parametrize(
    "type_path",
    [
        "upwash.drone.flight:AutopilotOverruled",
        "upwash.drone.coming_down:AutopilotOverruled",
        "upwash.drone.mission:MissionStopped",
        "upwash.errors:UpwashError",
        "upwash.rpc.service:ServiceError",
        f"{__name__}:OfUpwash",
        f"{__name__}:GarbledReply",
    ],
)
def test_a_reply_never_makes_an_error_of_upwash_itself_by_whatever_name(type_path: str) -> None:
    importlib.import_module("upwash.drone.flight")
    seen = raised_by_reply(fault(type_path, "mission: the pilot has it"))
    assert isinstance(seen, ServiceError)
    assert seen.type_name == type_path.replace(":", ".")


def test_what_a_fault_says_is_told_in_short() -> None:
    method = METHODS["fail"]
    assert method.raised(method.decode(fault("builtins:ValueError", "hot"))) == "builtins.ValueError: hot"
    assert len(method.raised(method.decode(fault("x" * 10_000, "y" * 10_000)))) < 300
    assert method.raised(method.decode(msgspec.msgpack.encode({"value": 1}))) == ""


def test_a_method_is_declared_to_run_once() -> None:
    @service
    class Winch:
        def look(self) -> int:
            """Harmless."""
            return 1

        @once
        def lower(self) -> int:
            """Not harmless."""
            return 2

    methods = spec_of(Winch).methods
    assert (methods["look"].once, methods["lower"].once) == (False, True)


def test_a_constructor_of_an_exception_is_not_run() -> None:
    seen = raised_by_reply(fault(f"{__name__}:Unlucky"))
    assert (type(seen), str(seen)) == (Unlucky, "hot")


def test_a_reply_does_not_choose_what_is_imported() -> None:
    assert "antigravity" not in sys.modules
    assert isinstance(raised_by_reply(fault("antigravity:Fault")), ServiceError)
    assert "antigravity" not in sys.modules


def test_a_reply_does_not_have_a_module_run_its_own_lookup(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    lazy = types.ModuleType("lazy_for_tests")
    lazy.__getattr__ = asked.append  # type: ignore[method-assign]
    monkeypatch.setitem(sys.modules, "lazy_for_tests", lazy)
    assert isinstance(raised_by_reply(fault("lazy_for_tests:Fault")), ServiceError)
    assert asked == []


def test_a_reply_does_not_run_a_program_of_the_services_own_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "package_for_tests"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from upwash.rpc.service import service\n@service\nclass Eyes:\n    def look(self) -> None: ...\n"
    )
    (package / "__main__.py").write_text("raise SystemExit('the program ran')\n")
    (package / "broken.py").write_text("1 / 0\n")
    (package / "errors.py").write_text("class Blind(Exception): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    method = spec_of(load_service("package_for_tests:Eyes")).methods["look"]
    for module in ("__main__", "broken", "errors"):
        with pytest.raises(ServiceError):
            method.result(method.decode(fault(f"package_for_tests.{module}:Blind")))
    importlib.import_module("package_for_tests.errors")  # as the service's own module would have
    with pytest.raises(Exception, match="hot") as caught:
        method.result(method.decode(fault("package_for_tests.errors:Blind")))
    assert type(caught.value).__name__ == "Blind"


# --- garbled messages ---------------------------------------------------------------------------------------


def mutilated() -> st.SearchStrategy[bytes]:
    """Replies that are nearly right, and bytes that are not at all."""
    good = [METHODS["look"].perform(Eyes(), METHODS["look"].encode((b"photo",), {})[1])[1], fault("a:B")]
    texts = st.text() | st.sampled_from(["builtins:", "upwash.", ":", "__main__"])
    return (
        st.binary()
        | st.tuples(st.sampled_from(good), st.integers(0, 40), st.binary(max_size=4)).map(
            lambda drawn: drawn[0][: drawn[1]] + drawn[2] + drawn[0][drawn[1] + len(drawn[2]) :]
        )
        | st.builds(fault, texts, texts, args=st.none() | st.lists(st.none() | st.integers(0, 9) | texts))
    )


NASTY = [
    b"",
    b"\xc0",
    b"\x80",
    b"\x81\xa5value\xa2\xff\xfe",
    b"\x81\xa5fault\x82\xa4type\xa2\xff\xfe\xa7message\xa1x",
    b"\x81\xa1x" + b"\x91" * 100_000,
    b"\xdd\xff\xff\xff\xff",
    b"\xdb\xff\xff\xff\xff",
    b"\x81\xa5value\xc7\x0c\xff" + b"\xff" * 12,
    b"\x82\xa5value\xc0\xa5fault\xc0",
]


def decode_everywhere(reply: bytes) -> None:
    for method in METHODS.values():
        try:
            decoded = method.decode(reply)
        except GarbledReply:
            continue
        try:
            method.result(decoded)
        except ServiceError:
            pass
        except Exception as error:  # noqa: BLE001 - a class that the fault names, or else a bug
            assert type(error).__name__ in repr(reply)


@pytest.mark.parametrize("reply", NASTY, ids=range(len(NASTY)))
def test_a_nasty_reply_is_a_garbled_reply(reply: bytes) -> None:
    decode_everywhere(reply)


@given(mutilated())
def test_whatever_is_replied_the_caller_gets_a_value_a_fault_or_a_garbled_reply(reply: bytes) -> None:
    decode_everywhere(reply)


@pytest.mark.parametrize("request_", NASTY, ids=range(len(NASTY)))
def test_a_nasty_request_gets_a_reply(request_: bytes) -> None:
    answer_everywhere(request_)


@given(mutilated())
def test_whatever_is_requested_gets_a_reply(request_: bytes) -> None:
    answer_everywhere(request_)


def answer_everywhere(request: bytes) -> None:
    for method in METHODS.values():
        key, reply = method.perform(Eyes(), request)
        assert method.decode(reply) is not None
        assert isinstance(key, str)


@pytest.mark.parametrize(("method", "key"), [("look", "heavy"), ("rank", "2")])
def test_a_request_can_be_made_again_under_another_profile_key(method: str, key: str) -> None:
    declared = METHODS[method]
    arguments: dict[str, Any] = (
        {"photo": b"\xff\x00", "least": 0.25} if method == "look" else {"mode": Level.LOW}
    )
    _, request = declared.encode((), arguments)
    again = declared.under(key, request)
    assert declared.key_of(again) == key
    if method == "look":
        assert perform(Eyes(), declared, again) == [Detection(Box(2.0, "heavy"), 0.25)]


def test_a_profile_key_that_is_no_argument_is_refused_with_those_that_are() -> None:
    with pytest.raises(ValueError, match=r"look\(mode=\.\.\.\): Invalid enum value 'tiny'"):
        METHODS["look"].argument("tiny")


def test_a_name_in_place_of_the_class_is_refused_with_the_way_to_write_it() -> None:
    with pytest.raises(DeclarationError, match=r"or @service\(name='camera'\)"):
        service("camera")  # type: ignore[call-overload]


def test_a_function_is_no_service_and_the_error_says_what_to_do() -> None:
    with pytest.raises(DeclarationError, match=r"above the function flown: make it a method of a class"):

        @service  # type: ignore[call-overload]
        def flown() -> None: ...

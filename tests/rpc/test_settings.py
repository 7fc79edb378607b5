"""A service's settings: what its constructor says it takes, what a configuration gives, and the way between."""

from __future__ import annotations

import enum
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.errors import ConfigError, DeclarationError, UsageError
from upwash.missions.bundled import LoadedService, load_services
from upwash.rpc.service import once, service, spec_of
from upwash.rpc.settings import construct, describe_settings, plain


class Colour(enum.Enum):
    RED = "red"
    BLUE = "blue"


class Files(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    cfg: Path | None = None
    onnx: Path | None = None

    def __post_init__(self) -> None:
        if (self.cfg is None) == (self.onnx is None):
            raise ValueError("give either cfg or onnx")


@dataclass(frozen=True)
class Limits:
    least: float
    most: float = 1.0


class Lens:
    """Keeps what it is made of; the defaults are no values that a configuration could give."""

    def __init__(
        self,
        name: str,
        threads: Annotated[int, msgspec.Meta(ge=1, description="an integer of at least 1")] = -1,
        *,
        colour: Colour = Colour.RED,
        provider: Literal["cpu", "cuda"] = "cpu",
        files: Files | None = None,
        sizes: dict[str, int] | None = None,
        by_number: dict[int, bool] | None = None,
        weights: list[float] = [0.5],  # noqa: B006 - what it is here
        limits: Limits | None = None,
        bright: bool = False,
    ) -> None:
        self.made = dict(vars()) | {"self": None}


KIND = describe_settings(Lens)
DEFAULTS = Lens("n").made
given_settings = st.fixed_dictionaries(
    {"name": st.text()},
    optional={
        "threads": st.integers(1, 2**60),
        "colour": st.sampled_from(["red", "blue"]),
        "provider": st.sampled_from(["cpu", "cuda"]),
        "files": st.fixed_dictionaries({"cfg": st.sampled_from(["/a/b.cfg", "/c d/é.cfg"])}),
        "sizes": st.dictionaries(st.text(), st.integers(-(2**60), 2**60)),
        "by_number": st.dictionaries(st.integers(0, 2**60), st.booleans()),
        "weights": st.lists(st.floats(allow_nan=False, allow_infinity=False)),
        "limits": st.fixed_dictionaries({"least": st.floats(0, 1)}, optional={"most": st.floats(0, 1)}),
        "bright": st.booleans(),
    },
)


@given(given_settings)
def test_settings_arrive_as_they_were_given_and_the_others_keep_their_defaults(given: dict[str, Any]) -> None:
    sent = plain(msgspec.convert(given, KIND, dec_hook=lambda kind, text: kind(text)))
    travelled = json.loads(json.dumps(sent))
    assert travelled == sent
    made = construct(Lens, KIND, travelled).made
    expected = DEFAULTS | given
    if "colour" in given:
        expected["colour"] = Colour(given["colour"])
    if "files" in given:
        expected["files"] = Files(cfg=Path(given["files"]["cfg"]))
    if "limits" in given:
        expected["limits"] = Limits(**given["limits"])
    assert made == expected


@pytest.mark.parametrize(
    "settings",
    [{}, {"name": 3}, {"name": "n", "threads": 0}, {"name": "n", "thread": 1}, {"name": "n", "files": {}}],
)
def test_settings_that_do_not_fit_are_refused_where_they_arrive_too(settings: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="Lens cannot be made with its settings"):
        construct(Lens, KIND, settings)


def test_a_class_without_a_constructor_takes_nothing() -> None:
    class Plain:
        pass

    assert isinstance(construct(Plain, describe_settings(Plain), {}), Plain)
    with pytest.raises(UsageError, match="threads"):
        construct(Plain, describe_settings(Plain), {"threads": 1})


def test_a_constructor_that_fails_is_named_with_the_line_in_its_own_file() -> None:
    class Broken:
        def __init__(self) -> None:
            json.loads("{")

    line = Broken.__init__.__code__.co_firstlineno + 1
    with pytest.raises(UsageError, match=rf"Broken cannot be made: .*\(.*test_settings\.py, line {line}\)"):
        construct(Broken, describe_settings(Broken), {})


class Unhinted:
    def __init__(self, model=None) -> None:  # type: ignore[no-untyped-def]
        pass


class Nameless:
    def __init__(self, model: str = "", /) -> None:
        pass


class Live:
    def __init__(self, clock: Callable[[], float] | None = None) -> None:
        pass


class Vague:
    def __init__(self, model: Any = None) -> None:
        pass


class Unresolved:
    def __init__(self, model: Nowhere = None) -> None:  # type: ignore[name-defined]  # noqa: F821
        pass


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        (Unhinted, "__init__'s parameter 'model' has no type hint"),
        (Nameless, "__init__'s parameter 'model' must be passable by its name"),
        (Live, "__init__'s parameter 'clock' cannot be sent"),
        (Vague, "__init__'s parameter 'model' cannot be sent as"),
        (Unresolved, "a type hint of __init__ cannot be resolved"),
    ],
)
def test_a_constructor_that_no_configuration_can_call_is_refused(cls: type, said: str) -> None:
    with pytest.raises(DeclarationError, match=f"service {cls.__name__}: {said}"):
        describe_settings(cls)


# --- from a configuration -----------------------------------------------------------------------------------

PROGRAM = """
from pathlib import Path
from typing import Literal
import msgspec
from upwash import service

class Files(msgspec.Struct):
    cfg: Path
    names: Path | None = None

    def __post_init__(self):
        if self.names == self.cfg:
            raise ValueError("cfg and names are the same file: give two")

@service
class Lens:
    def __init__(self, model: Files, *, threads: int = 1, provider: Literal["cpu", "cuda"] = "cpu",
                 sizes: list[int] = [], shares: dict[str, float] = {}): ...
    def look(self) -> None: ...
"""
DRONE = """
[mission]
waypoints_m = [[0, 0]]
[[service]]
name = "lens"
program = "mine.py:Lens"
local_call_s = 1.0
"""
DAEMON = """
listen = "127.0.0.1:0"
allow_without_certificates = true
[[server]]
name = "s1"
[[service]]
name = "lens"
program = "mine.py:Lens"
"""


def loaded(folder: Path, text: str) -> LoadedService:
    """The one service of the configuration of that text."""
    (folder / "mine.py").write_text(PROGRAM)
    file = folder / "config.toml"
    file.write_text(text)
    if "[mission]" in text:
        return load_services(read_drone_config(file).services)["lens"]
    return load_services(read_daemon_config(file).images)["lens"]


@pytest.mark.parametrize("text", [DRONE, DAEMON])
def test_a_configuration_gives_settings_with_paths_from_its_folder(text: str, tmp_path: Path) -> None:
    settings = '[service.settings]\nthreads = 4\nmodel = { cfg = "a.cfg", names = "/etc/a.names" }\n'
    service = loaded(tmp_path, text + settings)
    assert service.program.settings == {
        "threads": 4,
        "model": {"cfg": f"{tmp_path}/a.cfg", "names": "/etc/a.names"},
    }
    assert construct(service.cls, spec_of(service.cls).settings, service.program.settings) is not None


@pytest.mark.parametrize("text", [DRONE, DAEMON])
@pytest.mark.parametrize(
    ("settings", "key", "problem"),
    [
        ("threads = 1", "model", "missing: add a table with the keys cfg, names"),
        ("model = 3", "model", "expected a table with the keys cfg, names, found 3"),
        ("model = {}", "model.cfg", "missing: add a file's path, absolute or from this file's folder"),
        (
            'model = { cfg = "" }',
            "model.cfg",
            "expected a file's path, absolute or from this file's folder, found \"\"",
        ),
        ('model = { cfg = "a", names = "a" }', "model", "cfg and names are the same file: give two"),
        ('model = { cfg = "a" }\nthread = 1', "thread", 'unknown key "thread"; did you mean "threads"?'),
        ('model = { cfg = "a" }\nthreads = "2"', "threads", 'expected an integer, found "2"'),
        ('model = { cfg = "a" }\nprovider = "tpu"', "provider", 'expected one of "cpu", "cuda", found "tpu"'),
        ('model = { cfg = "a" }\nsizes = [1, "b"]', "sizes[1]", 'expected an integer, found "b"'),
        ('model = { cfg = "a" }\nsizes = 1', "sizes", "expected an array, found 1"),
        ('model = { cfg = "a" }\nshares = []', "shares", "expected a table, found []"),
    ],
)
def test_a_setting_that_does_not_fit_is_refused_with_file_key_and_remedy(
    text: str, settings: str, key: str, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as refusal:
        loaded(tmp_path, f"{text}\n[service.settings]\n{settings}\n")
    assert refusal.value.file == str(tmp_path / "config.toml")
    assert refusal.value.key == f"service[0].settings.{key}"
    assert refusal.value.problem.startswith(problem)


@pytest.mark.parametrize("text", [DRONE, DAEMON])
def test_what_is_no_table_of_settings_is_refused_when_the_file_is_read(text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"service\[0\]\.settings: expected a table of what .* found 3"):
        loaded(tmp_path, f"{text}\nsettings = 3\n")


@pytest.mark.parametrize("text", [DRONE, DAEMON])
def test_a_service_that_needs_settings_says_which(text: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"service 'lens' needs model: add them in \[service\.settings\]"):
        loaded(tmp_path, text)


def test_what_is_wrong_within_a_map_is_shown_as_the_map(tmp_path: Path) -> None:
    text = f'{DRONE}\n[service.settings]\nmodel = {{ cfg = "a" }}\nshares = {{ x = "b" }}\n'
    with pytest.raises(ConfigError, match=r'shares: expected a table, found {"x": "b"}'):
        loaded(tmp_path, text)


def test_a_service_declared_in_the_usual_way_knows_its_settings() -> None:
    @service
    class Meter:
        def __init__(self, *, gain: float = 1.0) -> None: ...

        def read(self) -> None: ...

    assert [field.name for field in msgspec.structs.fields(spec_of(Meter).settings)] == ["gain"]


# --- services that use services -----------------------------------------------------------------------------


@service
class Scale:
    def __init__(self, factor: float = 2.0, *, table: Path | None = None) -> None:
        self._factor = factor

    def apply(self, value: float) -> float:
        if value < 0:
            raise ValueError("nothing weighs less than nothing")
        return self._factor * value


@service
class Balance:
    def __init__(self, left: Scale, right: Scale, *, spare: Scale | None = None, offset: float = 0.0) -> None:
        self._left, self._right, self._offset = left, right, offset
        self.spare = spare

    def difference(self, value: float) -> float:
        return self._right.apply(value) - self._left.apply(value) + self._offset


@service
class Needy:
    def __init__(self, name: str) -> None: ...

    def nothing(self) -> None: ...


def balance(settings: dict[str, Any]) -> Balance:
    kind = spec_of(Balance).settings
    return construct(Balance, kind, plain(msgspec.convert(settings, kind)))


def test_a_service_that_another_one_uses_is_made_with_it_of_its_own_settings() -> None:
    made = balance({"right": {"factor": 5.0}, "offset": 1.0})
    assert made.difference(3.0) == 5.0 * 3.0 - 2.0 * 3.0 + 1.0
    assert made.spare is None
    spare = balance({"spare": {"factor": 7.0}}).spare
    assert spare is not None
    assert spare.apply(1.0) == 7.0


def test_what_a_used_service_raises_is_the_callers_to_raise() -> None:
    with pytest.raises(ValueError, match="nothing weighs less"):
        balance({}).difference(-1.0)


def test_the_settings_of_a_used_service_are_checked_by_its_own_types(tmp_path: Path) -> None:
    kind = spec_of(Balance).settings
    with pytest.raises(msgspec.ValidationError, match=r"\$\.left\.factor"):
        msgspec.convert({"left": {"factor": "much"}}, kind)
    with pytest.raises(msgspec.ValidationError, match="weight"):
        msgspec.convert({"left": {"weight": 1.0}}, kind)


def test_a_used_service_that_needs_a_setting_makes_its_user_need_it() -> None:
    @service
    class User:
        def __init__(self, needy: Needy) -> None: ...

        def nothing(self) -> None: ...

    assert [field.name for field in msgspec.structs.fields(spec_of(User).settings) if field.required] == [
        "needy"
    ]


def test_a_service_that_acts_on_the_drone_cannot_be_used_by_another_one() -> None:
    @service
    class Arm:
        @once
        def drop_parcel(self) -> None: ...

    class Delivery:
        def __init__(self, arm: Arm) -> None: ...

        def deliver(self) -> None: ...

    Delivery.__init__.__annotations__["arm"] = Arm
    with pytest.raises(
        DeclarationError,
        match=r"uses arm, whose drop_parcel runs once, and on the drone alone, .*: have the mission call arm itself",
    ):
        service(Delivery)

"""What is public: a page says it, and what users read and run names nothing else."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

import upwash
import upwash.plug_ins
import upwash.policies
import upwash.services
from upwash.cli.main import main
from upwash.missions import program

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
PUBLIC = {
    package.__name__: set(package.__all__)
    for package in (upwash, upwash.services, upwash.policies, upwash.plug_ins)
}
PUBLIC["upwash.environment"] = {"UpwashEnv"}  # which needs Gymnasium


def shown() -> Iterator[tuple[str, str]]:
    """All Python that users read or run, by where it stands."""
    for page in PAGES:
        for block in re.findall(r"```python[^\n]*\n(.*?)```", page.read_text(), flags=re.DOTALL):
            yield page.name, dedent(block)
    folders = ("examples", "scenarios", "src/upwash/cli/project")
    for file in sorted(file for folder in folders for file in (ROOT / folder).glob("*.py")):
        yield file.name, file.read_text()
    for mission in program._MISSIONS.values():
        spec = find_spec(mission.partition(":")[0])
        assert spec is not None
        assert spec.origin is not None
        yield mission, Path(spec.origin).read_text()


def named(code: str) -> Iterator[tuple[str, str]]:
    """The names that the code takes from upwash, each with where from."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=str(module), names=names) if module.partition(".")[0] == "upwash":
                yield from ((module, each.name) for each in names)
            case ast.Import(names=names):
                yield from ((each.name, "") for each in names if each.name.partition(".")[0] == "upwash")
            case ast.Attribute(value=ast.Name(id="upwash"), attr=name):
                yield "upwash", name


def test_the_page_is_made_of_the_docstrings_and_signatures() -> None:
    page = runpy.run_path(str(ROOT / "site" / "api.py"))["page"]()
    assert page == (ROOT / "docs" / "api.md").read_text(), "run make docs, or python site/api.py alone"


def test_what_users_read_and_run_names_only_what_is_public() -> None:
    private = [
        f"{where}: {module} {name}"
        for where, code in shown()
        for module, name in named(code)
        if module not in PUBLIC or (name and name not in PUBLIC[module] | {"services"})
    ]
    assert not private
    assert {name for _, code in shown() for module, name in named(code) if module == "upwash"} >= {
        *("AutopilotRefused", "Drone", "compare", "once", "read_log", "service", "simulate"),
    }


def test_programs_in_configurations_are_bundled_by_name_or_the_users_own() -> None:
    texts = [page.read_text() for page in PAGES]
    texts += [
        file.read_text() for folder in ("examples", "scenarios") for file in (ROOT / folder).glob("*.toml")
    ]
    programs = [
        each for text in texts for each in re.findall(r'^program = "([^"]+)"', text, flags=re.MULTILINE)
    ]
    assert programs
    assert not [program for program in programs if program.startswith("upwash")]


@pytest.mark.parametrize("page", ["scenarios.md", "fleets.md", "campaigns.md", "report.md"])
def test_what_a_page_shows_in_python_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    log = tmp_path / "events.jsonl"
    assert main(["simulate", "scenarios/thesis.toml", "--log", str(log)]) == 0
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(), flags=re.DOTALL):
        found: dict[str, Any] = {}
        exec(re.sub(r"runs/.*?/events\.jsonl", str(log), block), found)
        made = {name: value for name, value in found.items() if name in ("flight", "times_s", "delays_s")}
        assert all(made.values())
        assert made


@pytest.mark.parametrize(
    ("mission", "kind", "times"), [("look_around", "notified", 2), ("look_from_all_sides", "turned", 4)]
)
def test_a_mission_that_a_page_shows_flies(tmp_path: Path, mission: str, kind: str, times: int) -> None:
    programs = re.findall(r"```python\n(.*?)```", (ROOT / "docs/missions.md").read_text(), flags=re.DOTALL)
    (program,) = (each for each in programs if f"def {mission}(" in each)
    (tmp_path / "looking.py").write_text(program)
    overrides = {"mission.program": f"{tmp_path}/looking.py:{mission}"}
    flight = upwash.simulate(ROOT / "examples" / "patrol.toml", overrides=overrides)
    assert flight.completed
    assert [event.kind for event in flight.events].count(kind) == times


def test_every_error_that_a_page_names_can_be_imported() -> None:
    import upwash.errors

    names = set(upwash.errors.__all__) - {"Refused"}  # an ordinary word too
    pages = "".join(page.read_text() for page in PAGES)
    assert {name for name in names if re.search(rf"\b{name}\b", pages)} <= PUBLIC["upwash"]


@pytest.mark.parametrize("name", sorted(upwash.__all__))
def test_a_public_name_is_there(name: str) -> None:
    assert getattr(upwash, name) is not None
    assert name in dir(upwash)


def test_a_name_that_there_is_not_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'simlate'"):
        getattr(upwash, "simlate")  # noqa: B009 - mypy finds the plain one


def test_what_a_type_checker_sees_is_what_is_imported_when_it_is_asked_for() -> None:
    tree = ast.parse((ROOT / "src" / "upwash" / "__init__.py").read_text())
    (guarded,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {
        alias.asname or alias.name: getattr(import_module(str(node.module)), alias.name)
        for node in guarded.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {name: getattr(upwash, name) for name in seen}


def test_importing_it_brings_only_its_errors() -> None:
    code = "import sys, upwash; print(*(name for name in sys.modules if name.startswith('upwash.')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    rooms = {name.split(".")[1] for name in done.stdout.split()}
    assert rooms == {"errors"}

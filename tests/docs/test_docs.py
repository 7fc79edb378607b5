"""What the documentation says is true: its links, its commands, its example."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import tomllib
from pathlib import Path

import msgspec
import pytest
from bench.results import FOLDER

from bench import promises
from upwash.cli.main import command_line
from upwash.config.daemon import read_daemon_config
from upwash.config.drone import (
    DroneConfig,
    FleetDroneConfig,
    MissionConfig,
    PolicyConfig,
    ServerConfig,
    ServiceConfig,
)
from upwash.config.drone_file import read_drone_config
from upwash.config.world import TruthConfig
from upwash.core.knowledge.servers import TRANSITIONS

KEYS_AND_REST = """
[keys]
authority = "a.pem"
certificate = "s1.pem"
key = "s1.key"
[[service]]
name = "detector"
[[server]]
name = "s1"
"""
ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_headings_lead_to_one(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", page.read_text()):
        linked = page.parent / target if target else page
        if linked.suffix == ".md":
            assert anchor in anchors(linked), f"{page.name} links to {target}#{anchor}"


def anchors(page: Path) -> set[str]:
    """The names of headings in addresses, as the site and GitHub make them; a second one of a name has "_1"."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = {anchor for pair in re.findall(r'id="([^"]+)"|\{ ?#([\w-]+)', text) for anchor in pair if anchor}
    for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE):
        words = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", heading)
        letters = re.sub(r"[^\w\s-]", "", words).strip().lower()
        name = re.sub(r"[-\s]+", "-", letters)
        found |= {
            f"{name}_{next(n for n in range(1, 99) if f'{name}_{n}' not in found)}" if name in found else name
        }
        found.add(re.sub(r"\s", "-", letters))
    return found


def test_every_page_is_on_all_pages() -> None:
    docs = ROOT / "docs"
    pages = {page.name for page in docs.glob("*.md")}  # site/decisions.py adds the decisions
    listed = set(re.findall(r"\(([\w./-]+\.md)", (docs / "pages.md").read_text()))
    assert len(pages) > 50
    assert pages - {*listed, "pages.md", "index.md"} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_that_are_named_exist(page: Path) -> None:
    for name in re.findall(r"\bdocs/[\w./-]+\.md", page.read_text()):
        assert (ROOT / name).exists(), f"{page.name} names {name}"


def test_the_page_of_the_event_log_says_what_the_types_say() -> None:
    page = runpy.run_path(str(ROOT / "site" / "event_log.py"))["page"]()
    assert page == (ROOT / "docs" / "event-log.md").read_text(), (
        "run make docs, or python site/event_log.py alone"
    )


@pytest.mark.parametrize("name", ["configuration", "commands", "safety_case"])
def test_the_references_say_what_the_code_says(name: str) -> None:
    written = runpy.run_path(str(ROOT / "site" / f"{name}.py"))
    assert written["page"]() == written["PAGE"].read_text(), f"run make docs, or python site/{name}.py alone"


def test_every_key_of_the_configurations_has_a_meaning() -> None:
    page = (ROOT / "docs" / "configuration-reference.md").read_text()
    keys = [line for line in page.splitlines() if line.startswith("| <span")]
    assert len(keys) > 150
    assert not [line for line in keys if line.endswith("|  |")]


def test_the_diagram_of_states_has_every_step_of_their_table(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    drawing = runpy.run_path(str(ROOT / "site" / "states.py"))
    steps = drawing["steps"]()
    drawn = {(before, trigger): after for (before, after), triggers in steps.items() for trigger in triggers}
    assert drawn == TRANSITIONS
    drawing["draw_states"](tmp_path / "states.png")
    assert (tmp_path / "states.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", promises.PAGES)
def test_measured_parts_are_what_the_results_say(name: str) -> None:
    page = (promises.DOCS / name).read_text()
    assert promises.with_results(page) == page, "run python -m bench.promises"


def test_every_result_that_is_kept_is_on_a_page() -> None:
    pages = "".join((promises.DOCS / name).read_text() for name in promises.PAGES)
    shown = set(re.findall(r"<!-- measured: (\w+) -->", pages))
    assert shown == promises.PARTS.keys() | promises.COLLECTED.keys()
    assert promises.PARTS.keys() >= {file.stem for file in FOLDER.glob("*.json")}
    assert promises.COLLECTED.keys() >= {folder.name for folder in FOLDER.iterdir() if folder.is_dir()}


def test_whoever_cites_upwash_names_its_version_and_license() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = (ROOT / "CITATION.cff").read_text()
    for key in ("version", "license"):
        assert f"\n{key}: {project[key]}\n" in cited
    assert all(f"  - name: {author['name']}\n" in cited for author in project["authors"])


def test_the_page_on_containers_shows_runtimes_that_are_understood(tmp_path: Path) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/containers.md").read_text(), flags=re.DOTALL)
    file = tmp_path / "server.toml"
    written, known = set[str](), set[str]()
    for block in blocks:
        table = "[runtime]" + block.partition("[runtime]")[2]
        text = (ROOT / "tests/config/daemon.toml").read_text().partition("[runtime]")[0] + table
        file.write_text(text + KEYS_AND_REST)
        runtime = read_daemon_config(file).runtime
        written |= set(re.findall(r"^#? ?(\w+) = ", table, flags=re.MULTILINE))
        known |= {
            name
            for table in (runtime, runtime.engine, runtime.network)
            for name in msgspec.structs.asdict(table)
        }
    of_processes = {"sandbox", "sandbox_as_root", "readable"}
    of_plug_ins = {"settings"}  # docs/plug-ins.md
    assert written == known - {"engine", "network"} - of_processes - of_plug_ins
    safety = (ROOT / "docs/server-safety.md").read_text()
    assert all(f"`runtime.{name}`" in safety for name in of_processes)


def test_every_command_is_documented_and_every_documented_command_exists() -> None:
    (choices,) = [
        action.choices for action in command_line()._actions if isinstance(action, argparse._SubParsersAction)
    ]
    written = "".join(page.read_text() for page in PAGES)
    documented = set(re.findall(r"(?:^ +|`)upwash ([a-z]+)", written, flags=re.MULTILINE))
    assert documented == set(choices)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_command_line_that_is_shown_is_understood(page: Path) -> None:
    text = re.sub(r"\\\n\s*", " ", page.read_text())
    fenced = "".join(re.findall(r"^```(?:sh)?\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))
    code = [*fenced.splitlines(), *re.findall(r"^ {4}(\S.*)$", text, flags=re.MULTILINE)]
    for line in code:
        command = re.split(r"\s{2,}|\s#|\s&", line)[0]  # what follows explains it, or is another command
        if re.match(r"(\S*/bin/)?upwash [a-z]", command):
            try:
                command_line().parse_args(shlex.split(command)[1:])
            except SystemExit:
                pytest.fail(f"{page.name} shows {command!r}")


def test_make_run_and_make_test_are_the_readmes_commands() -> None:
    readme, makefile = (ROOT / "README.md").read_text(), (ROOT / "Makefile").read_text()
    for command in ("run", "test"):
        assert re.search(rf"^    make {command}\b", readme, flags=re.MULTILINE)
        assert re.search(rf"^{command}:", makefile, flags=re.MULTILINE)
    for page in (readme, (ROOT / "docs/index.md").read_text()):
        (options,) = re.findall(r"^    make run ARGS=(.*)$", page, flags=re.MULTILINE)
        command_line().parse_args(["demo", *options.split()])


def test_the_configuration_page_shows_a_file_that_is_understood(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/configuration.md").read_text(), flags=re.DOTALL)
    file = tmp_path / "drone.toml"
    file.write_text(block)
    config = read_drone_config(file)
    assert config.name == "d1"
    assert config.camera is not None and config.network.interfaces == ("wlan1",)
    (service,), (server,) = config.services, config.servers
    assert (service.name, server.name) == ("detector", "s1")


def test_the_reference_has_every_key_of_a_drone() -> None:
    page = (ROOT / "docs/configuration-reference.md").read_text().partition("## The edge daemon")[0]
    written = set(re.findall(r"^\| <span id=[^>]*></span>`(\w+)` \|", page, flags=re.MULTILINE))
    tables = {*re.findall(r"^### `\[+([\w.]+)\]+`", page, flags=re.MULTILINE)}
    tables |= {name.rpartition(".")[2] for name in tables}
    kinds = (
        DroneConfig,
        FleetDroneConfig,
        MissionConfig,
        PolicyConfig,
        ServiceConfig,
        ServerConfig,
        TruthConfig,
    )
    for kind in kinds:
        known = set(kind.__struct_encode_fields__)
        assert known <= written | tables, f"not in the reference: {known - written - tables}"

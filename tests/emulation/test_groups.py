"""The control groups of an emulation, on trees of files that look like the kernel's."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.emulation import enclosure as groups
from upwash.emulation.enclosure import enter_groups, remove_groups

FIRST = {
    "cpu/cgroup.procs": "",
    "cpuset/cgroup.procs": "",
    "cpuset/cpuset.cpus": "0-1\n",
    "cpuset/cpuset.mems": "0\n",
}
SECOND = {"cgroup.procs": "", "system.slice/cgroup.procs": ""}


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(groups, "_ROOT", tmp_path)
    return tmp_path


def grow(tree: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)


def test_a_group_of_the_first_version_can_be_used_at_once(tree: Path) -> None:
    grow(tree, FIRST)
    (tree / "cpuacct").symlink_to("cpu")  # the same hierarchy by another name
    enter_groups("7:1")
    for group in ("upwash-emulation-7:1", "upwash-emulation-7:1/init.scope"):
        assert (tree / "cpuset" / group / "cpuset.cpus").read_text() == "0-1\n"
    for hierarchy in ("cpu", "cpuset"):
        assert (tree / hierarchy / "upwash-emulation-7:1/init.scope/cgroup.procs").read_text() == "0"


def test_the_second_version_has_one_hierarchy(tree: Path) -> None:
    grow(tree, SECOND)
    enter_groups("7:1")
    assert (tree / "upwash-emulation-7:1/init.scope/cgroup.procs").read_text() == "0"
    assert [each.name for each in (tree / "system.slice").iterdir()] == ["cgroup.procs"]


@pytest.mark.parametrize("version", [FIRST, SECOND], ids=["first", "second"])
def test_groups_of_those_who_are_gone_are_removed_and_no_others(tree: Path, version: dict[str, str]) -> None:
    grow(tree, version)
    hierarchies = [file.parent for file in tree.rglob("cgroup.procs") if file.parent.name != "system.slice"]
    for hierarchy in hierarchies:
        for owner in ("7:1", "8:2"):
            (hierarchy / f"upwash-emulation-{owner}/lxc.payload.s1/lxc.payload.c1").mkdir(parents=True)
        (hierarchy / "lxc.payload.of-others").mkdir()
    assert remove_groups("7:1".__eq__) == []
    for hierarchy in hierarchies:
        left = sorted(each.name for each in hierarchy.iterdir() if each.is_dir())
        assert {"lxc.payload.of-others", "upwash-emulation-8:2"} <= set(left)
        assert "upwash-emulation-7:1" not in left


def test_a_group_in_which_something_runs_is_named(tree: Path) -> None:
    grow(tree, SECOND)
    busy = tree / "upwash-emulation-7:1"
    grow(busy, {"lxc.payload.s1/held": ""})  # no folder with a file in it can be removed
    assert remove_groups("7:1".__eq__) == [busy]

"""The control groups of an emulation's containers, which are the one thing of theirs that their end leaves behind.

They are made below a group that is named after the command that owns the emulation, so that whoever cleans up finds
them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

_ROOT = Path("/sys/fs/cgroup")
_PREFIX = "upwash-emulation-"
_OF_PROCESS_1 = "init.scope"  # where systemd keeps its own: engines make containers' groups beside it
_HANDED_DOWN = ("cpuset.cpus", "cpuset.mems")  # by nobody but us, in the first version of control groups
# Outside of the group its processes' nice values count for nothing: it gets what four of nice value -10 would.
_AHEAD_OF_OTHERS = {"cpu.shares": 40 * 1024, "cpu.weight": 40 * 100}


def enter_groups(owner: str) -> None:
    """Moves this process, the first of its namespace, into groups of the owner's, where containers are made, too."""
    for hierarchy in _hierarchies():
        group = hierarchy
        for name in (_PREFIX + owner, _OF_PROCESS_1):
            group, parent = group / name, group
            group.mkdir()
            for setting in _HANDED_DOWN:
                if (parent / setting).exists():
                    (group / setting).write_text((parent / setting).read_text())
        (group / "cgroup.procs").write_text("0")  # itself
        for setting, weight in _AHEAD_OF_OTHERS.items():
            if (group.parent / setting).exists():
                (group.parent / setting).write_text(str(weight))


def remove_groups(is_gone: Callable[[str], bool]) -> list[Path]:
    """Removes the groups of owners that are gone; returns those that cannot be, as processes are in them yet."""
    gone = [group for group, owner in _groups() if is_gone(owner)]
    for group in gone:
        for each in (*sorted(_below(group), reverse=True), group):
            with contextlib.suppress(OSError):
                each.rmdir()
    return [group for group in gone if group.exists()]


def _groups() -> Iterator[tuple[Path, str]]:
    for hierarchy in _hierarchies():
        for group in hierarchy.glob(f"{_PREFIX}*"):
            yield group, group.name.removeprefix(_PREFIX)


def _below(group: Path) -> Iterator[Path]:
    return (each for each in group.rglob("*") if each.is_dir())


def _hierarchies() -> Iterator[Path]:
    """The one of the second version of control groups, or those of the first."""
    if (_ROOT / "cgroup.procs").exists():
        yield _ROOT
    elif _ROOT.exists():
        yield from (
            each
            for each in sorted(_ROOT.iterdir())
            if not each.is_symlink() and (each / "cgroup.procs").exists()
        )

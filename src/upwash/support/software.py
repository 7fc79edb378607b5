"""Which upwash this is, for results."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Software(NamedTuple):
    """The version, and the git commit of the checkout that runs or was installed; "" where they are not known."""

    version: str
    commit: str


@cache
def software() -> Software:
    """The upwash that runs."""
    from importlib.metadata import PackageNotFoundError, distribution  # some 20 modules

    try:
        installed = distribution("upwash")
    except PackageNotFoundError:
        return Software("", _checked_out(Path(__file__).parents[3]))
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    commit = origin.get("vcs_info", {}).get("commit_id") or _checked_out(Path(__file__).parents[3])
    return Software(installed.version, commit)


def _checked_out(folder: Path) -> str:
    """The commit of the repository in the folder, read from its files; "" for no repository."""
    git = folder / ".git"
    try:
        if git.is_file():  # of a further work tree
            git = folder / git.read_text().removeprefix("gitdir:").strip()
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        common = git / "commondir"
        shared = git / common.read_text().strip() if common.exists() else git
        if (shared / name).exists():
            return (shared / name).read_text().strip()
        packed = (shared / "packed-refs").read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    return next((line.split()[0] for line in packed if line.endswith(f" {name}")), "")

"""Draws the site's pictures at build time: with the project's own commands, and a server's states from their table.

A page asks for a picture in a comment, which other viewers of the page do not show:

    <!-- picture map.png: what it shows -->

An HTML page among them is linked to.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from posixpath import relpath
from tempfile import TemporaryDirectory

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
THESIS = str(ROOT / "scenarios" / "thesis.toml")
UPWASH = ("-m", "upwash")
COMMANDS = (
    (*UPWASH, "simulate", THESIS, "--figures", ".", "--log", "with.jsonl"),
    (*UPWASH, "simulate", THESIS, "--policy", "local-only", "--log", "without.jsonl"),
    (*UPWASH, "check", THESIS, "--figures", "."),
    (*UPWASH, "report", "with.jsonl", "without.jsonl", "-o", "report.html"),
    (*UPWASH, "reproduce", "--seeds", "1", "--figures", "."),
    (str(ROOT / "site" / "states.py"), "states.png"),
    (str(ROOT / "site" / "call_flow.py"), "call_flow.png"),
    ("-m", "bench.gains", "--figure", "gains.png"),
)
MADE = ("*.png", "report.html")

_ASKED_FOR = re.compile(r"<!-- picture ([\w.]+): (.+?) -->", re.DOTALL)
_LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#]+)(?:#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pictures, and the report that a page shows."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]  # bench/ is not installed
    with TemporaryDirectory(prefix="upwash-docs-") as folder:
        for command in COMMANDS:
            subprocess.run(
                [sys.executable, *command],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
                check=True,
                capture_output=True,
            )
        for pattern in MADE:
            for file in sorted(Path(folder).glob(pattern)):
                files.append(File.generated(config, f"pictures/{file.name}", content=file.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put pictures in place of the comments, and plain names in place of links that leave the site."""
    here = Path(page.file.src_uri).parent.as_posix()

    def show(asked: re.Match[str]) -> str:
        name, what = asked[1], " ".join(asked[2].split())
        if files.get_file_from_path(f"pictures/{name}") is None:
            raise PluginError(f"{page.file.src_uri} asks for the picture {name}, which no command draws")
        path = relpath(f"pictures/{name}", here)
        return f"![{what}]({path})\n*{what}*" if name.endswith(".png") else f"[{what}]({path})"

    def name(link: re.Match[str]) -> str:
        target = (Path(config.docs_dir) / here / link[2]).resolve()
        outside = not target.is_relative_to(Path(config.docs_dir).resolve())
        return f"{link[1]} (`{target.relative_to(ROOT)}`)" if outside else link[0]

    return _ASKED_FOR.sub(show, _LINK.sub(name, markdown))

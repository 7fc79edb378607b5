"""Draws the site's pictures at build time: with the project's own commands, and a server's states from their table.

A page asks for a picture in a comment, which other viewers of the page do not show:

    <!-- picture map.png: what it shows -->

An HTML page among them is linked to. All are drawn in this process, which imports what they need once.
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from posixpath import relpath
from tempfile import TemporaryDirectory

from bench.deployments import kept
from bench.deployments_figure import draw as draw_deployments
from bench.gains import figure as gains
from bench.gains.kept import TABLE, read
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from upwash.cli.exit_codes import ExitCode
from upwash.cli.main import main
from upwash.lab.figures import FigureFiles
from upwash.lab.reproduction.output import draw_figures

ROOT = Path(__file__).parents[1]
THESIS = str(ROOT / "scenarios" / "thesis.toml")
COMMANDS = (
    ("simulate", THESIS, "--figures", ".", "--log", "with.jsonl"),
    ("simulate", THESIS, "--policy", "local-only", "--log", "without.jsonl"),
    ("report", "with.jsonl", "without.jsonl", "-o", "report.html"),
)
DIAGRAMS = {"states": "draw_states", "call_flow": "draw_call_flow"}
MADE = ("*.png", "report.html")

_ASKED_FOR = re.compile(r"<!-- picture ([\w.]+): (.+?) -->", re.DOTALL)
_LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#]+)(?:#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pictures, and the report that a page shows."""
    with TemporaryDirectory(prefix="upwash-docs-") as folder:
        said = io.StringIO()
        with contextlib.chdir(folder), redirect_stdout(said), redirect_stderr(said):
            for command in COMMANDS:
                if main(command) != ExitCode.DONE:
                    raise PluginError(f"upwash {' '.join(command)} failed:\n{said.getvalue()}")
            for program, draw in DIAGRAMS.items():
                runpy.run_path(str(ROOT / "site" / f"{program}.py"))[draw](Path(f"{program}.png"))
            draw_figures(FigureFiles(Path()), seeds=1)
            gains.draw(read(TABLE), Path("gains.png"))
            draw_deployments(kept(), [Path("load.png")])
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
        return f"![{what}]({path}){{ .diagram }}\n*{what}*" if name.endswith(".png") else f"[{what}]({path})"

    def name(link: re.Match[str]) -> str:
        target = (Path(config.docs_dir) / here / link[2]).resolve()
        outside = not target.is_relative_to(Path(config.docs_dir).resolve())
        return f"{link[1]} (`{target.relative_to(ROOT)}`)" if outside else link[0]

    return _ASKED_FOR.sub(show, _LINK.sub(name, markdown))

"""Adds all pages of docs/decisions to the navigation and to the page of all pages, so that no list names them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page


def _decisions(docs: str) -> list[Path]:
    return sorted(Path(docs, "decisions").glob("*.md"))


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add them to the navigation, by their names."""
    pages = [f"decisions/{page.name}" for page in _decisions(config.docs_dir)]
    config.nav = [*(config.nav or []), {"Decisions": pages}]
    return config


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Add them to the page of all pages, by their titles."""
    if page.file.src_uri != "pages.md":
        return markdown
    titles = [
        (page.read_text().splitlines()[0].removeprefix("# "), page.name)
        for page in _decisions(config.docs_dir)
    ]
    return "\n".join(
        [markdown, "", "## Decisions", "", *(f"- [{title}](decisions/{name})" for title, name in titles)]
    )

"""Adds all pages of docs/decisions to the site's navigation, so that its list names none of them."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add them by their names."""
    folder = Path(config.docs_dir, "decisions")
    pages = sorted(page.name for page in folder.glob("*.md"))
    config.nav = [*(config.nav or []), {"Decisions": [f"decisions/{page}" for page in pages]}]
    return config

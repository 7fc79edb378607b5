"""Writes the words of all pages into search_words.js, which search.js looks through: no server, no network."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_HEADINGS = ("h1", "h2", "h3", "h4")
_BLOCKS = (*_HEADINGS, "p", "li", "td", "th", "pre", "div", "br")
_sections: list[list[str]] = []  # each with its address, the titles of its page and its own, and its text


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the script, and forget the pages of a build before."""
    _sections.clear()
    files.append(
        File.generated(config, "search.js", content=Path(__file__).with_name("search.js").read_text())
    )
    return files


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Note what the page says."""
    sections = _Sections()
    sections.feed(html)
    for anchor, title, text in sections.found:
        _sections.append([page.url + anchor, str(page.title), title, " ".join(text.split())])
    return html


def on_post_build(config: MkDocsConfig) -> None:
    """Write what was noted."""
    words = json.dumps(_sections, ensure_ascii=False, separators=(",", ":"))
    Path(config.site_dir, "search_words.js").write_text(f"searchWords({words});\n")


class _Sections(HTMLParser):
    """The sections of a page: anchor, title and text of each."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[list[str]] = []
        self._part = 2  # of the last section, that gets what is read: its title or its text
        self._is_link_to_itself = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in _HEADINGS:
            anchor = f"#{given['id']}" if tag != "h1" and given.get("id") else ""
            self.found.append([anchor, "", ""])
            self._part = 1
        self._is_link_to_itself = given.get("class") == "headerlink"

    def handle_endtag(self, tag: str) -> None:
        self._is_link_to_itself = False
        if tag in _HEADINGS:
            self._part = 2
        elif tag in _BLOCKS and self.found:
            self.found[-1][2] += " "

    def handle_data(self, data: str) -> None:
        if self.found and not self._is_link_to_itself:
            self.found[-1][self._part] += data

"""`make docs`: the pages become a site that needs nothing but itself, and what they show a newcomer works."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from tests.programs import ROOT, ended

from upwash.config import read_drone_config

DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; a link that leads nowhere, or a page that nothing leads to, fails the build."""
    folder = tmp_path_factory.mktemp("site")
    build = ["mkdocs", "build", "--quiet", "--strict", "-f", "site/mkdocs.yml", "-d", folder]
    built = ended([sys.executable, "-m", *build], ROOT, timeout_s=None)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.mark.long
def test_every_page_is_on_the_site(site: Path) -> None:
    pages = {page.relative_to(DOCS).with_suffix(".html") for page in DOCS.glob("**/*.md")}
    assert pages <= {page.relative_to(site) for page in site.glob("**/*.html")}


@pytest.mark.long
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for page in site.glob("**/*.html"):
        text = page.read_text()
        loaded = re.findall(r"<(?:script|img|link|iframe|source)\b[^>]*?(?:src|href)=\"?([^\"\s>]+)", text)
        assert loaded or page.name == "report.html"
        for target in loaded:
            assert not re.match(r"(https?:)?//", target), f"{page.name} loads {target}"
    for style in site.glob("**/*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", style.read_text()), style.name


@pytest.mark.long
def test_every_picture_that_a_page_asks_for_is_shown(site: Path) -> None:
    asked = 0
    for page in DOCS.glob("**/*.md"):
        built = site / page.relative_to(DOCS).with_suffix(".html")
        for name in re.findall(r"<!-- picture ([\w.]+):", page.read_text()):
            (target,) = set(
                re.findall(rf'(?:src|href)="([^"]*pictures/{re.escape(name)})"', built.read_text())
            )
            assert (built.parent / target).stat().st_size > 10_000
            asked += 1
    assert asked > 3
    assert "<!-- picture" not in "".join(page.read_text() for page in site.glob("**/*.html"))


def test_the_drone_of_the_raspberry_pi_is_understood(tmp_path: Path) -> None:
    (text,) = blocks("raspberry-pi.md", "toml")
    (tmp_path / "drone.toml").write_text(text)
    (tmp_path / "field.plan").write_text((ROOT / "tests/plans/field.plan").read_text())
    config = read_drone_config(tmp_path / "drone.toml")
    assert config.servers[0].network == "s1-net"
    assert config.network.interfaces == ("wlan1",)

"""`make docs`: the pages become a site that needs nothing but itself, and what they show a newcomer works."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image
from tests.programs import ROOT, ended
from tests.system.browser import Browser, browser, why_not

from upwash.config.drone_file import read_drone_config

DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; a link that leads nowhere, or a page that nothing leads to, fails the build."""
    folder = tmp_path_factory.mktemp("site")
    build = ["mkdocs", "build", "--quiet", "--strict", "-f", "site/mkdocs.yml", "-d", folder]
    built = ended([sys.executable, "-m", *build], ROOT)
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


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Browser]:
    if missing := why_not():
        pytest.skip(missing)
    with browser(tmp_path / "profile") as page:
        yield page


@pytest.mark.system
@pytest.mark.root
def test_the_search_finds_words_and_no_parts_of_words_in_a_file_too(site: Path, page: Browser) -> None:
    page.open((site / "decisions" / "clock.html").as_uri())

    def found(query: str) -> list[str]:
        field = page.find(".find input")
        field.clear()
        field.send_keys(query)
        page.wait_until(lambda: page.text(".found [role=status]"))
        marked = {word.lower() for word in page.each(".found mark", "each.textContent")}
        assert marked <= {*seen.get(query, marked)}
        return page.each(".found li strong", "each.textContent")

    seen = {
        "candidate": ("candidate", "candidates"),
        "did": ("did", "didn"),
        "hedg": ("hedg", "hedge", "hedged", "hedges", "hedging"),
        "fences": ("fence", "fences"),
        "lease": ("lease", "leases"),
        "nowhereatall": (),
    }
    assert found("candidate")
    assert found("did"), "though the word is in no title"
    assert found("hedg")[0] == "Hedging", "a title first, and a word that is not typed to its end"
    assert found("fences")[0] == "Fences"
    assert found("lease")[0] == "Lease", "a word of the glossary"
    assert found("nowhereatall") == []
    for query, answers in {
        "base map": "flight-page.html",
        "Pixhawk": "vehicle.html",
        "WLAN": "networks.html",
        "export findings": "report.html",
    }.items():
        assert found(query), "a word of the field, which no page may say"
        assert page.each(".found li a", "each.href")[0].endswith(f"/{answers}")
    assert not page.errors()
    field = page.find(".find input")
    field.clear()
    field.send_keys("fences\n")
    page.wait_until(lambda: page.driver.current_url.endswith("/flight-ends.html#fences"))


@pytest.mark.system
@pytest.mark.root
def test_a_diagram_is_bright_on_dark_ground_in_dark_colours(site: Path, page: Browser) -> None:
    for name in ("policies.html", "reproduction.html", "start.html"):
        page.open((site / name).as_uri(), scheme="dark")
        for diagram in page.all(".diagram"):
            page.run("arguments[0].scrollIntoView({block: 'center'})", diagram)  # else the window cuts it
            with Image.open(io.BytesIO(diagram.screenshot_as_png)) as picture:
                grey = sorted(picture.convert("L").tobytes())
            assert grey[len(grey) // 2] < 60, "its ground"
            assert grey[-len(grey) // 500] > 150, "what is drawn on it"


def test_the_drone_of_the_raspberry_pi_is_understood(tmp_path: Path) -> None:
    (text,) = blocks("small-computers.md", "toml")
    (tmp_path / "drone.toml").write_text(text)
    (tmp_path / "field.plan").write_text((ROOT / "tests/plans/field.plan").read_text())
    config = read_drone_config(tmp_path / "drone.toml")
    assert config.servers[0].network == "s1-net"
    assert config.network.interfaces == ("wlan1",)

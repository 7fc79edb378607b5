"""Writes the words of all pages into search_words.js, which search.js looks through: no server, no network."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_HEADINGS = ("h1", "h2", "h3", "h4")
_BLOCKS = (*_HEADINGS, "p", "li", "td", "th", "pre", "div", "br")
_sections: list[
    list[str]
] = []  # each with its address, the titles of its page and its own, its text, and what else
# Words of the field that a reader may search for, by the page that answers.
_ALSO = {
    "calls.md": "asynchronous async callback timeout compression downscale cascade",
    "cookbook.md": "examples recipes samples",
    "detector.md": "YOLO ONNX neural network model weights AI training",
    "findings.md": "georeference geolocation annotate review detections",
    "fleets.md": "swarm multiple drones UAVs multi-drone",
    "flight-ends.md": "failsafe RTL emergency abort geofence low battery crash",
    "flight-page.md": "base map basemap background map satellite tiles GCS dashboard live view",
    "missions.md": "waypoint script QGroundControl Mission Planner KML gimbal loudspeaker",
    "networks.md": "WLAN Wi-Fi hotspot access point SSID 4G LTE Starlink VPN WireGuard modem",
    "report.md": "export findings CSV GeoJSON Shapefile KML QGIS PDF spreadsheet DJI",
    "rows.md": "lawnmower transect mapping overlap GSD motion blur corridor",
    "server-safety.md": "TLS certificates encryption PKI security hacking",
    "servers.md": "installation Debian Ubuntu systemd service daemon edge computing",
    "services.md": "plug-in algorithm C++ Rust Java",
    "small-computers.md": "Raspberry Pi Jetson GPU CUDA companion computer",
    "troubleshooting.md": "error message FAQ help problem debug",
    "vehicle.md": "Pixhawk Cube flight controller FC MAVLink ArduPilot PX4 SITL USB UART",
    "worlds.md": "Monte Carlo what-if sensitivity",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the script, and forget the pages of a build before."""
    if gone := [page for page in _ALSO if files.get_file_from_path(page) is None]:
        raise PluginError(f"site/search.py has words for pages that there are not: {', '.join(gone)}")
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
        also = "" if anchor else _ALSO.get(page.file.src_uri, "")
        _sections.append([page.url + anchor, str(page.title), title, " ".join(text.split()), also])
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

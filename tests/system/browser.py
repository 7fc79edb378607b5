"""A headless Chromium that tests look at pages with, as Debian has it."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from tests.waiting import wait_for

from upwash.launch.processes import ready_program

AXE = Path(__file__).parent / "axe" / "axe.min.js"
_PROGRAMS = ("chromium", "chromedriver")
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-dev-shm-usage", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
_PATIENCE_S = 30.0
_SCRIPT_S = 90.0  # axe-core takes 4 s alone, and shares two processors with seven other tests
_LOADS_MOST = 5
Seen = TypeVar("Seen")


def why_not() -> str:
    """Why there is no browser here, empty if there is."""
    missing = [program for program in _PROGRAMS if shutil.which(program) is None]
    return f"{' and '.join(missing)} not installed" if missing else ""


NEEDED = [
    pytest.mark.system,
    pytest.mark.root,
    pytest.mark.xdist_group("browser"),
    pytest.mark.skipif(bool(why_not()), reason=why_not()),
]


class Browser:
    """A page in a window of some size; what goes wrong in it is kept by the browser until it is asked for."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver
        self._errors: list[str] = []

    def open(
        self, address: str, *, width: int = 1280, height: int = 900, scheme: str = "light", scale: int = 1
    ) -> None:
        """Opens the address in a window of that size, for somebody who prefers that colour scheme.

        Each CSS pixel is `scale` pixels wide. Where a network interface of the machine comes or goes, as with each
        container that another test starts, Chromium drops what it is loading: the page is then loaded again.
        """
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 500}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        self.prefer(scheme)
        for _ in range(_LOADS_MOST):
            self.errors()  # of the page before
            self.driver.get(address)
            self._errors = self.errors()
            if not any("ERR_NETWORK_CHANGED" in error for error in self._errors):
                return

    def prefer(self, scheme: str) -> None:
        """What the system prefers from now on: light or dark."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})

    def run(self, script: str, *arguments: object) -> Any:
        """What the script returns."""
        return self.driver.execute_script(script, *arguments)

    def find(self, selector: str, within: WebElement | None = None) -> WebElement:
        """The first element of that selector."""
        return (within or self.driver).find_element(By.CSS_SELECTOR, selector)

    def all(self, selector: str) -> list[WebElement]:
        """All elements of that selector."""
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def click(self, selector: str) -> None:
        """Clicks each element of that selector, in the middle of the window, where nothing lies above it."""
        for each in self.all(selector):
            self.run("arguments[0].scrollIntoView({block: 'center'})", each)
            each.click()

    def open_tab(self, name: str) -> None:
        """Opens a tab of what is beside the map: now, findings, servers, why, drones or flights."""
        self.click(f"#tab-{name}:not([aria-selected='true'])")
        self.drawn()

    def text(self, selector: str) -> str:
        """What the first element of that selector says, seen or not."""
        return str(self.run("return document.querySelector(arguments[0])?.textContent ?? ''", selector))

    def each(self, selector: str, script: str) -> list[Any]:
        """What the script, of the name `each`, makes of each element of that selector."""
        return list(
            self.run(f"return [...document.querySelectorAll(arguments[0])].map((each) => {script})", selector)
        )

    def rows(self, selector: str) -> list[list[str]]:
        """What the cells of a table's body say."""
        cells = "[...each.cells].map((cell) => cell.textContent.trim())"
        return self.each(f"{selector} tbody tr", cells)

    def drawn(self) -> None:
        """Waits until the page has drawn what it knows, which it does at its next frame."""
        self.run("return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def seek(self, at_s: float) -> None:
        """Moves the slider of a flight's page."""
        self.run(
            "const slider = document.getElementById('time'); slider.value = arguments[0];"
            "slider.dispatchEvent(new Event('input'));",
            at_s,
        )
        self.wait_for_moment(at_s)
        self.drawn()

    def wait_for_moment(self, at_s: float) -> None:
        """Waits until that second is shown."""
        self.wait_until(lambda: self.moment() == at_s)

    def moment(self) -> float:
        """The second of the mission that is shown."""
        return float(self.run("return document.getElementById('time').value"))

    def width(self) -> float:
        """How wide what it shows is."""
        return float(self.run("return document.documentElement.scrollWidth"))

    def too_small(self, selector: str, *, least_px: int = 24) -> list[str]:
        """Which of these are lower than fingers hit."""
        shown = self.each(
            selector,
            f"each.offsetParent && each.getBoundingClientRect().height < {least_px} && each.outerHTML",
        )
        return [each for each in shown if each]

    def wait_until(self, seen: Callable[[], Seen], *, within_s: float = _PATIENCE_S) -> Seen:
        """Waits until that is true, and returns it."""
        return wait_for(seen, within_s=within_s, seen=lambda: self.text("main")[:500])

    def errors(self) -> list[str]:
        """What the console complained about since it was asked last."""
        entries: list[dict[str, str]] = self.driver.get_log("browser")  # type: ignore[no-untyped-call]
        errors, self._errors = [*self._errors, *(entry["message"] for entry in entries)], []
        return errors

    def violations(self) -> list[str]:
        """What axe-core finds wrong with the page for people who do not see, hear or point."""
        self.driver.execute_cdp_cmd(
            "Runtime.evaluate", {"expression": AXE.read_text(encoding="utf-8")}
        )  # past the page's own policy, which lets nothing in
        found = self.driver.execute_async_script(
            "const done = arguments[arguments.length - 1];"
            "axe.run(document, {resultTypes: ['violations', 'incomplete']})"
            ".then((found) => done(JSON.stringify(found.violations)), (error) => done(String(error)))"
        )
        return [
            f"{violation['id']}: {node['html'][:200]}: {node['failureSummary']}"
            for violation in json.loads(found)
            for node in violation["nodes"]
        ]

    def elsewhere(self, address: str) -> Sequence[str]:
        """What the page loaded that is not of that address."""
        loaded = self.run("return performance.getEntriesByType('resource').map((entry) => entry.name)")
        return [name for name in loaded if not name.startswith(address)]


@contextlib.contextmanager
def view_of(*logs: Path | str) -> Iterator[str]:
    """The address of `upwash view` of the logs, with its options behind them, until the end of the block."""
    folder = Path(logs[0]).parent
    with ready_program("view", folder, "view", *map(str, logs), "--port", "0") as address:
        yield address


@contextlib.contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser that keeps what it has to in a folder of its own."""
    options = Options()
    options.binary_location = shutil.which("chromium") or ""
    for option in (*_OPTIONS, f"--user-data-dir={profile}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        driver.set_script_timeout(_SCRIPT_S)
        yield Browser(driver)
    finally:
        driver.quit()

"""Takes pictures of the pages: `make pictures`, or `python site/screenshots.py FOLDER`.

Chromium draws each page in each size, in light and dark colours. The pages show the demonstration and a survey
without gaps, flown with daemons and the detector, the moments that matter to a pilot, and simulated flights with good
and bad ends. `--keep` also updates docs/pictures, which the README and the documentation show.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import functools
import io
import itertools
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from msgspec.structs import replace
from PIL import Image
from tests.system import moments
from tests.system.browser import Browser, browser, why_not

from upwash.cli.demonstration import fly_demonstration, read_demonstration
from upwash.launch.processes import ready_program

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "docs" / "pictures"
SCENARIOS = ROOT / "scenarios"
STUCK = """
[autopilot]
on_failure = "hold"

[[fault]]
target = "autopilot"
kind = "stuck"
from_s = 40.0
"""
_HIGHEST_PX = 8_000  # of a picture of a whole page
_QUALITY = 80  # of a kept one, of 100
_CAME = """
return new Promise((done) => {
  let [before, sinceMs] = ["", 0];
  const look = setInterval(() => {
    const now = document.getElementById("time").max;
    if (now !== before) [before, sinceMs] = [now, performance.now()];
    const isOver = document.querySelector(".summary")?.textContent;
    if (now === "0" || !(isOver || performance.now() - sinceMs > 2500)) return; // a page that loads is drawn each 2 s
    clearInterval(look);
    done();
  }, 100);
});
"""
_COUNTING = """
window.imagesToCome = 0; // those that the page draws itself, such as photos on the map
window.Image = class extends Image {
  constructor() {
    super();
    window.imagesToCome += 1;
    for (const end of ["load", "error"]) this.addEventListener(end, () => (window.imagesToCome -= 1));
  }
};
"""
_SETTLED = "return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


@dataclass(frozen=True)
class Size:
    """A window in CSS pixels; `scale` is the number of pixels in a CSS pixel, 2 at a zoom of 200 %."""

    name: str
    width: int
    height: int
    scale: int = 1


@dataclass(frozen=True)
class Scene:
    """A page about the logs that `fly` writes into a folder; the flight is shown at that share of its time.

    A report, which does not move, is shown whole.
    """

    name: str
    fly: Callable[[Path], Sequence[Path]]
    share: float = 1.0
    is_report: bool = False


SIZES = (
    Size("1400", 1400, 900),
    Size("1920", 1920, 1080),
    Size("phone", 390, 844),
    Size("zoomed", 700, 450, scale=2),
)
SCHEMES = ("light", "dark")
BEST = {  # what docs/pictures has, by what it is taken from
    "live-1400-light": "live.webp",
    "live-1400-dark": "live-dark.webp",
    "alarm-1400-light": "alarm.webp",
}


def main() -> None:
    """Takes them."""
    parser = argparse.ArgumentParser(prog="python site/screenshots.py", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the pictures go")
    parser.add_argument("--only", default="", metavar="TEXT", help="only those with that in their name")
    parser.add_argument("--keep", action="store_true", help="make those in docs/pictures anew as well")
    options = parser.parse_args()
    if missing := why_not():
        sys.exit(f"no picture can be taken: {missing}")
    options.folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="upwash-pictures-") as folder, browser(Path(folder) / "profile") as page:
        page.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _COUNTING})
        for scene in SCENES:
            names = {
                f"{scene.name}-{size.name}-{scheme}": (size, scheme)
                for size, scheme in itertools.product(SIZES, SCHEMES)
            }
            chosen = {name: how for name, how in names.items() if options.only in name}
            if chosen:
                take(page, scene, Path(folder) / scene.name, options.folder, chosen)
    if options.keep:
        keep(options.folder)


def take(
    page: Browser, scene: Scene, folder: Path, into: Path, pictures: dict[str, tuple[Size, str]]
) -> None:
    """Flies the scene, and takes each of its pictures."""
    folder.mkdir()
    logs = [str(log) for log in scene.fly(folder)]
    if scene.is_report:
        upwash("report", *logs, "-o", str(folder / "report.html"))
        _take_all(page, scene, (folder / "report.html").as_uri(), into, pictures)
        return
    with ready_program("view", folder, "view", *logs, "--port", "0") as address:
        _take_all(page, scene, address, into, pictures)


def _take_all(
    page: Browser, scene: Scene, address: str, into: Path, pictures: dict[str, tuple[Size, str]]
) -> None:
    for name, (size, scheme) in pictures.items():
        page.open(address, width=size.width, height=size.height, scheme=scheme, scale=size.scale)
        if not scene.is_report:
            page.run(_CAME)
            _seek(page, scene.share)
        file = into / f"{name}.png"
        file.write_bytes(_picture(page, size, whole=scene.is_report))
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB", flush=True)


def _seek(page: Browser, share: float) -> None:
    page.run(
        "const slider = document.getElementById('time'); slider.value = slider.max * arguments[0];"
        "slider.dispatchEvent(new Event('input'));",
        share,
    )
    page.run(_SETTLED)
    page.wait_until(
        lambda: page.run(
            "return !window.imagesToCome && [...document.querySelectorAll('.photo:not([hidden]) img')].every("
            "(image) => !image.hidden && image.complete && image.naturalWidth)"
        )
    )
    page.run(_SETTLED)


def _picture(page: Browser, size: Size, *, whole: bool) -> bytes:
    height = size.height
    if whole:
        height = min(_HIGHEST_PX, int(page.run("return document.documentElement.scrollHeight")))
    clip = {"x": 0, "y": 0, "width": size.width, "height": height, "scale": 1}
    shot = page.driver.execute_cdp_cmd(
        "Page.captureScreenshot", {"format": "png", "clip": clip, "captureBeyondViewport": whole}
    )
    return base64.b64decode(shot["data"])


def keep(folder: Path) -> None:
    """Update the kept pictures from those in the folder."""
    KEPT.mkdir(exist_ok=True)
    for name, kept in BEST.items():
        with Image.open(folder / f"{name}.png") as picture:
            picture.convert("RGB").save(KEPT / kept, quality=_QUALITY, method=6)
        print(f"{KEPT / kept}: {(KEPT / kept).stat().st_size / 1000:.0f} kB")


# --- the flights --------------------------------------------------------------------------------------------


def upwash(*arguments: str, may_fail: bool = False) -> None:
    """Runs a command."""
    done = subprocess.run(
        [sys.executable, "-m", "upwash", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode != 0 and not may_fail:
        sys.exit(f"upwash {' '.join(arguments)}: {done.stderr.strip()}")


def demonstration(folder: Path) -> list[Path]:
    """With photos, daemons and the detector, in a minute and a half."""
    upwash("demo", "--folder", str(folder / "run"))
    return [folder / "run" / "events.jsonl"]


def survey(folder: Path) -> list[Path]:
    """The demonstration over a field, with photos that leave no gaps."""
    config = read_demonstration()
    rows = [[(10.0 * column, 8.0 * row) for column in range(5)] for row in range(6)]
    waypoints_m = [place for number, row in enumerate(rows) for place in row[:: -1 if number % 2 else 1]]
    s1, s2 = config.servers
    servers = (
        replace(s1, east_m=12.0, north_m=14.0, range_m=17.5),
        replace(s2, east_m=26.0, north_m=26.0, range_m=20.0),
    )
    closer = replace(config, mission=replace(config.mission, waypoints_m=tuple(waypoints_m)), servers=servers)
    run = folder / "solar-park"
    run.mkdir()
    with contextlib.redirect_stdout(io.StringIO()):
        fly_demonstration(run, closer, runtime="", live=None)
    return [run / "events.jsonl"]


def fleet(folder: Path) -> list[Path]:
    """Three drones that share servers."""
    upwash("simulate", str(SCENARIOS / "fleet-demonstration.toml"), "--log", str(folder / "flight.jsonl"))
    return sorted(folder.glob("flight*.jsonl"))


def stuck(folder: Path) -> list[Path]:
    """A vehicle that stops on its way, and is left hovering."""
    scenario = folder / "stuck.toml"
    scenario.write_text((SCENARIOS / "demonstration.toml").read_text() + STUCK)
    upwash("simulate", str(scenario), "--log", str(folder / "stuck.jsonl"), may_fail=True)
    return [folder / "stuck.jsonl"]


def thirty(folder: Path) -> list[Path]:
    """The thesis's mission with fifteen seeds under each of two policies."""
    policies = ("location-aware", "look-ahead")
    return [_thesis(folder, policy, seed, f"{policy}-{seed}") for policy in policies for seed in range(1, 16)]


def with_and_without(folder: Path) -> list[Path]:
    """The thesis's mission with offloading and without."""
    return [_thesis(folder, "location-aware", 1, "with"), _thesis(folder, "local-only", 1, "without")]


def many(folder: Path) -> list[Path]:
    """The thesis's mission with six seeds under each of two policies."""
    policies = ("location-aware", "opportunistic")
    return [_thesis(folder, policy, seed, f"{policy}-{seed}") for policy in policies for seed in range(1, 7)]


def _thesis(folder: Path, policy: str, seed: int, name: str) -> Path:
    log = folder / f"{name}.jsonl"
    upwash(
        "simulate", str(SCENARIOS / "thesis.toml"), "--policy", policy, "--seed", str(seed), "--log", str(log)
    )  # fmt: skip
    return log


SCENES = (
    Scene("live", survey, share=0.7),
    Scene("fleet", fleet, share=0.5),
    Scene("alarm", stuck),
    *(Scene(name, functools.partial(moments.write, name=name)) for name in moments.MOMENTS),
    Scene("long", moments.long_flight, share=0.7),
    Scene("ten-servers", moments.ten_servers, share=0.5),
    Scene("thirty-report", thirty, is_report=True),
    Scene("beside", with_and_without, share=0.4),
    Scene("report", with_and_without, is_report=True),
    Scene("demonstration-report", demonstration, is_report=True),
    Scene("many-report", many, is_report=True),
)


if __name__ == "__main__":
    main()

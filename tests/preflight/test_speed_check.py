"""What `upwash check` says of the ground speed of rows, against figures computed by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.surveys import transects, written

from upwash.cli.main import main

# Two rows of 80 m, 25 m apart. A photo is 1000 by 800 pixels; from 20 m a pixel shows 20 / 1000 m.
SCENARIO = """
[mission]
waypoints_m = [[0, 0], [80, 0], [80, 25], [0, 25]]
altitude_m = 20.0
ground_speed_m_s = 4.0
photos = { every_m = 10.0 }

[vehicle]
acceleration_m_s2 = 1.0

[camera]
photo_s = 0.5
focal_px = 1000.0
photo_px = [1000, 800]
exposure_s = 0.002

[policy]
name = "local-only"

[[service]]
name = "detector"
local_call_s = { light = 2.0, heavy = 5.0 }
"""


class Checked:
    def __init__(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.file, self._capsys = tmp_path / "drone.toml", capsys

    def __call__(self, *changes: tuple[str, str], text: str = SCENARIO) -> tuple[dict[str, Any], str, int]:
        """The object of --json, what a person reads, and the exit code."""
        for before, after in changes:
            assert before in text
            text = text.replace(before, after)
        self.file.write_text(text)
        self._capsys.readouterr()
        code = main(["check", str(self.file), "--json"])
        found = json.loads(self._capsys.readouterr().out)
        main(["check", str(self.file)])
        return found, self._capsys.readouterr().out, code


@pytest.fixture
def checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Checked:
    return Checked(tmp_path, capsys)


def test_four_limits_with_their_figures(checked: Checked) -> None:
    found, told, code = checked()
    speed = found["speed"]
    assert speed["ground_speed_m_s"] == 4.0 and speed["why"] == "" and code == 0
    assert speed["blur"]["pixel_m"] == pytest.approx(0.02)
    assert speed["blur"]["moved_px"] == pytest.approx(4.0 * 0.002 / 0.02)
    assert speed["blur"]["allows_m_s"] == pytest.approx(0.5 * 0.02 / 0.002)
    assert speed["overlap"]["photo_m"] == pytest.approx(800 * 0.02)
    assert speed["overlap"]["overlap"] == pytest.approx(1 - 10 / 16)
    assert speed["interval"] == {"between_s": 2.5, "photo_s": 0.5, "allows_m_s": 20.0}
    answers = speed["answers"]
    assert answers["photos_per_s"] == pytest.approx(8 / (80 / 4 + 4), rel=0.01)
    assert answers["answers_per_s"] == pytest.approx(1 / 5, rel=0.1)
    assert answers["keeps_up"] is False and answers["worlds"] == 1
    # 18 photos: the last answer is there 18 * 5 s after the first photo, which takes 0.5 s. The flight takes
    # 2 * (80 / 4 + 4) + 25 / 4 + 4 s, and 10 and 16 s for take-off and way home.
    assert answers["mission_time_s"] == pytest.approx(10 + 0.5 + 90 + 16)
    assert answers["waited_s"] == pytest.approx(90.5 - 58.25, abs=0.6)
    assert answers["mission_time_s"] == pytest.approx(found["predictions"][0]["mission_time_s"], rel=0.01)
    assert answers["most_open"] == 18 - int((58.25 - 0.5) / 5)
    assert (answers["stops"], answers["at_most"]) == (0, 100)
    assert [(row["row"], row["photos"]) for row in answers["rows"]] == [(0, 9), (1, 9)]
    for sentence in (
        "ground speed: 4 m/s, 1:5",
        "blur: the ground moves by 0.40 pixels of 20 mm during an exposure of 0.002 s; half a pixel allows 5 m/s",
        "overlap along a row: 38 %, a photo shows 16.0 m, and there is one every 10 m",
        "interval: a photo every 2.5 s; the camera takes 0.5 s, which allows 20 m/s",
        "they do not keep up. With at most 7 open of 100 (at_most), on row 1, the drone never stops for them; it "
        "waits for answers 32 s in all",
    ):
        assert sentence in told


@pytest.mark.parametrize(
    ("camera", "along_m"),
    [
        ("yaw_deg = 90.0", 20.0),  # its width lies along the flight
        ("yaw_deg = 180.0", 16.0),
        ("yaw_deg = 30.0", 16.0),  # the shorter side
    ],
)
def test_the_side_of_a_photo_along_the_flight_is_by_the_camera(
    checked: Checked, camera: str, along_m: float
) -> None:
    found, _, _ = checked(("[camera]", f"[camera]\n{camera}"))
    assert found["speed"]["overlap"]["photo_m"] == pytest.approx(along_m)


def test_a_field_of_view_needs_the_size_of_a_photo(checked: Checked) -> None:
    fov = ("focal_px = 1000.0", "fov_deg = 90.0")  # the photo is 40 m wide: a pixel of 4 cm
    found, _, _ = checked(fov)
    assert found["speed"]["blur"]["pixel_m"] == pytest.approx(0.04)
    assert found["speed"]["overlap"]["photo_m"] == pytest.approx(32.0)
    found, told, code = checked(fov, ("photo_px = [1000, 800]", ""))
    assert found["speed"]["blur"]["moved_px"] is None and found["speed"]["overlap"]["overlap"] is None
    assert "blur: unknown, as the size of a photo is unknown: give camera.photo_px" in told and code == 0


def test_what_is_unknown_is_named_with_its_key(checked: Checked) -> None:
    _, told, code = checked(("focal_px = 1000.0", ""), ("exposure_s = 0.002", ""))
    lens = "the lens is unknown: give camera.fov_deg and camera.photo_px"
    assert f"blur: unknown, as {lens}; the exposure is unknown: give camera.exposure_s" in told
    assert f"overlap along a row: unknown, as {lens}" in told
    assert code == 0, "nothing to warn of"


def test_blur_and_gaps_are_warned_of_and_not_refused(
    checked: Checked, capsys: pytest.CaptureFixture[str]
) -> None:
    found, told, code = checked(
        ("exposure_s = 0.002", "exposure_s = 0.006"), ("every_m = 10.0", "every_m = 20.0")
    )
    assert [warning["kind"] for warning in found["warnings"]] == ["blur", "gaps"] and code == 1
    assert "the ground moves by 1.2 pixels during an exposure of 0.006 s: at 3.3 m/s it is one pixel" in told
    assert "a photo shows 16.0 m of a row, so that one every 20 m leaves gaps of 4.0 m" in told
    assert found["speed"]["overlap"]["overlap"] == pytest.approx(-0.25)
    assert main(["fly", "--config", str(checked.file)]) == 2, "it has no vehicle"
    warned = capsys.readouterr().err
    assert "warning: the ground moves by 1.2 pixels" in warned and "leaves gaps of 4.0 m" in warned
    found, _, code = checked(("exposure_s = 0.002", "exposure_s = 0.004"))
    assert code == 0, "0.8 pixels are told, and not warned of"


def test_a_chosen_speed_is_told_with_its_reason_and_is_flown(checked: Checked) -> None:
    found, told, code = checked(("ground_speed_m_s = 4.0", 'speed = "auto"'))
    speed = found["speed"]
    assert f"ground speed: {speed['why']}" in told and code == 0
    assert (
        "by forecast: blur allows 5, the camera 20, mission.ground_speed_m_s 10; 5 m/s takes" in speed["why"]
    )
    assert speed["ground_speed_m_s"] <= 5.0
    time_s = found["predictions"][0]["mission_time_s"]
    assert time_s == pytest.approx(speed["answers"]["mission_time_s"], rel=0.01)


def test_a_given_speed_is_told_the_chosen_one_where_that_is_much_quicker(checked: Checked) -> None:
    slow = ("ground_speed_m_s = 4.0", "ground_speed_m_s = 1.0")
    found, told, _ = checked(slow)
    assert found["speed"]["auto"] and f'mission.speed = "auto" would choose {found["speed"]["auto"]}' in told
    assert checked()[0]["speed"]["auto"] == ""


@pytest.mark.parametrize("more", ["", "[event]\nevery = 5\n"], ids=["no demand", "demands"])
@pytest.mark.parametrize("turn_m", [20.0, 0.0])
def test_of_a_survey_it_tells_the_worst_leg_and_forecasts_what_is_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], turn_m: float, more: str
) -> None:
    camera = "\n[camera]\nfocal_px = 1000.0\nphoto_px = [1000, 800]\nexposure_s = 0.002\n"
    file = written(tmp_path, transects(turn_m), more=more)  # 25 m above home, at 4 m/s
    file.write_text(file.read_text().replace("[camera]\n", camera))
    main(["check", str(file), "--json"])
    found = json.loads(capsys.readouterr().out)
    speed = found["speed"]
    assert speed["ground_speed_m_s"] == 4.0 and speed["auto"] == ""
    assert speed["blur"]["moved_px"] == pytest.approx(4 * 0.002 / 0.025)
    assert speed["overlap"]["overlap"] == pytest.approx(1 - 20 / (800 * 0.025))
    assert speed["interval"]["between_s"] == pytest.approx(20 / 4)
    assert speed["answers"]["mission_time_s"] == pytest.approx(
        found["predictions"][0]["mission_time_s"], abs=0.5
    )


def test_missions_that_stop_have_no_limits(checked: Checked) -> None:
    found, told, _ = checked(("photos = { every_m = 10.0 }", ""))
    assert "speed" not in found and "ground speed" not in told

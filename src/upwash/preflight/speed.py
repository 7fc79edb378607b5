"""What is known before take-off of the ground speed of a mission of rows: four limits, each with its figures."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct
from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import FASTEST_M_S
from upwash.config.plan_photos import PhotoLeg, photo_legs
from upwash.drone.speed import SHARP_PX, photo_ground
from upwash.errors import UpwashError
from upwash.lab.flown_rows import RowAnswers, RowForecast
from upwash.lab.run import simulate
from upwash.lab.speed import chosen_speed, forecast_speed
from upwash.support.text import counted, lasting

_QUICKER = 0.95
_TRIED = 4  # speeds, before one is called quicker


class Blur(Struct, frozen=True, kw_only=True):
    """How far the ground moves in a photo during its exposure; half a pixel `allows_m_s`."""

    exposure_s: float | None = None
    pixel_m: float | None = None
    moved_px: float | None = None
    allows_m_s: float | None = None
    unknown: str = ""


class Overlap(Struct, frozen=True, kw_only=True):
    """The share of a photo that the next one on the row shows too; below 0 there are gaps."""

    every_m: float
    photo_m: float | None = None
    overlap: float | None = None
    unknown: str = ""


class Interval(Struct, frozen=True, kw_only=True):
    """The time from one photo to the next at full speed; None where the camera takes no time."""

    between_s: float
    photo_s: float
    allows_m_s: float | None


class Answers(Struct, frozen=True, kw_only=True):
    """Photos taken a second on the rows, and answers that came, in the world that the drone believes in.

    The drone stops `stops` times for answers, as `at_most` may be open, and waits for them `waited_s` in all, with
    the wait before the way home.
    """

    photos_per_s: float
    answers_per_s: float
    keeps_up: bool
    most_open: int
    at_most: int
    stops: int
    waited_s: float
    mission_time_s: float
    worlds: int
    rows: tuple[RowAnswers, ...]


class SpeedCheck(Struct, frozen=True, kw_only=True):
    """The ground speed against its limits; `why` it was chosen, "" for a speed that is given.

    For a given speed, `auto` is the choice of `mission.speed = "auto"` where that saves 5 % or more.
    """

    ground_speed_m_s: float
    why: str
    auto: str
    blur: Blur
    overlap: Overlap
    interval: Interval
    answers: Answers | None
    no_answers: str = ""


def check_speed(config: DroneConfig, why: str) -> SpeedCheck | None:
    """The check of a mission that takes photos in flight; None for a mission that stops.

    Of a plan, each figure is that of the worst leg, and the ground speed is the highest with photos.
    """
    photos, legs, photo_s = config.mission.photos, photo_legs(config.mission), config.camera.photo_s
    if photos is None or not legs:
        return None
    forecast, no_answers = None, ""
    try:
        forecast = forecast_speed(config, simulate)
    except UpwashError as error:
        no_answers = str(error)
    closest = min(legs, key=lambda leg: leg.step_m / leg.ground_speed_m_s)
    is_free = config.mission.plan is None and photos.every_s is None
    return SpeedCheck(
        ground_speed_m_s=max(leg.ground_speed_m_s for leg in legs),
        why=why,
        auto="" if why or forecast is None or not is_free else _quicker(config, forecast),
        blur=_blur(config, max(legs, key=lambda leg: leg.ground_speed_m_s / leg.altitude_m)),
        overlap=_overlap(config, max(legs, key=lambda leg: leg.step_m / leg.altitude_m)),
        interval=Interval(
            between_s=closest.step_m / closest.ground_speed_m_s,
            photo_s=photo_s,
            allows_m_s=closest.step_m / photo_s if photo_s > 0 and photos.every_s is None else None,
        ),
        answers=None if forecast is None else _answers(forecast, photos.at_most),
        no_answers=no_answers,
    )


def _quicker(config: DroneConfig, given: RowForecast) -> str:
    mission = replace(config.mission, speed="auto", ground_speed_m_s=FASTEST_M_S)
    chosen = chosen_speed(replace(config, mission=mission), simulate, most=_TRIED)
    found = chosen.forecast
    return chosen.why if found is not None and found.mission_s <= _QUICKER * given.mission_s else ""


def _blur(config: DroneConfig, leg: PhotoLeg) -> Blur:
    ground, exposure_s = photo_ground(config, leg.altitude_m), config.camera.exposure_s
    unknown = [ground.why_no_pixel, "" if exposure_s else "the exposure is unknown: give camera.exposure_s"]
    if ground.pixel_m is None or exposure_s is None:
        return Blur(exposure_s=exposure_s, pixel_m=ground.pixel_m, unknown="; ".join(filter(None, unknown)))
    return Blur(
        exposure_s=exposure_s,
        pixel_m=ground.pixel_m,
        moved_px=leg.ground_speed_m_s * exposure_s / ground.pixel_m,
        allows_m_s=SHARP_PX * ground.pixel_m / exposure_s,
    )


def _overlap(config: DroneConfig, leg: PhotoLeg) -> Overlap:
    ground = photo_ground(config, leg.altitude_m)
    if ground.along_m is None:
        return Overlap(every_m=leg.step_m, unknown=ground.why_no_length)
    return Overlap(every_m=leg.step_m, photo_m=ground.along_m, overlap=1 - leg.step_m / ground.along_m)


def _answers(forecast: RowForecast, at_most: int) -> Answers:
    return Answers(
        photos_per_s=forecast.photos_per_s,
        answers_per_s=forecast.answers_per_s,
        keeps_up=forecast.keeps_up,
        most_open=forecast.most_open,
        at_most=at_most,
        stops=forecast.stops,
        waited_s=forecast.waited_s,
        mission_time_s=forecast.mission_s,
        worlds=forecast.worlds,
        rows=forecast.rows,
    )


def told_speed(found: SpeedCheck) -> Iterator[str]:
    """The check in sentences."""
    given = f"{found.ground_speed_m_s:g} m/s"
    if found.answers is not None:
        given += f", {lasting(found.answers.mission_time_s)} by forecast"
    yield f"ground speed: {found.why or given}"
    if found.auto:
        yield f'mission.speed = "auto" would choose {found.auto}'
    yield f"blur: {_told_blur(found.blur)}"
    yield f"overlap along a row: {_told_overlap(found.overlap)}"
    interval = found.interval
    limit = "" if interval.allows_m_s is None else f", which allows {interval.allows_m_s:.3g} m/s"
    yield f"interval: a photo every {interval.between_s:.2g} s; the camera takes {interval.photo_s:g} s{limit}"
    answers = found.answers
    yield f"answers: {f'unknown, as {found.no_answers}' if answers is None else _told_answers(answers)}"


def _told_blur(blur: Blur) -> str:
    if blur.moved_px is None or blur.pixel_m is None or blur.allows_m_s is None:
        return f"unknown, as {blur.unknown}"
    return (
        f"the ground moves by {blur.moved_px:.2f} pixels of {1000 * blur.pixel_m:.3g} mm during an exposure of "
        f"{blur.exposure_s:g} s; half a pixel allows {blur.allows_m_s:.3g} m/s"
    )


def _told_overlap(overlap: Overlap) -> str:
    if overlap.overlap is None or overlap.photo_m is None:
        return f"unknown, as {overlap.unknown}"
    shows = f"a photo shows {overlap.photo_m:.1f} m, and there is one every {overlap.every_m:g} m"
    if overlap.overlap < 0:
        return f"none, {shows}: gaps of {overlap.every_m - overlap.photo_m:.1f} m"
    return f"{100 * overlap.overlap:.0f} %, {shows}"


def _told_answers(answers: Answers) -> str:
    keeps = "they keep up" if answers.keeps_up else "they do not keep up"
    fullest = max(answers.rows, key=lambda row: row.most_open)
    stops = "never stops" if not answers.stops else f"stops {counted(answers.stops, 'time')}"
    flown = "" if answers.worlds == 1 else f" (the mean of {answers.worlds} worlds, and one of them)"
    return (
        f"on the rows {answers.photos_per_s:.2g} photos a second are taken, and {answers.answers_per_s:.2g} "
        f"answered: {keeps}. With at most {answers.most_open} open of {answers.at_most} (at_most), on row "
        f"{fullest.row}, the drone {stops} for them; it waits for answers {answers.waited_s:.0f} s in all{flown}"
    )

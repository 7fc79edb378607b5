"""What the driver makes of a dead man's parameters and files in an autopilot, and what its heartbeats promise."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import SYSTEM, scripted
from tests.ports.test_files import Files

from upwash.core.geo import Position
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused, AutopilotTimeout
from upwash.real.mavlink.dead_man import FILE, GOODBYE, SILENCE_S, VERSION, promise, script
from upwash.sim.loop import run_virtually

SCRIPTING_ON, SCRIPTING = "SCR_ENABLE", 42701
RUNNING, TEXT = float(script()[0]), script()[1]
HERE = Position(30.0, 40.0, 10.0)


class Scripting(Files):
    """An ArduCopter in which the script runs, unless a test changes its parameters."""

    def __init__(self, *, armed: bool) -> None:
        super().__init__(armed=armed)
        self.parameters |= {VERSION: RUNNING, SCRIPTING_ON: 1.0, SILENCE_S: 0.0}
        self.confirms: float | None = 0.0  # the script tells the promise, and this more; None: it tells none
        self.starts_after_s = 0.0

    def words(self) -> list[int]:
        """The promises of the driver's heartbeats, without repetitions."""
        words = [message.custom_mode for message in self.of_kind("HEARTBEAT")]
        return [word for word, before in zip(words, [None, *words], strict=False) if word != before]

    def _answer(self, message: Any) -> None:
        match message.get_type():
            case "PARAM_SET":
                self.parameters[message.param_id] = message.param_value
            case "HEARTBEAT" if message.custom_mode and self.confirms is not None:
                self.parameters[SILENCE_S] = (message.custom_mode & 8191) / 10 + self.confirms
        super()._answer(message)

    def _obey(self, message: Any, result: int | None) -> None:
        super()._obey(message, result)
        if message.command == SCRIPTING:
            asyncio.get_running_loop().call_later(self.starts_after_s, self.run)

    def run(self) -> None:
        self.parameters[VERSION] = RUNNING


def tell(story: Callable[[Scripting], Awaitable[None]], *, flies: bool = False) -> None:
    async def live() -> None:
        async with scripted(kind=Scripting, armed=flies) as vehicle:
            assert isinstance(vehicle, Scripting)
            if flies:
                await vehicle.resumed(HERE)
            else:
                await vehicle.autopilot.claim(resumes=False)
            await story(vehicle)

    run_virtually(live())


def test_its_version_is_a_number_that_a_parameter_holds_exactly() -> None:
    assert struct.unpack("<f", struct.pack("<f", RUNNING)) == (RUNNING,)


@pytest.mark.parametrize(
    ("silence_s", "tenths"), [(0.1, 1), (0.19, 1), (20.0, 200), (819.1, 8191), (0.05, None), (819.2, None)]
)
def test_a_promise_has_tenths_of_a_second(silence_s: float, tenths: int | None) -> None:
    if tenths is None:
        with pytest.raises(ValueError, match="cannot be promised"):
            promise(silence_s, "land")
    else:
        assert promise(silence_s, "land") == 0x5550 << 16 | 2 << 13 | tenths


# --- whether it is there ------------------------------------------------------------------------------------

INSTALL = "install it with: upwash check CONFIG --install-dead-man"


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({}, ""),
        ({SCRIPTING_ON: None}, ""),  # it runs
        ({VERSION: None, SCRIPTING_ON: None}, "the autopilot has no parameter SCR_ENABLE"),
        (
            {VERSION: None, SCRIPTING_ON: math.nan},
            "the vehicle says that its SCR_ENABLE is nan, which makes no sense",
        ),
        ({VERSION: None, SCRIPTING_ON: 0.0}, f"(SCR_ENABLE is 0), and so the dead man; {INSTALL}"),
        ({VERSION: None}, f"the dead man is not in the autopilot, or was not started; {INSTALL}"),
        ({VERSION: math.nan}, f"the vehicle says that its {VERSION} is nan"),
        ({VERSION: 12.0}, f"the dead man in the autopilot is of another version of upwash; {INSTALL}"),
    ],
)
@played(tell)
async def test_why_it_cannot_be_used(
    vehicle: Scripting, *, changed: dict[str, float | None], why: str
) -> None:
    change(vehicle, changed)
    told = await vehicle.autopilot.dead_man.missing()
    assert why in told
    assert bool(why) == bool(told)


def change(vehicle: Scripting, changed: dict[str, float | None]) -> None:
    for name, value in changed.items():
        vehicle.parameters.pop(name)
        vehicle.parameters |= {} if value is None else {name: value}


# --- installing it ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("directories", "there", "folder"),
    [
        ({"scripts"}, b"", "scripts"),
        ({"APM"}, b"", "APM/scripts"),
        ({"APM"}, b"an older one", "APM/scripts"),
        ({"scripts"}, TEXT, "scripts"),
    ],
)
@played(tell)
async def test_the_script_is_written_where_the_autopilot_looks_for_it(
    vehicle: Scripting, *, directories: set[str], there: bytes, folder: str
) -> None:
    path = f"{folder}/{FILE}"
    vehicle.directories, vehicle.content = directories, {path: there} if there else {}
    assert await vehicle.autopilot.dead_man.install() == ""
    assert vehicle.content == {path: TEXT}
    assert [request.data.decode() for request in vehicle.asked[:2]] == ["APM", folder]
    assert ("CREATE_FILE" in vehicle.opcodes()) == (there != TEXT)
    assert vehicle.commands(SCRIPTING) == [], "it runs already"


@pytest.mark.parametrize(("starts_after_s", "starts"), [(0.0, True), (14.0, True), (16.0, False)])
@played(tell)
async def test_the_scripts_are_started_anew_for_another_version(
    vehicle: Scripting, *, starts_after_s: float, starts: bool
) -> None:
    vehicle.parameters[VERSION], vehicle.starts_after_s = 12.0, starts_after_s
    begun_s = vehicle.now_s
    installing = asyncio.ensure_future(vehicle.autopilot.dead_man.install())
    if starts:
        assert await installing == ""
        assert vehicle.now_s - begun_s == pytest.approx(starts_after_s, abs=0.31)
    else:
        with pytest.raises(AutopilotTimeout, match=r"uploaded and did not start; switch .* off and on"):
            await installing
        assert vehicle.now_s - begun_s == pytest.approx(15.0, abs=0.31)
    (order,) = vehicle.commands(SCRIPTING)
    assert (order.get_type(), order.param1, order.target_system) == ("COMMAND_INT", 3.0, SYSTEM)
    assert (order.x, order.y, order.z) == (0, 0, 0.0)


@played(tell)
async def test_the_autopilots_words_of_the_last_minute_come_with_the_timeout(vehicle: Scripting) -> None:
    def said(text: bytes) -> Any:
        return mavlink.MAVLink_statustext_message(3, text)

    await vehicle.say(said(b"too old"))
    await asyncio.sleep(46.0)
    await vehicle.say(said(b"Lua: out of memory"))
    vehicle.parameters[VERSION], vehicle.starts_after_s = 12.0, 60.0
    with pytest.raises(AutopilotTimeout) as caught:
        await vehicle.autopilot.dead_man.install()
    assert caught.value.vehicle_said == "Lua: out of memory (error)"


@played(tell)
async def test_scripting_that_is_off_is_switched_on(vehicle: Scripting) -> None:
    change(vehicle, {SCRIPTING_ON: 0.0, VERSION: None})
    done = await vehicle.autopilot.dead_man.install()
    assert "scripting was switched on (SCR_ENABLE is 1)" in done and "switch the autopilot off and on" in done
    assert vehicle.parameters[SCRIPTING_ON] == 1.0
    assert vehicle.content[f"scripts/{FILE}"] == TEXT
    assert vehicle.commands(SCRIPTING) == []


@played(tell)
async def test_nothing_is_uploaded_without_scripting(vehicle: Scripting) -> None:
    change(vehicle, {SCRIPTING_ON: None, VERSION: None})
    with pytest.raises(AutopilotRefused, match="has no parameter SCR_ENABLE"):
        await vehicle.autopilot.dead_man.install()
    assert vehicle.asked == []


@pytest.mark.parametrize("ours", [True, False])
@played(tell)
async def test_nothing_is_uploaded_to_a_vehicle_that_is_armed(vehicle: Scripting, *, ours: bool) -> None:
    if ours:
        vehicle.autopilot.vehicle.latch.expect_armed(True)
    await vehicle.beat(armed=True)
    with pytest.raises(AutopilotRefused if ours else AutopilotOverruled):
        await vehicle.autopilot.dead_man.install()
    assert vehicle.asked == []


# --- watching -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("confirms", "watched"), [(0.0, True), (0.04, True), (-0.04, True), (0.06, False), (None, False)]
)
@played(tell)
async def test_it_is_set_once_the_script_tells_the_silence(
    vehicle: Scripting, *, confirms: float | None, watched: bool
) -> None:
    vehicle.confirms, begun_s = confirms, vehicle.now_s
    setting = asyncio.ensure_future(vehicle.autopilot.dead_man.watch(silence_s=20.07, action="return"))
    if watched:
        await setting
        assert vehicle.now_s - begun_s == pytest.approx(0.3, abs=0.01)
    else:
        with pytest.raises(AutopilotTimeout, match=r"it did not take 20\.07 s"):
            await setting
        assert vehicle.now_s - begun_s == pytest.approx(8 * 0.3, abs=0.01)
    assert vehicle.words() == [0, promise(20.0, "return")]


@played(tell)
async def test_it_is_not_set_in_an_autopilot_without_it(vehicle: Scripting) -> None:
    change(vehicle, {VERSION: None})
    with pytest.raises(AutopilotRefused, match="was not started"):
        await vehicle.autopilot.dead_man.watch(silence_s=20.0, action="return")
    begun_s = vehicle.now_s
    await vehicle.autopilot.dead_man.release()
    assert vehicle.now_s == begun_s, "nothing confirms a goodbye"


@pytest.mark.parametrize(("confirms", "goodbyes"), [(0.0, 1), (None, 3)])
@played(tell)
async def test_a_goodbye_is_repeated_until_the_script_has_heard_it(
    vehicle: Scripting, *, confirms: float | None, goodbyes: int
) -> None:
    await vehicle.autopilot.dead_man.watch(silence_s=20.0, action="return")
    vehicle.confirms, begun_s = confirms, vehicle.now_s
    await vehicle.autopilot.dead_man.release()
    assert vehicle.words()[-1] == GOODBYE
    assert vehicle.now_s - begun_s == pytest.approx(goodbyes * 0.3, abs=0.01)
    assert len(vehicle.of_kind("HEARTBEAT", begun_s)) >= 1 + goodbyes


@played(tell)
async def test_without_a_promise_there_is_no_goodbye(vehicle: Scripting) -> None:
    begun_s = vehicle.now_s
    await vehicle.autopilot.dead_man.release()
    assert vehicle.words() == [0] and vehicle.now_s == begun_s
    vehicle.confirms = None
    with pytest.raises(AutopilotTimeout):
        await vehicle.autopilot.dead_man.watch(silence_s=20.0, action="return")
    begun_s = vehicle.now_s
    await vehicle.autopilot.dead_man.release()
    assert vehicle.words()[-1] == GOODBYE and vehicle.now_s == begun_s, "the script never took the promise"


@pytest.mark.parametrize(
    ("silence_s", "silent_s", "suspected"),
    [(20.0, 17.9, False), (20.0, 18.1, True), (3.0, 2.4, False), (3.0, 2.6, True), (None, 60.0, False)],
)
@played(tell, flies=True)
async def test_after_a_silence_of_nearly_that_length_the_dead_man_may_have_acted(
    vehicle: Scripting, *, silence_s: float | None, silent_s: float, suspected: bool
) -> None:
    await vehicle.autopilot.dead_man.watch(silence_s=silence_s or 20.0, action="return")
    if silence_s is None:
        await vehicle.autopilot.dead_man.release()
    vehicle.mute = True
    await vehicle.beat()
    await asyncio.sleep(silent_s)
    await vehicle.beat(mode=mavlink.COPTER_MODE_RTL)
    control = vehicle.autopilot.control
    assert (control.owner is Owner.FAILSAFE) is suspected
    if suspected:
        assert f"its dead man, after {silent_s:.0f} s without a link" in control.why


@played(tell, flies=True)
async def test_a_vehicle_that_is_lost_to_a_pilot_gets_a_goodbye(vehicle: Scripting) -> None:
    await vehicle.autopilot.dead_man.watch(silence_s=20.0, action="land")
    await vehicle.beat(mode=mavlink.COPTER_MODE_LOITER)
    await asyncio.sleep(1.5)
    assert vehicle.words() == [0, promise(20.0, "land"), GOODBYE]

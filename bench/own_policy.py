"""What a question to a policy of one's own costs: `python -m bench.own_policy`.

The policy is the built-in look-ahead in a file of its own. The bench calls it in turns: directly, in a thread of the
same program (as before own policies had processes), and in its process. The question is that of a drone among 8
servers, 20 calls ahead. Times are real; a ratio compares the medians of one turn.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from statistics import median
from typing import Any

from bench.program import command_line, machine

from upwash.config.drone import PolicyConfig
from upwash.core.geo import Circle, Position
from upwash.core.planning.forecast import Forecast
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer
from upwash.core.policies.look_ahead import HORIZON, LookAhead
from upwash.core.policies.policy import Choice, Option, Situation
from upwash.drone.own_policy import policy_of

MINE = "from upwash.policies import LookAhead\n\n\nclass Mine(LookAhead):\n    pass\n"
SERVERS = 8
TURNS, QUESTIONS = 9, 300
QUICK_TURNS, QUICK_QUESTIONS = 1, 20
Ask = Callable[[Situation], Choice]


def main() -> None:
    """Measures and prints."""
    quick = command_line("own_policy", __doc__).parse_args().quick
    turns, questions = (QUICK_TURNS, QUICK_QUESTIONS) if quick else (TURNS, QUESTIONS)
    asked, situation = _ways(), _situation()
    for ask in asked.values():
        ask(situation)
    times_us: dict[str, list[float]] = {name: [] for name in asked}
    for _ in range(turns):
        for name, ask in asked.items():
            times_us[name].append(median(_took_us(ask, situation) for _ in range(questions)))
    print(f"{SERVERS} servers, {HORIZON} calls ahead, {turns} turns of {questions} questions; {machine()}")
    for name, each_us in times_us.items():
        print(
            f"{name:22s} median {median(each_us):6.0f} us, of a turn {min(each_us):.0f} to {max(each_us):.0f}"
        )
    pairs = zip(times_us["in a process"], times_us["in a thread"], strict=True)
    ratios = sorted(process_us / thread_us for process_us, thread_us in pairs)
    print(f"process to thread, within a turn: {median(ratios):.2f}, {ratios[0]:.2f} to {ratios[-1]:.2f}")


def _took_us(ask: Ask, situation: Situation) -> float:
    began_s = time.perf_counter()
    ask(situation)
    return 1e6 * (time.perf_counter() - began_s)


def _ways() -> dict[str, Ask]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "mine.py")
        file.write_text(MINE)
        own = policy_of(PolicyConfig(name=f"{file}:Mine"))
    direct = LookAhead().choose
    return {"directly": direct, "in a thread": _in_a_thread(direct), "in a process": own.choose}


def _in_a_thread(choose: Ask) -> Ask:
    questions: SimpleQueue[tuple[Situation, Future[Choice]]] = SimpleQueue()

    def answer() -> None:
        while True:
            about, answered = questions.get()
            answered.set_result(choose(about))

    threading.Thread(target=answer, daemon=True).start()

    def ask(about: Situation) -> Choice:
        answered: Future[Choice] = Future()
        questions.put((about, answered))
        return answered.result(timeout=5.0)

    return ask


def _situation() -> Situation:
    names = [f"s{number}" for number in range(SERVERS)]
    options = [
        Option(name, 1.0 + number / 10, 0.0, area=Circle(Position(20.0 * number, 0.0), 60.0))
        for number, name in enumerate(names)
    ]
    calls = [
        ComingCall(
            10.0,
            10.0,
            [Offer(name, 1.0 + (number + call) % SERVERS / 10, 5.0) for number, name in enumerate(names)],
        )
        for call in range(HORIZON)
    ]
    checks: dict[str, Any] = {name: CheckTimes(11.5, 3.5) for name in names}
    return Situation(options, "s0", 10.0, forecast=Forecast(calls, checks, 0.0), position=Position(0.0, 0.0))


if __name__ == "__main__":
    main()

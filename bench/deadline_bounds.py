"""How often a promised probability is too high: `python -m bench.deadline_bounds`.

Sets of delays are drawn from known distributions, and the probability that a set promises is compared with the true
one. The program computes the true one from the distribution and the planned time of the second server's request. A
promise with a confidence of 95 % is too high in 5 % of the sets at most. *Accepted* are sets whose promise reaches
the asked probability: flights with other sets are refused.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from typing import NamedTuple

from bench.program import command_line, machine

from upwash.core.selection.deadlines import AnswerDeadline, Delays, Prospect, prospect

WITHIN_S = 1.5
SETS = 2000
DELAYS = (30, 100, 300, 1000)


class Kind(NamedTuple):
    """A distribution of delays: how it is drawn, and the share of delays up to a time."""

    name: str
    draw: Callable[[random.Random], float]
    share_by: Callable[[float], float]


def _log_normal(best: float) -> Kind:
    """A tail with that share in time."""
    spread = 0.5
    middle = math.log(WITHIN_S) - spread * _normal_quantile(best)

    def share_by(at_s: float) -> float:
        return 0.5 * math.erfc((middle - math.log(at_s)) / (spread * math.sqrt(2))) if at_s > 0 else 0.0

    return Kind(
        f"log-normal, {best:g} in time", lambda chance: chance.lognormvariate(middle, spread), share_by
    )


def _exponential(best: float) -> Kind:
    rate = -math.log(1 - best) / WITHIN_S
    return Kind(
        f"exponential, {best:g} in time",
        lambda chance: chance.expovariate(rate),
        lambda at_s: 1 - math.exp(-rate * max(0.0, at_s)),
    )


def _two_modes(late: float) -> Kind:
    """From 0.3 to 0.5 s, or without an answer."""
    return Kind(
        f"two modes, {1 - late:g} in time",
        lambda chance: math.inf if chance.random() < late else chance.uniform(0.3, 0.5),
        lambda at_s: (1 - late) * min(1.0, max(0.0, (at_s - 0.3) / 0.2)),
    )


def _normal_quantile(share: float) -> float:
    low, high = -10.0, 10.0
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if 0.5 * math.erfc(-middle / math.sqrt(2)) < share else (low, middle)
    return low


ALONE = (_log_normal(0.988), _log_normal(0.992), _exponential(0.985), _two_modes(0.012))
TWO = (_log_normal(0.92), _log_normal(0.85), _exponential(0.93), _two_modes(0.05), _two_modes(0.1))


def main() -> None:
    """Prints a row for each kind of delays and number of them."""
    parser = command_line("deadline_bounds", __doc__)
    parser.add_argument("--sets", type=int, default=SETS, help="of delays, for each row")
    options = parser.parse_args()
    sets = 40 if options.quick else options.sets
    print(f"{machine()}; {sets} sets a row; 0.99 within {WITHIN_S:g} s is asked for\n")
    print("| servers | delays | of each | promise too high | accepted | of these too high |")
    print("|---|---|---|---|---|---|")
    for row in rows(sets):
        print(row, flush=True)


def rows(sets: int) -> Iterator[str]:
    """The table's rows."""
    for count in DELAYS:
        for kind in ALONE:
            yield _row("one", kind, count, sets, two=False, gap=0.0)
        for kind in TWO:
            yield _row("two", kind, count, sets, two=True, gap=0.0)
        for two in (False, True):
            known = "not known to share" if two else "known to share"
            yield _row(
                f"two, {known} a network that is silent in 5 %", TWO[3], count, sets, two=two, gap=0.05
            )


def _row(servers: str, kind: Kind, count: int, sets: int, *, two: bool, gap: float) -> str:
    """With a `gap` both servers are late together, in that share of the calls, and for no other cause."""
    chance = random.Random(f"{servers}/{kind.name}/{count}")
    asked = AnswerDeadline(WITHIN_S, 0.99, 0.1)
    high = accepted = wrong = 0
    for _ in range(sets):
        first = Delays([kind.draw(chance) for _ in range(count)])
        second = Delays([kind.draw(chance) for _ in range(count)]) if two else None
        promised = prospect(asked, first, second)
        is_high = promised.probability > (1 - gap if gap else _true(kind, promised, asked)) + 1e-12
        is_accepted = promised.probability >= asked.probability
        high, accepted, wrong = high + is_high, accepted + is_accepted, wrong + (is_high and is_accepted)
    of_these = f"{100 * wrong / accepted:.1f} %" if accepted else "-"
    cells = (
        servers,
        kind.name,
        f"{count}",
        f"{100 * high / sets:.1f} %",
        f"{100 * accepted / sets:.1f} %",
        of_these,
    )
    return f"| {' | '.join(cells)} |"


def _true(kind: Kind, plan: Prospect, asked: AnswerDeadline) -> float:
    """The true probability of an answer in time, with a second server asked as planned."""
    alone = kind.share_by(asked.within_s)
    if plan.after_s is None:
        return alone
    late = 1 - kind.share_by(plan.after_s)
    helped = (
        min(1.0, asked.extra / late) if late else 1.0
    )  # the second server gets no larger share of the calls
    return 1 - (1 - alone) * (1 - helped * kind.share_by(asked.within_s - plan.after_s))


if __name__ == "__main__":
    main()

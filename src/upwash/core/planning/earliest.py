"""Earliest completion: which call of a line a free place takes, of two places that serve the line.

The other place gets through the line from its front, from when it is free. A free place takes the first call that it
would answer before the other place does. So neither place idles beside a call that it would answer sooner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable


def first_taken(
    line: Iterable[tuple[float, float]], *, other_in_s: float, in_ties: bool = False
) -> int | None:
    """The number of the call that a free place takes; None if it takes none.

    `line` has the seconds of each call at both places, its own first; infinite where the call does not run. The other
    place is free `other_in_s` from now. With `in_ties` the place also takes a call that both answer at one time.
    """
    for number, (own_s, other_s) in enumerate(line):
        other_end_s = other_in_s + other_s
        if own_s < other_end_s or (in_ties and own_s == other_end_s < math.inf):
            return number
        if other_s < math.inf:
            other_in_s = other_end_s
    return None

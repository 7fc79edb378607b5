"""The moving mean of the latest delays (thesis section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

WINDOW_LENGTH = 3
_WINDOWS_KEPT = 256  # that have seen nothing yet: servers are often believed to be equal


@dataclass(frozen=True)
class Window:
    """The last three observations; it starts filled with the offline estimate."""

    values: tuple[float, ...]

    @classmethod
    @lru_cache(_WINDOWS_KEPT, typed=True)
    def filled(cls, estimate_s: float) -> Window:
        """A window that has seen nothing but the offline estimate."""
        return cls((estimate_s,) * WINDOW_LENGTH)

    def observe(self, delay_s: float) -> Window:
        """The window after one more observation."""
        return Window((*self.values[1:], delay_s))

    @cached_property
    def mean_s(self) -> float:
        """The estimate."""
        first = self.values[0]
        if all(value == first for value in self.values):
            return first  # so that an offline estimate is met to the last bit
        return sum(self.values) / len(self.values)

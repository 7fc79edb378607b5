"""What a part before sending costs, gains and loses, and how the delay of a call goes with it."""

from __future__ import annotations

from msgspec import Struct


class Less(Struct, frozen=True):
    """A part that makes the requests of an operation smaller on the drone, before they are sent.

    It takes `takes_s` and leaves the `share` of a request's bytes. `loss` is the share of the answers that it costs.
    """

    takes_s: float
    share: float
    loss: float


class BothWays(Struct, frozen=True):
    """How the delay of a call at one server goes with what is sent.

    A call takes its `fixed_s` for a request of any size, and the rest for the transfer of its request. The two
    functions are inverse: an estimate from calls with less to send, kept as of whole ones, is their mean again.
    """

    less: Less
    fixed_s: float

    def less_s(self, whole_s: float) -> float:
        """The delay (s) with less to send, of a call that would take `whole_s` sent whole."""
        carried_s = max(0.0, whole_s - self.fixed_s)
        return self.less.takes_s + min(whole_s, self.fixed_s) + self.less.share * carried_s

    def whole_s(self, less_s: float) -> float:
        """The delay (s) sent whole, of a call that takes `less_s` with less to send."""
        rest_s = max(0.0, less_s - self.less.takes_s)
        return min(rest_s, self.fixed_s) + max(0.0, rest_s - self.fixed_s) / self.less.share

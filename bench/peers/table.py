"""The results of the trials as tables: a row for each peer, a column for each scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median

from bench.peers.order import Figures, Scenario, Trial

TITLES = {
    "none": "no fault",
    "black-out": "black-out",
    "killed": "killed, started again",
    "stopped": "stopped",
    "late": "5 s late",
}


def tables(trials: Sequence[Trial]) -> Iterator[str]:
    """For each time that a computation takes on the drone what the mission saw, and what was computed."""
    for local_s in dict.fromkeys(trial.local_s for trial in trials):
        chosen = [trial for trial in trials if trial.local_s == local_s]
        yield (
            f"{local_s:g} s on the drone: seconds in all / longest call / exceptions / seconds from the fault's end "
            f"to the first answer of the server\n\n{_table(chosen, _seen)}"
        )
        yield (
            f"{local_s:g} s on the drone: answers of the server + the drone / computations begun by the server + "
            f"the drone\n\n{_table(chosen, _computed)}"
        )


def _table(trials: Sequence[Trial], cell: Callable[[Sequence[Figures]], str]) -> str:
    scenarios: tuple[Scenario, ...] = tuple(dict.fromkeys(trial.scenario for trial in trials))
    lines = [("client", *(TITLES[scenario] for scenario in scenarios)), ("---",) * (len(scenarios) + 1)]
    for peer in dict.fromkeys(trial.peer for trial in trials):
        own = [[each for each in trials if (each.peer, each.scenario) == (peer, what)] for what in scenarios]
        lines.append((peer, *(_cell(each, cell) for each in own)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(trials: Iterable[Trial], cell: Callable[[Sequence[Figures]], str]) -> str:
    figures = [trial.figures for trial in trials if trial.figures]
    return cell(figures) if figures else "failed"


def _seen(figures: Sequence[Figures]) -> str:
    """Medians of the rounds; exceptions are added, and the longest call is the maximum."""
    total_s = median(figure.total_s for figure in figures)
    longest_s = max(figure.longest_s for figure in figures)
    raised = sum(len(figure.raised) for figure in figures)
    return f"{total_s:.1f}/{longest_s:.1f}/{raised}/{_back(figures)}"


def _back(figures: Sequence[Figures]) -> str:
    back_s = [figure.back_s for figure in figures if figure.back_s is not None]
    ready_s = [figure.back_after_ready_s for figure in figures if figure.back_after_ready_s is not None]
    if len(back_s) < len(figures):
        return "-" if not back_s else "at times never"
    after = f" ({median(ready_s):.1f})" if median(back_s) - median(ready_s) >= 0.05 else ""
    return f"{median(back_s):.1f}{after}"


def _computed(figures: Sequence[Figures]) -> str:
    """Sums over the rounds."""
    by_server, by_drone = (
        sum(figure.by_server for figure in figures),
        sum(figure.by_drone for figure in figures),
    )
    on_server = sum(figure.server_computed for figure in figures)
    return f"{by_server}+{by_drone} / {on_server}+{sum(figure.drone_computed for figure in figures)}"

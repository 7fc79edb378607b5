"""The deployments that the page on the science opens with."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench.deployments import kept


def test_servers_save_little_below_a_load_of_one_and_less_than_the_limit_above() -> None:
    for flown in kept():
        saved = 1 - flown.served_min[0] / flown.alone_min[0]
        assert -0.01 < saved < max(0.01, 1 - 1 / flown.load)


def test_a_figure_is_drawn_of_the_kept_deployments(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from bench.deployments_figure import draw

    draw(kept(), [tmp_path / "load.png"])
    assert (tmp_path / "load.png").stat().st_size > 5_000

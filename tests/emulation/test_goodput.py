"""Tables of goodput: what is written can be a scenario's radio."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.emulation.goodput import Measurement, Transfers, write_table
from upwash.emulation.native import WIFI
from upwash.errors import UsageError
from upwash.sim.radio import Spot, read_goodput

LOST = float("inf")


def test_a_table_is_a_radio_and_tells_what_it_depends_on(tmp_path: Path) -> None:
    file = tmp_path / "radio.csv"
    measurement = Measurement(
        WIFI["disc54"], distances_m=[0, 100, 110, 120], request_bytes=1_000_000, seeds=2
    )
    seen = {0: [0.4, 0.5], 100: [1.0, 1.0], 110: [4.0, LOST], 120: [LOST, LOST]}
    write_table(file, measurement, [Transfers(at, 1_000_000, times, times) for at, times in seen.items()])
    text = file.read_text()
    for fact in (
        "802.11g",
        "ErpOfdmRate54Mbps",
        "40.046 dB",
        "exponent 2.58",
        "1000000 bytes",
        "seeds 1 to 2",
    ):
        assert fact in text

    radio = read_goodput(str(file))
    assert radio is not None
    assert radio.at(0) == pytest.approx((20e6 + 16e6) / 2)
    assert radio.at(50) == pytest.approx((18e6 + 8e6) / 2)
    assert radio.at(110) == pytest.approx(1e6), "half of the transfers were lost"
    assert radio.transfer_s(1, Spot(120.0)) == LOST

    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    assert [row["ok"] for row in rows] == ["2", "2", "1", "0"]
    assert [row["transfer_s"] for row in rows] == ["0.4500", "1.0000", "4.0000", ""]
    assert all(len(row) == 11 and None not in row.values() for row in rows)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("", "no rows"),
        ("0,11\n0,10", "do not ascend"),
        ("10,11\n5,10", "do not ascend"),
        ("0,nan", "'nan' is no finite number"),
        ("0,11\ninf,0", "'inf' is no finite number"),
        ("0,-1", "negative"),
        ("0", "a row of 1 column: 0"),
    ],
)
def test_a_table_in_which_nothing_can_be_looked_up_is_refused(
    tmp_path: Path, rows: str, problem: str
) -> None:
    file = tmp_path / "radio.csv"
    file.write_text(f"distance_m,goodput_mbit_s\n{rows}\n")
    with pytest.raises(UsageError, match=problem):
        read_goodput(str(file))


CELLS = st.floats().map(str) | st.text(max_size=4)
TABLES = st.lists(st.lists(CELLS, max_size=3).map(",".join), max_size=5).map(
    lambda rows: "\n".join(["distance_m,goodput_mbit_s", *rows]).encode("utf-8", "surrogatepass")
)


@given(content=st.binary(max_size=200) | TABLES, distance_m=st.floats(0, 1e6))
def test_any_file_is_a_table_or_a_usage_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, distance_m: float
) -> None:
    file = tmp_path_factory.getbasetemp() / "any.csv"
    file.write_bytes(content)
    read_goodput.cache_clear()
    try:
        table = read_goodput(str(file))
    except UsageError:
        return
    assert table is not None
    assert table.at(distance_m) >= 0

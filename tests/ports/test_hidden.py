"""What a sandbox hides, found in the words of a start that failed."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.ports import Program
from upwash.real.instances.sandbox import Sandbox

PROGRAM = Program("/srv/finder.py:Finder")
FINDER = "Finder cannot be made: {} (/srv/finder.py, line 7)"


@pytest.mark.parametrize(
    ("said", "hidden"),
    [
        (
            "FileNotFoundError: [Errno 2] No such file or directory: '/srv/my labels.txt'",
            "/srv/my labels.txt",
        ),
        ("ModelError: /srv/best.onnx: onnxruntime cannot load it", "/srv/best.onnx"),
        ("RuntimeError: open(/srv/best.onnx) failed", "/srv/best.onnx"),
        ("ModuleNotFoundError: No module named 'tests.ports'", str(Path(__file__).parents[1])),
    ],
)
def test_a_hidden_file_is_named_with_the_key_that_shows_it(said: str, hidden: str) -> None:
    remedy = Sandbox("bwrap").remedy(FINDER.format(said), PROGRAM)
    assert remedy == f"; the sandbox hides {hidden}: name what the service needs in runtime.readable"


def test_a_relative_path_is_told_where_it_begins() -> None:
    said = FINDER.format("FileNotFoundError: [Errno 2] No such file or directory: 'labels.txt'")
    remedy = Sandbox("bwrap").remedy(said, PROGRAM)
    assert "relative paths begin at its own /tmp" in remedy
    assert "the whole path of labels.txt" in remedy


@pytest.mark.parametrize(
    "said",
    ["ValueError: 3/4 of a photo", "No module named 'no_such_module'", "see https://example.org/help", ""],
)
def test_words_that_name_nothing_hidden_get_nothing_added(said: str) -> None:
    assert Sandbox("bwrap").remedy(said, PROGRAM) == ""

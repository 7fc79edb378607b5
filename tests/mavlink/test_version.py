"""Versions of firmwares, as numbers and as words."""

from __future__ import annotations

import pytest

from upwash.mavlink.version import Version


@pytest.mark.parametrize("text", ["4.6.2", "4.7.0-dev", "1.16.1-rc", "4.7.0-beta", "4.5.0-alpha", "0.0.0"])
def test_a_version_is_the_same_in_words_and_in_a_number(text: str) -> None:
    version = Version.read(text)
    assert str(version) == text
    assert Version.of(version.number) == version


def test_versions_have_an_order_in_which_a_release_follows_its_development() -> None:
    written = ["3.6.12", "4.0.7", "4.1.0-dev", "4.1.0-rc", "4.1.0", "4.6.2", "4.10.0"]
    assert sorted(map(Version.read, reversed(written))) == list(map(Version.read, written))


def test_no_version_is_told_by_nought() -> None:
    assert Version.of(0) is None


def test_the_last_number_may_be_left_out() -> None:
    assert Version.read("4.6") == Version(4, 6, 0)


@pytest.mark.parametrize("text", ["", "4", "4.x.1", "4.7.0-final", "4.7.256", "v4.7.0", "4.7.0.1", "-4.7.0"])
def test_what_is_no_version_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no version"):
        Version.read(text)

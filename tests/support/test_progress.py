"""What long work says on standard error."""

from __future__ import annotations

import io

from upwash.support.progress import Progress, shown, work


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_work_of_less_than_two_seconds_says_nothing() -> None:
    file, clock = io.StringIO(), Clock()
    progress = Progress("check", file, clock)
    with progress.work("missions", 4):
        clock.now_s += 1.9
        progress.look()
    clock.now_s += 60
    progress.look()
    assert file.getvalue() == ""


def test_into_a_file_a_line_comes_each_ten_seconds_with_what_is_done_and_left() -> None:
    file, clock = io.StringIO(), Clock()
    progress = Progress("check", file, clock)
    with progress.work("missions", 4) as flown:
        for _ in range(48):
            clock.now_s += 0.5
            progress.look()
            if clock.now_s == 110:
                flown()
    assert file.getvalue().splitlines() == [
        "check: missions: 0 of 4; 2 s so far",
        "check: missions: 1 of 4; 12 s so far, about 36 s left",
        "check: missions: 1 of 4; 22 s so far, about 1 min 6 s left",
    ]


def test_a_terminal_shows_one_line_which_is_gone_in_the_end() -> None:
    file, clock = Terminal(), Clock()
    progress = Progress("report", file, clock)
    with progress.work("logs read", 2):
        for _ in range(6):
            clock.now_s += 1
            progress.look()
    said = file.getvalue()
    assert "\n" not in said
    assert said.count("\rreport: logs read: 0 of 2") == 5
    assert said.endswith("\r\x1b[K")


def test_a_part_of_the_work_is_told_within_the_whole_and_in_its_last_words() -> None:
    file, clock = io.StringIO(), Clock()
    progress = Progress("package", file, clock)
    with progress.work("making the image", None) as step, progress.work("files", 8) as copied:
        step(0, what="packing")
        copied(3)
        clock.now_s += 6
        progress.look()
    assert file.getvalue() == "package: packing; files: 3 of 8; 6 s so far, about 10 s left\n"


def test_the_time_that_is_left_is_that_of_the_whole() -> None:
    file, clock = io.StringIO(), Clock()
    progress = Progress("check", file, clock)
    with progress.work("missions", 18), progress.work("waypoints", 100) as reached:
        reached(50)
        clock.now_s += 3
        progress.look()
    assert file.getvalue() == "check: missions: 0 of 18; waypoints: 50 of 100; 3 s so far\n"


def test_standard_error_that_nobody_reads_does_not_end_the_work() -> None:
    file, clock = io.StringIO(), Clock()
    progress = Progress("check", file, clock)
    with progress.work("missions", 4):
        clock.now_s += 3
        file.close()
        progress.look()


def test_without_a_command_work_says_nothing() -> None:
    with work("missions", 3) as flown:
        flown(2, total=5)


def test_quick_work_of_a_command_leaves_standard_error_as_it_was(capsys) -> None:  # type: ignore[no-untyped-def]
    with shown("check"), work("missions", 1) as flown:
        flown()
    assert capsys.readouterr().err == ""

"""What profiling found: a table for people, and the part of a configuration that `fly` and `simulate` read."""

from __future__ import annotations

import json
import re
import statistics
from collections.abc import Mapping, Sequence

from rich.table import Table
from rich.text import Text

from upwash.profiling.boxes import told_boxes
from upwash.profiling.profiler import CallProfile, OnboardProfile, PartProfile, ServerProfile
from upwash.support.text import counted

_MEGA = 1e6
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def call_table(profiles: Sequence[CallProfile]) -> Table:
    """Each operation's delays."""
    table = Table(box=None, padding=(0, 2))
    table.add_column("operation", overflow="fold")
    for title in ("first call", "mean", "median", "longest"):
        table.add_column(title, justify="right", no_wrap=True)
    for profile in profiles:
        table.add_row(
            Text(str(profile.sample.operation)),
            *(
                f"{delay_s:.3f} s"
                for delay_s in (
                    profile.first_s,
                    profile.mean_s,
                    statistics.median(profile.call_s),
                    max(profile.call_s),
                )
            ),
        )
    return table


def service_table(
    profile: OnboardProfile, *, program: str | None, computer: str, settings: str = "", on_drone: bool = True
) -> str:
    """The [[service]] table of a configuration; comments name the computer and the settings.

    For a service that only servers run, `on_drone` is False, and the times are those of a server's own computer.
    """
    calls = profile.calls
    first_extra_s = max(0.0, *(call.first_s - call.mean_s for call in calls))
    lines = [
        f"# Measured on {computer}: {counted(len(calls[0].call_s), 'call')} of each operation.",
        f"# Ready {statistics.median(profile.start_s):.2f} s after its start; "
        f"at most {profile.peak_memory_bytes / _MEGA:.0f} MB of memory.",
        "[[service]]",
        f"name = {_text(calls[0].sample.operation.service)}",
    ]
    if settings:
        lines.insert(2, f"# {settings}")
    lines[-2:-2] = _found(calls)
    if program is not None:
        lines.append(f"program = {_text(program)}")
    delays = _delays({_key(call): call.mean_s for call in calls})
    lines += [
        f"request_bytes = {max(call.sample.request_bytes for call in calls)}",
        f"reply_bytes = {max(call.reply_bytes for call in calls)}",
    ]
    if on_drone:
        lines += [f"local_call_s = {delays}", f"local_first_extra_s = {first_extra_s:.3f}"]
    else:
        lines.append(f"# only servers run it: in the [[server]] with this computer, processing_s = {delays}")
    return "\n".join(lines) + "\n"


def part_table(profile: PartProfile, *, photos: int, settings: Mapping[str, object]) -> str:
    """The [service.before_sending] table of a configuration, to be added to the [[service]] table."""
    lines = [
        "",
        "[service.before_sending]",
        f"# {counted(photos, 'photo')}, {profile.request_bytes:,} bytes before; used if policy.most_loss allows.",
        *(
            f"# AP50 of {operation}: {whole:.3f} whole, {less:.3f} with less to send"
            for operation, (whole, less) in profile.ap50.items()
        ),
        f"takes_s = {profile.takes_s:.4f}",
        f"request_bytes = {profile.sent_bytes}",
        f"loss = {_delays({operation.key or operation.method: loss for operation, loss in profile.loss.items()})}",
    ]
    if settings:
        given = (f"{_quoted_key(key)} = {json.dumps(value)}" for key, value in settings.items())
        lines.append(f"settings = {{ {', '.join(given)} }}")
    return "\n".join(lines) + "\n"


def chosen_setting(setting: str, profiles: Mapping[str, OnboardProfile]) -> str:
    """The [service.settings] table with the value whose calls took the least; comments say what each of them took."""
    lines = ["", "[service.settings]"]
    for value, profile in profiles.items():
        calls = ", ".join(f"{_key(call)} {call.mean_s:.3f} s" for call in profile.calls)
        lines.append(f"# {value}: {calls}")
    lines.append(f"{_quoted_key(setting)} = {_text(fastest(profiles))}")
    return "\n".join(lines) + "\n"


def fastest(profiles: Mapping[str, OnboardProfile]) -> str:
    """The value of a setting with the least sum of mean delays."""
    return min(profiles, key=lambda value: profiles[value].mean_s)


def server_table(profile: ServerProfile, *, server: str, computer: str) -> str:
    """What was measured of a server, as keys for its [[server]] table."""
    service = profile.calls[0].sample.operation.service
    calls_s = _delays({_key(call): call.mean_s for call in profile.calls})
    lines = [
        f"# Measured from {computer}: {counted(len(profile.calls[0].call_s), 'call')} of each operation.",
        *_found(profile.calls),
        f"# For the [[server]] table of {server}:",
    ]
    if profile.check_s is None:
        lines.append("# check_s: not measured, as the services ran already when the drone came")
    else:
        lines.append(f"check_s = {profile.check_s:.3f}")
    lines.append(f"check_running_s = {profile.check_running_s:.3f}")
    if profile.goodput_bit_s is None:
        lines.append(
            "# The way there is too fast for its goodput to be measured, so calls are given end to end."
        )
        lines.append(f"remote_call_s = {{ {_quoted_key(service)} = {calls_s} }}")
    else:
        processing_s = {_key(call): profile.processing_s[call.sample.operation] for call in profile.calls}
        lines += [
            f"bandwidth_bit_s = {profile.goodput_bit_s:.0f}",
            f"processing_s = {{ {_quoted_key(service)} = {_delays(processing_s)} }}",
            f"# End to end, here and now: remote_call_s = {{ {_quoted_key(service)} = {calls_s} }}",
        ]
    return "\n".join(lines) + "\n"


def _found(calls: Sequence[CallProfile]) -> list[str]:
    """A comment for each operation whose answers are detections."""
    told = (told_boxes(str(call.sample.operation), call.answers, as_chance=True) for call in calls)
    return [f"# {line}" for line in told if line]


def _key(profile: CallProfile) -> str:
    return profile.sample.operation.key or profile.sample.operation.method


def _delays(delays_s: Mapping[str, float]) -> str:
    return "{ " + ", ".join(f"{_quoted_key(key)} = {delay_s:.4g}" for key, delay_s in delays_s.items()) + " }"


def _quoted_key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _text(value: str) -> str:
    return json.dumps(value)  # what JSON quotes, TOML reads

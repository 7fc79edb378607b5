"""Where a flight hands over its findings: to a program, a webhook, and TAK."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated
from urllib.parse import SplitResult, urlsplit

from msgspec import Meta, Struct

from upwash.config import values
from upwash.config.problems import Problem

# Without a pattern, as an error message would quote a URL that does not fit it, and with the URL its secrets.
Url = Annotated[str, Meta(description='a URL, such as "https://example.org/hook"')]
_UdpUrl = Annotated[str, Meta(description='a URL, such as "udp://239.2.3.1:6969"')]
_VISIBLE = re.compile(r"[!-~]+")  # of ASCII


class UserConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a real flight [hands over its findings](findings.md#handed-over-during-the-flight), one by one."""

    command: values.Command = ()
    """A program and its arguments, run for each finding, with the finding as JSON on its standard input."""
    webhook: Url | None = None
    """The `https://` or `http://` URL that gets each finding by POST, as JSON."""
    token_file: values.FilePath | None = None
    """A file with a token for the webhook, which is sent as `Authorization: Bearer`."""
    cursor_on_target: _UdpUrl | None = None
    """The address, `udp://HOST:PORT`, that gets each finding with latitude and longitude as an event of TAK."""


def user_problems(user: UserConfig) -> Iterator[Problem]:
    """What is wrong with the URLs, which no message quotes: they may have secrets."""
    if user.webhook is not None and (problem := _webhook_problem(user.webhook, user.token_file is not None)):
        yield "user.webhook", problem
    if user.token_file is not None and user.webhook is None:
        yield "user.token_file", "it is for the webhook, and there is none: give webhook too, or leave it out"
    if user.cursor_on_target is not None:
        tak = _parts(user.cursor_on_target)
        if tak is None or tak.scheme != "udp" or not tak.port or "@" in tak.netloc or tak.path or tak.query:
            yield "user.cursor_on_target", 'expected "udp://HOST:PORT", such as "udp://239.2.3.1:6969"'


def _webhook_problem(url: str, has_token: bool) -> str:
    parts = _parts(url)
    if parts is None or parts.scheme not in ("http", "https"):
        return 'expected a URL of ASCII characters, "https://HOST/PATH" or "http://HOST/PATH"'
    if "@" in parts.netloc:
        return (
            "it has a user or a password, which servers write into logs: give a token in token_file instead"
        )
    if has_token and parts.scheme == "http" and not values.is_on_this_machine(f"{parts.hostname}:80"):
        return "everyone on the way could read the token: use https, or leave token_file out"
    return ""


def _parts(url: str) -> SplitResult | None:
    try:
        parts = urlsplit(url)
        _ = parts.port  # which raises for any other text
        (parts.hostname or "").encode("idna")  # as a look-up does; it refuses long labels
    except ValueError:
        return None
    return parts if _VISIBLE.fullmatch(url) and parts.hostname else None

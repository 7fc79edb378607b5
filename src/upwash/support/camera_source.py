"""A camera's source as people read it: in logs, in messages and on pages, without passwords."""

from __future__ import annotations

import re

_PIPELINE = " ! "
_SECRET = re.compile(r"pass|pwd|pw$|key|token|secret|auth|credential|cookie|header", re.IGNORECASE)
_QUOTES = "\"'"
_WORDS = re.compile(r"""(?:"[^"]*"?|'[^']*'?|[^\s"'])+""")
_HOST = re.compile(r"(?:\[[\w.:%]*\]|[\w.-]*)(?::\d+)?")
_MAY_END_A_HOST = re.compile(r"[/?#]")
_MAY_BEGIN_A_SECRET = re.compile(r"[?#=;&]")


def is_pipeline(source: int | str) -> bool:
    """Whether the source is a pipeline of gst-launch, such as "v4l2src ! videoconvert ! appsink"."""
    return isinstance(source, str) and _PIPELINE in source and "://" not in source.split(maxsplit=1)[0]


def shown_source(source: int | str) -> str:
    """The source with "…" for each part that may hold a password.

    A URL is shown without user, password and query. If a password may contain unescaped marks of a URL, its end is
    unknown, and only the parts that are surely no password are shown.
    """
    text = str(source)
    if is_pipeline(source):
        return _WORDS.sub(lambda word: _shown_word(word[0]), text)
    return _shown_url(text)


def _shown_word(word: str) -> str:
    """A word of a pipeline: an element, or a property with its value."""
    name, equals, value = word.partition("=")
    if not equals:
        return _shown_url(word)
    return f"{name}={'…' if _SECRET.search(name) else _shown_url(value.strip(_QUOTES))}"


def _shown_url(text: str) -> str:
    scheme, marks, rest = text.partition("://")
    if not marks:
        user, at, _ = text.partition("@")
        if not at or ":" not in user:
            return text  # a device, or a file
        scheme, rest = "", text  # the scheme was forgotten
    authority = _MAY_END_A_HOST.split(rest, maxsplit=1)[0]
    beyond = rest[len(authority) :]
    if "@" in beyond:  # which may belong to a password, or to the path
        host = "" if "@" in authority else authority.partition(":")[0] + "/"
        return f"{scheme}{marks}{host}…"
    host = authority.rpartition("@")[2]
    shown = host if _HOST.fullmatch(host) else ""
    path = _MAY_BEGIN_A_SECRET.split(beyond, maxsplit=1)[0]
    return f"{scheme}{marks}{shown}{path}{'…' if (shown, path) != (host, beyond) else ''}"

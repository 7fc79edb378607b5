"""Commands in messages, as a shell takes them when they are pasted."""

from __future__ import annotations

import shlex


def command(*words: object) -> str:
    """The command line of these words, quoted for the shell, between backticks."""
    return f"`{shlex.join(map(str, words))}`"

"""Sentences for a person: a terminal breaks them between words, and elsewhere each is one line."""

from __future__ import annotations

from rich.console import Console
from rich.padding import Padding
from rich.text import Text


def say(sentence: str | Text, console: Console, *, indent: int = 0) -> None:
    """Print a sentence, all its lines indented by that many columns."""
    text = Text(sentence) if isinstance(sentence, str) else sentence  # without colours of its numbers
    if console.is_terminal:
        console.print(Padding(text, (0, 0, 0, indent), expand=False) if indent else text)
    else:
        console.print(Text(" " * indent) + text, soft_wrap=True)

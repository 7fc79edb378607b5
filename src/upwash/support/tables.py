"""Tables for a person: no word is broken and no column cut off, however narrow the terminal is."""

from __future__ import annotations

from collections.abc import Iterator

from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from upwash.support.sentences import say

BEST = "*"  # in the first column, of the best rows
_LONGEST_WORD = 24  # columns of a word that is never broken
_WIDE = 400  # columns of a file, so that a row is one line


def show_table(table: Table, console: Console) -> None:
    """Prints the table; on a terminal too narrow for its columns, a sentence for each row instead."""
    if not console.is_terminal:
        before, console.width = console.width, max(console.width, _WIDE)
        console.print(table)
        console.width = before
    elif fit(table, console.width):
        console.print(table)
    else:
        if table.title:
            say(Text(str(table.title), style="bold"), console)
        for about, rest in _sentences(table):
            say(about, console)
            say(rest, console, indent=2)
        if table.caption:
            say(str(table.caption), console)


def fit(table: Table, width: int) -> bool:
    """Gives each column the room of its words, and of its lines where there is room; whether the columns fit."""
    _, right, _, left = table.padding
    edges = 0 if table.box is None else 1 + len(table.columns)
    room = width - edges - (left + right) * len(table.columns)
    needs = [_needs(column) for column in table.columns]
    spare = room - sum(least for least, _ in needs)
    if spare < 0:
        return False
    by_wish = sorted(zip(table.columns, needs, strict=True), key=lambda pair: pair[1][1] - pair[1][0])
    for number, (column, (least, most)) in enumerate(by_wish):
        given = min(most - least, spare // (len(by_wish) - number))
        column.width, spare = least + given, spare - given
    return True


def _needs(column: Column) -> tuple[int, int]:
    """The width of the column's longest word, and of its longest line."""
    texts = [str(text) for text in (column.header, *column.cells)]
    longest = max(cell_len(line) for text in texts for line in (*text.splitlines(), ""))
    if column.no_wrap:
        return longest, longest
    word = max(cell_len(word) for text in texts for word in (*text.split(), ""))
    return min(word, _LONGEST_WORD), longest


def _sentences(table: Table) -> Iterator[tuple[Text, Text]]:
    """What each row is about, and its other cells, after the names of their columns."""
    heads = [" ".join(str(column.header).replace(".\n", ".").split()) for column in table.columns]
    columns = [list(column.cells) for column in table.columns]
    for row, cells in zip(table.rows, zip(*columns, strict=True), strict=True):
        texts = [cell if isinstance(cell, Text) else Text(str(cell)) for cell in cells]
        named = [
            Text.assemble(f"{head} " if head else "", text)
            for head, text in zip(heads, texts, strict=True)
            if text.plain
        ]
        first = 2 if named[0].plain == BEST else 1
        style = row.style or ""
        yield (
            Text.assemble(Text(" ").join(named[:first]), style=style),
            Text.assemble(Text("; ").join(named[first:]), style=style),
        )

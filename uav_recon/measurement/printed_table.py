"""Tables of measured values for a terminal."""

from __future__ import annotations

from rich import box
from rich.table import Table


def narrow_table(title: str, first: str, *columns: str) -> Table:
    """Return an empty table that fits into eighty columns."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table

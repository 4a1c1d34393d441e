# SPDX-License-Identifier: Apache-2.0
"""Tables in the terminal; plain text where the output is no terminal."""

from collections.abc import Sequence

from rich.box import ASCII2, SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

WIDE = 160  # columns where the output is a file or a pipe


def console(stderr: bool = False) -> Console:
    """Colours and the terminal's width on a terminal; neither elsewhere."""
    out = Console(stderr=stderr, highlight=False, soft_wrap=False)
    return out if out.is_terminal else Console(stderr=stderr, highlight=False, width=WIDE, no_color=True)


def table(out: Console, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> None:
    """Prints a table whose first `left` columns are words and the others numbers."""
    box = SIMPLE_HEAD if out.is_terminal and not out.legacy_windows else ASCII2
    made = Table(title=title, title_justify="left", title_style="bold", box=box, header_style="")
    for i, name in enumerate(columns):
        made.add_column(name, justify="left" if i < left else "right", overflow="fold")
    for row in rows:
        made.add_row(*row)
    out.print(made)

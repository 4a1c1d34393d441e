# SPDX-License-Identifier: Apache-2.0
"""The notebook of an experimenter: Markdown with pictures, whole on disk after every entry."""

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from matplotlib.figure import Figure

from eps_tunnel_analysis.autonomous.pictures import save
from eps_tunnel_analysis.cli.folder import write_anew

FILE = "notebook.md"


class Notebook:
    """notebook.md in a folder, and pictures beside it."""

    def __init__(self, folder: Path, title: str, *lines: str) -> None:
        self._folder, self._count = folder, 0
        self._pages = [f"# {title}", *lines]
        self._write()

    @property
    def path(self) -> Path:
        """Of the Markdown file."""
        return self._folder / FILE

    def entry(self, heading: str, *blocks: str) -> None:
        """A numbered entry with the time of day; the file is replaced at once."""
        self._count += 1
        now = datetime.now(UTC).strftime("%H:%M:%S UTC")
        self._pages += [f"## {self._count}. {heading}", f"*{now}*", *(block for block in blocks if block)]
        self._write()

    def picture(self, figure: Figure, name: str, text: str) -> str:
        """Saves a picture and returns the Markdown that shows it; `text` says what it shows."""
        file = f"{self._count + 1:02d}_{name}.png"
        save(figure, self._folder / file)
        return f"![{text}]({file})"

    def link(self, text: str, path: Path) -> str:
        """Markdown for a file, as seen from the notebook."""
        return f"[{text}]({Path(os.path.relpath(path, self._folder)).as_posix()})"

    def _write(self) -> None:
        write_anew(self.path, "\n\n".join(self._pages) + "\n")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, words left and the other columns right."""
    lines = [list(columns), ["---", *["---:"] * (len(columns) - 1)], *map(list, rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)

# SPDX-License-Identifier: Apache-2.0
"""Fenced blocks of Markdown pages, and what a comment above one says of how it is tested.

    <!-- test: options -->           check options and names only: it takes long, or needs what is not here
    <!-- test: instead COMMAND -->   run this quick variant, and check the shown one as above
    <!-- test: nodes -->             start each in the background until the page's end
    <!-- test: workspace -->         run with src/ standing for the source tree's
    <!-- test: skip, REASON -->      neither
    <!-- test: instead STATEMENTS --> of Python: run these quick ones, and compile what is shown
    <!-- file: PATH -->              the block is that file's content

Blocks of ```console without a comment are run as they are; lines that begin with `$ ` are commands, the others output.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMENT = re.compile(r"<!-- (?P<kind>test|file): (?P<text>.*?) -->")
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)$")


@dataclass
class Block:
    """One block. `lines`: its text; `how`: of the comment above it, empty for none."""

    page: str
    number: int
    language: str
    how: str = ""
    file: str = ""
    lines: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return f"{self.page}:{self.number}"

    def commands(self) -> list[tuple[str, list[str]]]:
        """Every command with the lines of output shown below it."""
        found: list[tuple[str, list[str]]] = []
        for line in self.lines:
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif found:
                found[-1][1].append(line)
        return found


def blocks(page: str, begin: str = "", end: str = "") -> list[Block]:
    """The blocks of a page, from the heading `begin` up to the heading `end` where given."""
    found: list[Block] = []
    open_block: Block | None = None
    how = file = indent = ""
    inside = not begin
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
        if open_block is not None:
            if line == f"{indent}```":
                open_block = None
            else:
                open_block.lines.append(line.removeprefix(indent))
            continue
        if line in (begin, end) and line:
            inside = line == begin
        if match := COMMENT.search(line):
            how, file = (match["text"], file) if match["kind"] == "test" else (how, match["text"])
        elif match := FENCE.match(line):
            indent = match["indent"]
            open_block = Block(page, number, match["language"], how, file)
            how = file = ""
            if inside:
                found.append(open_block)
    return found


def masked(line: str) -> str:
    """A line of output without what differs from run to run: numbers, and the width of columns."""
    line = re.sub(r"-?\d[\d.]*(e-?\d+)?", "#", line)
    return re.sub(r"\s+", " ", re.sub(r"[-=]{2,}", "-", line)).strip()


def missing(shown: list[str], printed: str) -> list[str]:
    """Lines that a page shows and a program did not print; `...` stands for anything."""
    actual = [masked(line) for line in printed.splitlines()]
    wrong = []
    for line in shown:
        begin, cut, _ = line.partition("...")
        want = masked(begin)
        if want and not any(text.startswith(want) if cut else text == want for text in actual):
            wrong.append(line)
    return wrong

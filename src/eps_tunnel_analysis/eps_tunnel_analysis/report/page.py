# SPDX-License-Identifier: Apache-2.0
"""The page: sections of text, facts, tables and charts, rendered into one HTML file that fetches nothing."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Heading:
    """A smaller title within a section."""

    kind: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True)
class Points:
    """A list of sentences."""

    kind: ClassVar[str] = "points"
    items: Sequence[str]


@dataclass(frozen=True)
class Figures:
    """Large figures side by side: (value, what it is, a line of explanation, a share to draw as a bar or None)."""

    kind: ClassVar[str] = "figures"
    items: Sequence[tuple[str, str, str, float | None]]


@dataclass(frozen=True)
class Facts:
    """Pairs of name and value."""

    kind: ClassVar[str] = "facts"
    items: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Bar:
    """A table cell that shows a share, 0 to 1, as a bar with its figure."""

    share: float
    text: str


@dataclass(frozen=True)
class Table:
    """A table; cells are words (left), numbers as text (right where `numeric` says so) or bars."""

    kind: ClassVar[str] = "table"
    columns: Sequence[str]
    rows: Sequence[Sequence[str | Bar]]
    caption: str = ""
    numeric: Sequence[int] = ()
    folded: bool = False


@dataclass(frozen=True)
class Chart:
    """A plotly figure as plain dicts.

    Colours are written `var(--name)` and taken from the page's style, so that one figure serves light and dark.

    Attributes:
        data, layout: traces and layout. A trace with `meta: {"centre": [...], "deviation": [...]}` is redrawn as
            centre + k * deviation when the reader picks another k.
        label: what the chart shows, for those who cannot see it.
        caption: what to look at.
        height: px.
        outside: k -> spans (start, end) shaded at that k.
    """

    kind: ClassVar[str] = "chart"
    data: Sequence[dict[str, Any]]
    layout: dict[str, Any]
    label: str
    caption: str = ""
    height: int = 320
    outside: dict[str, Sequence[tuple[float, float]]] = field(default_factory=dict)

    @property
    def json(self) -> Markup:
        """For a script element: no NaN, five digits, nothing that could end the element."""
        content = {"data": self.data, "layout": self.layout, "outside": self.outside}
        return Markup(json.dumps(_short(content), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


@dataclass(frozen=True)
class KPicker:
    """Buttons for the factor k of every chart on the page."""

    kind: ClassVar[str] = "k_picker"
    ks: Sequence[float]


Block = Text | Heading | Points | Figures | Facts | Table | Chart | KPicker


@dataclass(frozen=True)
class Section:
    """A titled part of the page. `lead` says in a sentence or two what it shows."""

    title: str
    blocks: Sequence[Block]
    lead: str = ""

    @property
    def anchor(self) -> str:
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


def render(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The page as HTML: style, script and plotly inlined once."""
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    charts = any(block.kind == "chart" for section in sections for block in section.blocks)
    return environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),
        script=Markup((HERE / "page.js").read_text(encoding="utf-8")),
        plotly=Markup(get_plotlyjs()) if charts else "",
    )


def _short(content: Any) -> Any:
    if isinstance(content, dict):
        return {str(key): _short(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_short(value) for value in content]
    if isinstance(content, float):
        return float(f"{content:.6g}") if math.isfinite(content) else None
    return content

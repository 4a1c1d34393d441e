# SPDX-License-Identifier: Apache-2.0
"""The page: sections of text, facts, tables and charts, rendered into one HTML file that fetches nothing."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from labyrinth_sim.trials import Array

HERE = Path(__file__).parent
UPLOT = HERE.parent / "monitor" / "static" / "vendor"
MOST_POINTS = 2000  # samples of a curve; a wide screen has as many pixels
MOST_NUMBERS = 90_000  # of all charts of a page, so that it stays well under 1 MB
SHADES = 10_000  # parts of a curve's range that are distinguished


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
    """A list of sentences; folded under its title if it has one."""

    kind: ClassVar[str] = "points"
    items: Sequence[str]
    folded: str = ""


@dataclass(frozen=True)
class KeyFigures:
    """Large figures side by side: (value, what it is, a line of explanation, a share to draw as a bar or None)."""

    kind: ClassVar[str] = "figures"
    items: Sequence[tuple[str, str, str, float | None]]


@dataclass(frozen=True)
class Link:
    """A file, by its address as seen from the page, with its label and the text after it."""

    text: str
    address: str
    after: str = ""


@dataclass(frozen=True)
class Facts:
    """Pairs of name and value."""

    kind: ClassVar[str] = "facts"
    items: Sequence[tuple[str, str | Link]]


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
class CommandToCopy:
    """A command to copy, and a sentence on what it does."""

    kind: ClassVar[str] = "command"
    text: str
    command: str


@dataclass(frozen=True)
class Stripes:
    """When something holds, one row per name: spans (start, end) in s on an axis from `start` to `end`."""

    kind: ClassVar[str] = "stripes"
    rows: Sequence[tuple[str, Sequence[tuple[float, float]]]]
    start: float
    end: float
    label: str
    caption: str = ""

    def placed(self, spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Left edge and width of each span, in % of the axis; those that a screen cannot separate are merged."""
        length = (self.end - self.start) or 1.0
        joined = joined_spans(spans, length / MOST_POINTS)
        return [(100 * (a - self.start) / length, 100 * (b - a) / length) for a, b in joined]


@dataclass(frozen=True)
class Line:
    """One curve of a chart over its x.

    Attributes:
        values: (n,) in the unit of the chart; NaN where unknown.
        colour: a name in the page's style, as "real".
        width: px; 0 draws points alone.
        points: mark each value.
        steps: a value holds until the next.
        spread: (n,) half the height of a bar through each point.
    """

    name: str
    values: Array
    colour: str
    width: float = 1.6
    dash: bool = False
    points: bool = False
    steps: bool = False
    spread: Array | None = None


@dataclass(frozen=True)
class Band:
    """A tunnel: from centre + k * lower to centre + k * upper, (n,) each; the reader picks k."""

    name: str
    centre: Array
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Chart:
    """Curves over one x, drawn by uPlot: drag to zoom, double-click to return, values at the cursor.

    Attributes:
        x: (n,), rising.
        x_label, y_label: with units.
        label: what the chart shows, for those who cannot see it.
        caption: what to look at.
        height: px.
        outside: k -> spans (start, end) shaded at that k.
        y_range: lowest and highest value shown; by default the range of the curves.
        together: charts with the same name share cursor and zoom.
    """

    kind: ClassVar[str] = "chart"
    x: Array
    lines: Sequence[Line]
    x_label: str
    y_label: str
    label: str
    caption: str = ""
    height: int = 240
    band: Band | None = None
    outside: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)
    y_range: tuple[float, float] | None = None
    together: str = ""

    @property
    def numbers(self) -> int:
        """How many would be written without thinning."""
        return len(self.x) * (
            1 + len(self.lines) + sum(line.spread is not None for line in self.lines) + 3 * bool(self.band)
        )

    def json(self, most: int) -> Markup:
        """For a script element, with `most` samples: no NaN, and nothing that could end the element.

        Only what is drawn is thinned; figures and spans are of all samples.
        """
        every = max(1, math.ceil(len(self.x) / most))
        x = np.asarray(self.x, dtype=float)[::every]
        length = float(x[-1] - x[0]) if len(x) else 0.0
        content: dict[str, Any] = {
            "x": _even(x) or _short(x),
            "xLabel": self.x_label,
            "yLabel": self.y_label,
            "together": self.together,
            "yRange": self.y_range,
            "height": self.height,
            "lines": [
                {
                    "name": line.name, "y": _short(line.values[::every]), "colour": line.colour, "width": line.width,
                    "dash": line.dash, "points": line.points, "steps": line.steps,
                    "spread": None if line.spread is None else _short(line.spread[::every]),
                }
                for line in self.lines
            ],
            "outside": {k: joined_spans(spans, length / MOST_POINTS) for k, spans in self.outside.items()},
        }  # fmt: skip
        if self.band:
            parts = {"centre": self.band.centre, "lower": self.band.lower, "upper": self.band.upper}
            content["band"] = {"name": self.band.name, **{key: _short(v[::every]) for key, v in parts.items()}}
        return Markup(json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


@dataclass(frozen=True)
class Pair:
    """Two charts side by side, one above the other on a phone."""

    kind: ClassVar[str] = "pair"
    charts: tuple[tuple[str, Chart], tuple[str, Chart]]


@dataclass(frozen=True)
class KPicker:
    """Buttons for the factor k of every chart on the page."""

    kind: ClassVar[str] = "k_picker"
    ks: Sequence[float]


Block = Text | Heading | Points | KeyFigures | Facts | Table | Chart | Pair | Stripes | CommandToCopy | KPicker


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
    """The page as HTML: style, script and uPlot inlined once."""
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    charts = [chart for section in sections for block in section.blocks for chart in _charts(block)]
    samples = max((len(chart.x) for chart in charts), default=1)
    share = min(1.0, MOST_NUMBERS / max(1, sum(chart.numbers for chart in charts)))
    return environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        most=max(100, min(MOST_POINTS, int(samples * share))),
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),
        script=Markup((HERE / "page.js").read_text(encoding="utf-8")),
        uplot=Markup((UPLOT / "uPlot.iife.min.js").read_text(encoding="utf-8")) if charts else "",
        uplot_style=Markup((UPLOT / "uPlot.min.css").read_text(encoding="utf-8")) if charts else "",
    )


def _charts(block: Block) -> list[Chart]:
    if isinstance(block, Pair):
        return [chart for _, chart in block.charts]
    return [block] if isinstance(block, Chart) else []


def joined_spans(spans: Sequence[tuple[float, float]], gap: float) -> list[tuple[float, float]]:
    """The same spans in order, with those joined that lie up to `gap` apart."""
    joined: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if joined and start - joined[-1][1] <= gap:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((float(start), float(end)))
    return [(round(a, 4), round(b, 4)) for a, b in joined]


def _even(values: Array) -> dict[str, float] | None:
    """An even grid by its start, step and length; None where it is not even."""
    if len(values) < 3 or not np.allclose(np.diff(values), values[1] - values[0], rtol=1e-6, atol=1e-12):
        return None
    return {"from": float(values[0]), "step": float(values[-1] - values[0]) / (len(values) - 1), "count": len(values)}


def _short(values: Array) -> list[float | None]:
    """With as many decimals as a screen shows of their range; None where not finite."""
    values = np.asarray(values, dtype=float)
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    step = (span or float(np.abs(known).max(initial=0.0)) or 1.0) / SHADES
    decimals = max(0, min(12, math.ceil(-math.log10(step))))
    return [None if not math.isfinite(v) else int(v) if v == int(v) else round(v, decimals) for v in values.tolist()]

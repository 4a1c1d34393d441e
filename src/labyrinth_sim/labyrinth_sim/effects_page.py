# SPDX-License-Identifier: Apache-2.0
"""docs/effects.md and its pictures, made from the declarations: `python -m labyrinth_sim.effects_page`."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, drives, effects
from labyrinth_sim.marks import MARKS
from labyrinth_sim.model import load_model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Array

ACTS_ON = {"axis": "each axis", "signal": "each measured angle", "ball": "the ball"}
COUPLED = ", by how the others move"
EVERYWHERE = "all axes, at whichever it is stated"
PICTURE_WIDTH = 520
DASHED = 'stroke="#555" stroke-width="0.8" stroke-dasharray="4 3"'
GREY = 'stroke="#999" stroke-width="1.5"'
RED = 'stroke="#c0392b" stroke-width="1.5"'
INTRODUCTION = """# Effects and drives

Made by `python -m labyrinth_sim.effects_page` from the declarations in `labyrinth_sim/effects` and
`labyrinth_sim/drives`; do not edit. At its *off* value an effect changes no bit of a simulation. In the pictures the
dashed line is the command (half a triangle, a step, then rest while the other axis swings; for the ball: level for 1 s,
then tilted by 0.012 rad), grey the model without the effect, red the model with it, at the value in the title; below is
the difference between the two, on its own scale.

Units and bounds are for a servo with up to 10 N m. For a stronger axis, and for one that slides (N instead of
N m, m instead of rad), they follow from its drive's full force and its limits; a value that scales with the axis may be
stated far beyond them.

Free curves (`curve_...`) are tables over one variable, for effects that have no name yet. A diagnosis considers them
only on request, and the range of a table is stated, not fitted.

To add your own effect, write a file that declares `EFFECT = Effect(...)` like those in `labyrinth_sim/effects`, and
give its folder by `--effects DIR` or `$EPS_TUNNEL_EFFECTS`, or declare an entry point of the group
`labyrinth_sim.effects`.
"""


def page() -> str:
    """The whole of docs/effects.md."""
    parts = [INTRODUCTION]
    parts.append(_table(("effect", "acts on", "changes"), [
        (f"[{e.title}](#{e.name})", EVERYWHERE if e.everywhere else ACTS_ON[e.where] + COUPLED * e.couples, e.stage)
        for e in effects().values()
    ]))  # fmt: skip
    parts += ["\n".join(_section(effect)) for effect in effects().values()]
    parts.append("# Drives\n")
    for drive in drives().values():
        parts.append(f"## {drive.name}\n\n{drive.physics}\n\n`{drive.equation}`\n\n{_parameters(drive.parameters)}")
    return "\n".join(parts)


def _section(effect: Effect) -> Iterator[str]:
    others = ", ".join(f"[{name}](#{name})" for name in effect.confused_with)
    yield f'<a id="{effect.name}"></a>\n\n## {effect.title}: `{effect.name}`\n'
    yield f"{effect.physics}\n\n`{effect.equation}`\n"
    yield _parameters(effect.parameters)
    mark = (MARKS[effect.shows].__doc__ or "").strip()
    yield f"**In the data.** {effect.mark} Its measure: {mark[0].lower()}{mark[1:]}\n"
    yield f"![with and without](effects/{effect.name}.svg)\n"
    yield f"**Mistaken for** {others}. **Distinguished by:** {effect.separated_by}\n"


def _parameters(parameters: Sequence[Parameter]) -> str:
    return _table(
        ("parameter", "unit", "bounds", "off", "why these bounds"),
        [(p.name, p.unit, f"{p.low:g} to {p.high:g}", _off(p), p.why) for p in parameters],
    )


def _off(p: Parameter) -> str:
    return "-" if p.off is None else f"{p.off:g}"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def picture(effect: Effect) -> str:
    """SVG of a signal with and without the effect, and below it of the difference."""
    model = load_model("labyrinth_manual")
    place = model.places(effect)[0]
    ball = effect.where == "ball" or "ball" in effect.needs
    time: Array = np.linspace(0.0, 3.0, 301)
    x = np.interp(time, [0, 0.4, 1.2, 1.6], [0, 0.06, -0.06, 0]) + np.where((time > 1.8) & (time < 2.4), 0.06, 0.0)
    y = np.where(time > 2.4, 0.06 * np.sin(10 * (time - 2.4)), 0.0)
    start = {"ball_x": 0.18, "ball_y": 0.135} if ball else None  # before 90 mm of free corridor, then a wall
    if ball:
        x, y = 0 * time, np.where(time < 1, 0.0, 0.012)
        place = place if effect.where == "ball" else model.rig.axes[1].name
    commands = np.stack([x, y], axis=1)
    column = _column(effect, place, ball)
    plain, rich = (simulate(m, time, commands, start) for m in (model, model.with_effect(effect, place)))
    # Millimetres and degrees, because people read this.
    unit, scale = ("mm", 1000.0) if ball else ("deg", 180 / np.pi)
    without, with_it = (scale * trials.values[0, :, trials.index(column)] for trials in (plain, rich))
    p = effect.main
    title = (
        f"{column} [{unit}], {effect.name} at {place}: {p.name} = {p.typical:g}{'' if p.unit == '1' else ' ' + p.unit}"
    )
    curves = (
        [(without, GREY), (with_it, RED)]
        if ball
        else [(scale * commands[:, 0], DASHED), (without, GREY), (with_it, RED)]
    )
    below = f"with minus without [{unit}]"
    return _svg([(title, curves, 110), (below, [(with_it - without, RED)], 45)], time)


def _column(effect: Effect, place: str, ball: bool) -> str:
    if ball:
        return BALL_SIGNALS[0]
    return place if effect.where == "signal" else f"board_{place}"


def _svg(panels: Sequence[tuple[str, list[tuple[Array, str]], int]], time: Array) -> str:
    """Panels of (title, curves, height) under one another, each with its own scale, over one time axis in s."""
    left, right, top, parts = 58, PICTURE_WIDTH - 8, 0, []
    for title, curves, height in panels:
        low, high = min(float(c.min()) for c, _ in curves), max(float(c.max()) for c, _ in curves)
        middle, half = (low + high) / 2, max((high - low) / 2, 1e-6)
        top += 20

        def row(
            value: float, top: int = top, height: int = height, middle: float = middle, half: float = half
        ) -> float:
            return top + height / 2 * (1.0 - (value - middle) / half)

        parts.append(_text(left, top - 5, title, "start"))
        parts += [_text(left - 5, row(v) + 4, f"{v:.3g}", "end") for v in (low, high)]
        parts += [_line(left, row(v), right, row(v)) for v in (low, high)]
        parts += [_line(px, top, px, top + height) for px in np.interp([0, 1, 2, 3], time[[0, -1]], [left, right])]
        for curve, style in curves:
            px = np.interp(time[::2], time[[0, -1]], [left, right])
            points = " ".join(f"{a:.0f},{row(b):.1f}" for a, b in zip(px, curve[::2], strict=True))
            parts.append(f'<polyline fill="none" {style} points="{points}"/>')
        top += height
    parts += [
        _text(float(px), top + 14, label, anchor)
        for px, label, anchor in zip(
            np.interp([0, 1, 2, 3], time[[0, -1]], [left, right]),
            ("0", "1", "2", "3 s"), ("middle", "middle", "middle", "end"), strict=True)
    ]  # fmt: skip
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{PICTURE_WIDTH}" height="{top + 20}">'
    return "\n".join([head, '<rect width="100%" height="100%" fill="white"/>', *parts, "</svg>\n"])


def _text(x: float, y: float, text: str, anchor: str) -> str:
    style = f'font-family="sans-serif" font-size="11" fill="#333" text-anchor="{anchor}"'
    return f'<text x="{x:.0f}" y="{y:.0f}" {style}>{text}</text>'


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<line x1="{x1:.0f}" y1="{y1:.0f}" x2="{x2:.0f}" y2="{y2:.0f}" stroke="#ddd" stroke-width="0.7"/>'


def main() -> None:
    """Writes docs/effects.md and docs/effects/*.svg below the folder given, the current one if none is."""
    docs = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "docs"
    (docs / "effects").mkdir(parents=True, exist_ok=True)
    (docs / "effects.md").write_text(page(), encoding="utf-8")
    for effect in effects().values():
        (docs / "effects" / f"{effect.name}.svg").write_text(picture(effect), encoding="utf-8")


if __name__ == "__main__":
    main()

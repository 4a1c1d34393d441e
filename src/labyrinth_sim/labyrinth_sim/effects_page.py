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
WIDTH, HEIGHT, MARGIN = 520, 150, 8
INTRODUCTION = """# Effects and drives

Made by `python -m labyrinth_sim.effects_page` from the declarations in `labyrinth_sim/effects` and
`labyrinth_sim/drives`; do not edit. At its *off* value an effect changes no bit of a simulation. In the pictures the
dashed line is the command, grey the model without the effect, red the model with it, at the value in the title.

To add one of your own, write a file that declares `EFFECT = Effect(...)` as those in `labyrinth_sim/effects` do, and
name its folder by `--effects-folder` or `$EPS_TUNNEL_EFFECTS`, or declare an entry point of the group
`labyrinth_sim.effects`.
"""


def effects_table() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of the list of effects, as `eps-tunnel effects` prints it."""
    header = ("effect", "acts on", "parameters", "off", "bounds", "what it is")
    rows: list[tuple[str, ...]] = []
    for effect in effects().values():
        rows.append(
            (
                effect.name,
                ACTS_ON[effect.where],
                "\n".join(f"{p.name} [{p.unit}]" for p in effect.parameters),
                "\n".join(_off(p) for p in effect.parameters),
                "\n".join(f"{p.low:g} to {p.high:g}" for p in effect.parameters),
                effect.physics,
            )
        )
    return header, rows


def page() -> str:
    """The whole of docs/effects.md."""
    parts = [INTRODUCTION]
    parts.append(_table(("effect", "acts on", "changes"), [
        (f"[{e.title}](#{e.name})", ACTS_ON[e.where], e.stage) for e in effects().values()
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
    yield f"**Mistaken for** {others}. **Told apart:** {effect.separated_by}\n"


def _parameters(parameters: Sequence[Parameter]) -> str:
    return _table(
        ("parameter", "unit", "bounds", "off", "why these bounds"),
        [
            (p.name, p.unit, f"{p.low:g} to {p.high:g}", "-" if p.off is None else f"{p.off:g}", p.why)
            for p in parameters
        ],
    )


def _off(p: Parameter) -> str:
    return "-" if p.off is None else f"{p.off:g}"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def picture(effect: Effect) -> str:
    """SVG of a signal with and without the effect."""
    model = load_model("labyrinth_manual")
    place = model.places(effect)[0]
    ball = effect.where == "ball" or "ball" in effect.needs
    time: Array = np.linspace(0.0, 3.0, 301)
    x = np.interp(time, [0, 0.4, 1.2, 1.6], [0, 0.06, -0.06, 0]) + np.where((time > 1.8) & (time < 2.4), 0.06, 0.0)
    y = np.where(time > 2.4, 0.06 * np.sin(10 * (time - 2.4)), 0.0)
    start = {"ball_x": 0.1, "ball_y": 0.1} if ball else None
    if ball:
        x, y = 0 * time, np.where(time < 1, 0.0, 0.02)
        place = place if effect.where == "ball" else model.rig.axes[1].name
    commands = np.stack([x, y], axis=1)
    column = _column(effect, place, ball)
    plain, rich = (simulate(m, time, commands, start) for m in (model, model.with_effect(effect, place)))
    lines = [trials.values[0, :, trials.index(column)] for trials in (plain, rich)]
    p = effect.main
    title = f"{column}, {effect.name} at {place}: {p.name} = {p.typical:g} {p.unit}"
    return _svg(title, time, commands[:, 0] if not ball else None, *lines)


def _column(effect: Effect, place: str, ball: bool) -> str:
    if ball:
        return BALL_SIGNALS[0]
    return place if effect.where == "signal" else f"board_{place}"


def _svg(title: str, time: Array, command: Array | None, without: Array, with_it: Array) -> str:
    every = [without, with_it] + ([] if command is None else [command])
    low, high = min(float(a.min()) for a in every), max(float(a.max()) for a in every)
    span = max(high - low, 1e-9)

    def path(values: Array, style: str) -> str:
        px = MARGIN + (WIDTH - 2 * MARGIN) * time[::2] / time[-1]
        py = HEIGHT - MARGIN - (HEIGHT - 30) * (values[::2] - low) / span
        points = " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(px, py, strict=True))
        return f'<polyline fill="none" {style} points="{points}"/>'

    dashed = [] if command is None else [path(command, 'stroke="#555" stroke-width="0.8" stroke-dasharray="4 3"')]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}">',
            '<rect width="100%" height="100%" fill="white"/>',
            f'<text x="{MARGIN}" y="14" font-family="sans-serif" font-size="11" fill="#333">{title}</text>',
            *dashed,
            path(without, 'stroke="#999" stroke-width="1.5"'),
            path(with_it, 'stroke="#c0392b" stroke-width="1.5"'),
            "</svg>\n",
        ]
    )


def main() -> None:
    """Writes docs/effects.md and docs/effects/*.svg below the folder given, the current one if none is."""
    docs = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "docs"
    (docs / "effects").mkdir(parents=True, exist_ok=True)
    (docs / "effects.md").write_text(page(), encoding="utf-8")
    for effect in effects().values():
        (docs / "effects" / f"{effect.name}.svg").write_text(picture(effect), encoding="utf-8")


if __name__ == "__main__":
    main()

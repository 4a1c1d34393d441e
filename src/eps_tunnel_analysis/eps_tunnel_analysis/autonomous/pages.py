# SPDX-License-Identifier: Apache-2.0
"""What is written into the notebook, as blocks of Markdown."""

from collections.abc import Sequence
from pathlib import Path

from eps_tunnel_analysis.autonomous.gap import Gap
from eps_tunnel_analysis.autonomous.notebook import Notebook, table
from eps_tunnel_analysis.autonomous.pictures import (
    gap_picture,
    hypotheses_picture,
    left_over_picture,
    staircase_picture,
)
from eps_tunnel_analysis.autonomous.reason import Reason
from eps_tunnel_analysis.shown import shown_share, shown_value
from eps_tunnel_analysis.where import sentences

MOST = 3  # sentences on where it fails


def gap_page(gap: Gap, notebook: Notebook, report: Path) -> list[str]:
    """Error and alikeness, where it fails, and a picture."""
    c = gap.comparison
    rows = [
        (
            e.signal,
            shown_value(e.command_error, e.unit),
            shown_value(e.repeat_rms, e.unit),
            *(shown_share(a.shares[e.signal]) for a in c.alikeness),
        )
        for e in c.errors
    ]
    rows.append(("jointly", "", "", *(shown_share(a.joint) for a in c.alikeness)))
    columns = ("signal", "error E", "rig repeats within", *(f"alike, k = {a.k_real:g}" for a in c.alikeness))
    return [
        table(columns, rows),
        "\n".join(f"- {sentence}" for sentence in [*sentences(c.where)[:MOST], *gap.notes]),
        notebook.picture(gap_picture(c), "gap", "simulation in the tunnel of the real trials"),
        notebook.link("report", report),
    ]


def diagnosis_page(reason: Reason, notebook: Notebook) -> list[str]:
    """Sentence, probabilities, what is left, notes."""
    d = reason.diagnosis
    v = d.verdict
    floors = ", ".join(f"{axis}: {old**0.5:.1f} before, {new**0.5:.1f} after" for axis, (old, new) in v.floor.items())
    return [
        f"**{v.sentence}**",
        notebook.picture(hypotheses_picture(v), "hypotheses", "probabilities of the hypotheses"),
        notebook.picture(
            left_over_picture(d.before, d.after if v.effects else None), "left_over", "simulation minus real"
        ),
        f"Misfit in units of the noise floor, below which no model goes far: {floors}.",
        "\n".join(f"- {note}" for note in v.notes),
        f"{v.evaluations} roll-outs in {v.seconds:.0f} s, {notebook.link('report', reason.report)}",
    ]


def values_page(reason: Reason, link: str) -> list[str]:
    """What was fitted, and what that is worth on samples held out."""
    v = reason.diagnosis.verdict
    fall = 1 - v.after.held_out / v.before.held_out
    rows = [(name, f"{value:.5g}") for name, value in v.values.items()]
    return [
        table(("parameter", "value"), rows),
        f"On samples held out of the fit the error fell by {fall:.0%}. Loaded into the simulation: {link}",
    ]


def ending_page(
    sentence: str, steps: Sequence[tuple[str, Gap]], reason: Reason, notebook: Notebook, link: str
) -> list[str]:
    """Verdict, staircase, and where nothing known explains what is left, the picture of that."""
    rows = [(name, shown_value(g.error, "rad"), shown_share(g.alikeness[min(g.alikeness)])) for name, g in steps]
    stairs = staircase_picture([(name, g.error) for name, g in steps], steps[-1][1].repeats)
    blocks = [
        f"**{sentence}**",
        table(("model", "error E", "alike in every signal, k = 1"), rows),
        notebook.picture(stairs, "staircase", "error after each step"),
    ]
    if reason.content["verdict"] == "unknown":
        left = left_over_picture(reason.diagnosis.before, None)
        blocks.append(notebook.picture(left, "unknown", "what no known effect explains"))
    return [*blocks, f"The model, running in the simulation: {link}"]

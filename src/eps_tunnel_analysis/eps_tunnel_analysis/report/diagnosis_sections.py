# SPDX-License-Identifier: Apache-2.0
"""Sections on a diagnosis: verdict, ranking, evidence, what to do."""

import math

import numpy as np

from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.ball import part_name
from eps_tunnel_analysis.diagnose.falls import RECORDING_COLUMNS, by_recording, fall_sentences
from eps_tunnel_analysis.diagnose.rank import IMITATED, NONE, OVERLOOKED, UNKNOWN
from eps_tunnel_analysis.diagnose.verdict import in_words, percent
from eps_tunnel_analysis.outputs import shown_share, shown_unit, shown_value
from eps_tunnel_analysis.phases import channel_of, mean_command
from eps_tunnel_analysis.report.page import (
    Bar,
    Block,
    Chart,
    Facts,
    Heading,
    KeyFigures,
    Line,
    Link,
    Points,
    Section,
    Table,
    Text,
)
from labyrinth_sim.trials import Array, Trials

LISTED_HYPOTHESES = 8
LISTED_CANDIDATES = 12
EVERY = 3  # one of so many samples is plotted
LONGEST_SINCE = 1.5  # s since a reversal


def verdict(diagnosis: Diagnosis) -> Section:
    """Probabilities, and the error after each step; the sentence itself is the page's title."""
    v = diagnosis.verdict
    names = ["as given", "values refitted"]
    registry = diagnosis.base_model.registry
    names += [f"with {' and '.join(in_words(name, registry) for name in v.effects)}"] if v.effects else []
    unit = diagnosis.model.rig.position_unit
    steps = [(name, e, unit) for name, e in zip(names, (v.given, v.before, v.after), strict=False)]
    steps += [(f"the ball, {name}", e, "m") for name, e in zip(names, v.ball, strict=False)]
    repeated = diagnosis.before.real.count > 1  # the tunnel of one trial has no width, so its shares mean nothing
    shown = [(name, p) for name, p in v.set.items() if p >= 0.001][:LISTED_HYPOTHESES]
    blocks: list[Block] = [
        Table(
            ("hypothesis", "probability", "in the stated set"),
            [(_said(name), Bar(p, f"{p:.1%}"), "yes" if name in v.stated else "") for name, p in shown],
            caption=f"The stated set is the smallest that has {v.coverage:.0%} of the probability, each effect "
            "with what behaves like it.",
        ),
        Table(
            ("model", "E (equation 10)", "on held-out data", "alike, k = 1", "the rig against itself"),
            [
                (
                    name,
                    shown_value(e.error, unit),
                    shown_value(e.held_out, unit),
                    *map(shown_share, (e.alikeness if repeated else math.nan, v.rig_against_itself)),
                )
                for name, e, unit in steps
            ],
            caption="The staircase of error",
            numeric=(1, 2, 3, 4),
        ),
        KeyFigures(
            [
                (
                    f"{math.sqrt(pair[1]):.2f}",
                    f"{part_name(axis)}: misfit over noise floor",
                    f"{math.sqrt(pair[0]):.2f} before; no model goes far below 1",
                    None,
                )
                for axis, pair in v.floor.items()
            ]
        ),
    ]
    if v.effects:
        falls = fall_sentences((v.given, v.before, v.after), v.plays, unit, v.rig_against_itself, ball=False)
        blocks.append(Points(falls))
    if v.effects and len(v.plays[0]) > 1:
        rows = [one.row for one in by_recording(v.plays, unit)]
        blocks.append(Table(RECORDING_COLUMNS, rows, caption="Mean error of each recording", numeric=(2, 3, 4, 5)))
    if v.notes:
        blocks.append(Points(v.notes))
    return Section("Verdict", blocks)


def _said(name: str) -> str:
    words = {NONE: "nothing is missing", UNKNOWN: "something no known effect explains",
             OVERLOOKED: "known effects that were not found",
             IMITATED: "something else that behaves like what is named"}  # fmt: skip
    return words.get(name, name)


def ranking(diagnosis: Diagnosis) -> Section:
    """One table per axis, most probable first; then what the best could be mistaken for."""
    blocks: list[Block] = []
    for axis in diagnosis.axes:
        blocks.append(Heading(axis.part.heading))
        if not axis.refits:
            blocks.append(Text("The model with refitted values is within the noise; no candidate was tried."))
            continue
        rows: list[tuple[str, str, str | Bar, str, str]] = []
        for r in axis.ranking.ranked[:LISTED_CANDIDATES]:
            share, (low, high) = max(r.explained, 0.0), r.explained_interval
            sure = percent(r.itself)
            rows.append((r.name, sure, Bar(share, f"{share:.0%} ({low:.0%} to {high:.0%})"),
                         f"{r.cost:.2f}", f"{r.held_out:.2f}"))  # fmt: skip
        rows.append(("something unknown", percent(axis.ranking.unknown), "", "", ""))
        blocks.append(
            Table(
                ("hypothesis", "probability", "explains", "misfit left", "on held-out stretches"),
                rows,
                numeric=(1, 3, 4),
                caption="Misfit: mean square in units of the noise floor; 1 is what a perfect model leaves. Explains: "
                "share of the base's misfit beyond that, with a 90 % interval.",
            )
        )
    facts = []
    registry = diagnosis.base_model.registry
    for name in diagnosis.verdict.effects:
        effect = registry.effect(name.partition(".")[0])
        facts += [
            (name, effect.physics),
            ("what it looks like", effect.mark),
            ("could be mistaken for", ", ".join(effect.confused_with)),
            ("distinguished by", effect.separated_by),
        ]
    if facts:
        blocks.append(Facts(facts))
    return Section(
        "Why", blocks, lead="Each candidate was refitted together with the drive's values in full roll-outs."
    )


def evidence(diagnosis: Diagnosis) -> Section:
    """Four charts for each signal of an axis where something is missing; for all signals if nothing is."""
    before, after = diagnosis.before, diagnosis.after
    worth = [s for axis in diagnosis.axes if axis.refits for s in axis.part.signals if s in before.signals]
    blocks: list[Block] = []
    for signal in worth or before.signals[:1]:
        i = before.signals.index(signal)
        factor, unit = shown_unit(before.real.units[i])
        real = before.real_tunnel.mean[:, i]
        speed = np.gradient(real, before.real.step)
        residuals = [factor * (c.sim_tunnel.mean[:, i] - real) for c in (before, after)]
        blocks.append(Heading(signal))
        for label, x in (
            (f"measured {'angle' if before.real.units[i] == 'rad' else 'place'} in {unit}", factor * real),
            (f"measured speed in {unit}/s", factor * speed),
            ("time since the command reversed in s", _since_reversal(before.real, signal)),
            ("time in s", before.real.time),
        ):
            blocks.append(
                _chart(signal, label, np.asarray(x), residuals[0], residuals[1], unit, bool(diagnosis.verdict.effects))
            )
    return Section(
        "Evidence",
        blocks,
        lead="Simulation minus real. A curve or a loop in one of these is physics the model lacks; a cloud about zero "
        "is noise.",
    )


def _chart(signal: str, label: str, x: Array, before: Array, after: Array, unit: str, named: bool) -> Chart:
    order = np.argsort(x, kind="stable")
    order = order[np.isfinite(x[order])][::EVERY]
    lines = [Line("before", before[order], "sim", width=0)]
    lines += [Line("after", after[order], "real", width=0)] if named else []
    return Chart(
        x=x[order],
        lines=lines,
        x_label=label,
        y_label=f"simulation − real, {unit}",
        label=f"What is left of {signal} over {label}",
    )


def _since_reversal(real: Trials, signal: str) -> Array:
    """(T,) s since the command of a signal last changed its direction, NaN before and long after."""
    channel = channel_of(signal, real.command_channels)
    if channel is None:
        return np.full(len(real.time), np.nan)
    command = mean_command(real)[:, real.command_channels.index(channel)]
    moves = np.sign(np.diff(np.nan_to_num(command), prepend=0.0))
    since = np.full(len(moves), np.nan)
    last, at = 0.0, -1
    for k, move in enumerate(moves):
        if move and move != last:
            at, last = k, move
        if at >= 0:
            since[k] = (k - at) * real.step
    return np.where(since <= LONGEST_SINCE, since, np.nan)


def what_to_do(diagnosis: Diagnosis, add: str) -> Section:
    """The deciding experiment, if one is needed, how to add effects, and what was fitted, with units."""
    v = diagnosis.verdict
    blocks: list[Block] = []
    if v.verdict == "effect":
        blocks += [Text("Effects of your own choice are added by:"), Facts([("choose", add)])]
    if diagnosis.experiment:
        e = diagnosis.experiment
        blocks += [
            Text(e.reason),
            Facts(
                [
                    ("play", Link("next_experiment.yaml", "next_experiment.yaml", f" ({e.name})")),
                    ("then", "diagnose all recordings together"),
                ]
            ),
        ]
    if v.values:
        units = diagnosis.model.parameters()
        rows = [(name, *shown_parameter(value, units[name].unit)) for name, value in v.values.items()]
        blocks.append(Table(("value", "fitted", "unit"), rows, numeric=(1,), caption="What was fitted"))
    return Section("What to do", blocks)


def shown_parameter(value: float, unit: str) -> tuple[str, str]:
    """A fitted value and its unit; angles in degrees, as everywhere on the page."""
    factor, name = shown_unit(unit)
    return f"{factor * value:.5g}", name

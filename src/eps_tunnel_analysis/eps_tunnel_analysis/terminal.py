# SPDX-License-Identifier: Apache-2.0
"""Results and progress on the terminal; plain text where the output is no terminal."""

import io
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.box import ASCII2, SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from eps_tunnel_analysis.outputs import shown_number, shown_share, shown_value

if TYPE_CHECKING:
    from eps_tunnel_analysis.calibration.calibrate import Bars, CalibrationResult, Score
    from eps_tunnel_analysis.compare import Comparison
    from eps_tunnel_analysis.diagnose.progress import RolloutProgress
    from eps_tunnel_analysis.diagnose.verdict import PlayError, Verdict
    from eps_tunnel_analysis.fit.evaluations import FitProgress
    from eps_tunnel_analysis.fit.problem import Part

WIDE = 160  # columns where the output is a file or a pipe
LEAST_LISTED = 0.001  # probability below which a hypothesis is not listed
LINE_EVERY = 0.2  # s between two lines of progress
SPEAK_EVERY = 15.0  # s between two lines of progress where there is no terminal
ITSELF = "rig against itself"
RECORDINGS_LISTED = 10  # recordings of a fit


def console(stderr: bool = False) -> Console:
    """Colours and the terminal's width on a terminal; neither elsewhere."""
    out = Console(stderr=stderr, highlight=False, soft_wrap=False)
    return out if out.is_terminal else Console(stderr=stderr, highlight=False, width=WIDE, no_color=True)


def text_of(show: Callable[[Console], None], width: int = 100) -> str:
    """What a function prints, as plain text of lines no longer than `width` where they can be broken."""
    out = Console(file=io.StringIO(), highlight=False, width=width, no_color=True)
    show(out)
    return str(out.file.getvalue())  # type: ignore[attr-defined]


def table(out: Console, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> None:
    """Prints a table whose first `left` columns are words and the others numbers."""
    box = SIMPLE_HEAD if out.is_terminal and not out.legacy_windows else ASCII2
    made = Table(title=title, title_justify="left", title_style="bold", box=box, header_style="")
    for i, name in enumerate(columns):
        made.add_column(name, justify="left" if i < left else "right", overflow="fold")
    for row in rows:
        made.add_row(*row)
    out.print(made)


def print_comparison(comparison: "Comparison", notes: Sequence[str] = (), out: Console | None = None) -> None:
    """Tables of alikeness and error, where the simulation fails in words, and notes."""
    from eps_tunnel_analysis.phases import sentences

    out = out or console()
    ks = [a.k_real for a in comparison.alikeness]
    trials = comparison.real.count
    title = f"Alikeness, {trials} real trial{'s' * (trials > 1)} of {len(comparison.real.time)} samples"
    rows: list[tuple[str, ...]] = []
    for curve in comparison.curves:
        # The tunnel of one trial has no width, so its shares mean nothing.
        rows.append((curve.name, *(shown_share(share if trials > 1 else math.nan) for share in curve.shares)))
        rows += [(f"  {ITSELF}", *map(shown_share, curve.itself))] if curve.itself else []
    table(out, title, ("signal", *(f"k = {k:g}" for k in ks)), rows)
    table(
        out,
        "Error, simulation minus real",
        ("signal", "E (eq. 10)", "RMS", "bias", "worst", "at", "rig repeats within"),
        [
            (
                e.signal,
                *(shown_value(v, e.unit) for v in (e.command_error, e.rms, e.bias, e.worst)),
                f"{e.worst_time:.2f} s",
                shown_value(e.repeat_rms, e.unit),
            )
            for e in comparison.errors
        ],
    )  # fmt: skip
    words = sentences(comparison.where)
    if words:
        out.print("Where it fails", style="bold")
    for sentence in words:
        out.print(f"  {sentence}", soft_wrap=True)
    print_notes(out, (*notes, *comparison.notes))


def print_calibration(result: "CalibrationResult", notes: Sequence[str], out: Console | None = None) -> None:
    """Values and errors, before and after, as tables on the terminal."""
    from eps_tunnel_analysis.alikeness import KS

    out = out or console()
    for part, fit in zip(result.parts, result.fits, strict=True):
        scale, unit = (100.0, "%") if fit.fitness == "srg" else (1.0, result.before[0].unit)
        rows = [
            (
                p.name,
                f"{p.start:.5g}",
                f"{p.value:.5g}",
                "–" if math.isnan(p.half_width) else f"± {shown_number(p.half_width, 2)}",
                p.unit,
                "at its bound" if p.at_bound else "",
            )
            for p in fit.parameters
        ]
        table(
            out,
            f"Parameters{f' of axis {part.axis}' if part.axis else ''}: {fit.method}, {fit.evaluations} evaluations, "
            f"{fit.seconds:.1f} s, fitness {scale * fit.before:.4g} -> {scale * fit.after:.4g} {unit}",
            ("parameter", "before", "after", "95 %", "unit", ""),
            rows,
        )
    _print_scores(out, KS, "Fitted commands", result.before, result.after, result.itself)
    _print_scores(out, KS, "Held-out commands", result.held_out_before, result.held_out_after, result.held_out_itself)
    if len(result.plays) > 1:
        by_play = [
            (
                p.name,
                "held out" if p.held_out else "fitted",
                shown_value(p.before, p.unit),
                shown_value(p.after, p.unit),
                f"{p.change - 1:+.0%}",
            )
            for p in result.plays[:RECORDINGS_LISTED]
        ]
        count = len(result.plays)
        some = f", the worst {RECORDINGS_LISTED} of {count}" if count > RECORDINGS_LISTED else ""
        table(
            out, f"Error of each recording{some}", ("recording", "", "E before", "E after", "change"), by_play, left=2
        )
    for text in result.warnings:
        out.print(f"Warning: {text}", soft_wrap=True, markup=False)
    print_notes(out, notes)


def _print_scores(
    out: Console, ks: Sequence[float], title: str, before: "tuple[Score, ...]", after: "tuple[Score, ...]",
    itself: Mapping[str, Mapping[float, float]],
) -> None:  # fmt: skip
    if not after:
        return
    rows = []
    for b, a in zip(before, after, strict=True):
        errors = (shown_value(score.error, score.unit) for score in (b, a))
        rows.append(
            (b.signal, *errors, *(f"{shown_share(b.alikeness[k])} -> {shown_share(a.alikeness[k])}" for k in ks))
        )
        if rig := itself.get(b.signal):
            rows.append((f"  {ITSELF}", "", "", *(shown_share(rig[k]) for k in ks)))
    table(
        out, f"{title}, before and after", ("signal", "E before", "E after", *(f"alike, k = {k:g}" for k in ks)), rows
    )


def print_verdict(verdict: "Verdict", notes: Sequence[str] = (), out: Console | None = None, unit: str = "rad") -> None:
    """The sentence, the hypotheses as a table, by how much the error fell, and notes.

    Args:
        unit: of the errors, the rig's `position_unit`.
    """
    from eps_tunnel_analysis.diagnose.falls import fall_sentences

    out, v = out or console(), verdict
    out.print(v.sentence, style="bold", soft_wrap=True, markup=False)
    rows = [(name, f"{p:.1%}", "*" if name in v.stated else "") for name, p in v.set.items() if p >= LEAST_LISTED]
    table(out, "Hypotheses", ("hypothesis", "probability", "in the stated set"), rows)
    if v.effects:
        print_recordings(out, v.plays, unit)
        for line in fall_sentences((v.given, v.before, v.after), v.plays, unit, v.rig_against_itself, ball=False):
            out.print(line, soft_wrap=True, markup=False)
    print_notes(out, (*notes, *v.notes))


def print_recordings(out: Console, plays: "Sequence[Sequence[PlayError]]", unit: str) -> None:
    """The error of each recording by three models as a table, where there are several."""
    from eps_tunnel_analysis.diagnose.falls import RECORDING_COLUMNS, by_recording

    if len(plays[0]) > 1:
        table(out, "Error of each recording", RECORDING_COLUMNS, [r.row for r in by_recording(plays, unit)], left=2)


def print_notes(out: Console, notes: Sequence[str]) -> None:
    """Each once; a warning is called that."""
    for note in dict.fromkeys(notes):
        out.print(note if note.startswith("Warning: ") else f"Note: {note}", soft_wrap=True, markup=False)


def print_next(out: Console, words: str, command: str) -> None:
    """What to do next: in words, and the command on a line of its own, to be copied."""
    out.print(words, soft_wrap=True, markup=False)
    if command:
        out.print(f"  {command}", soft_wrap=True, markup=False)


@contextmanager
def fit_bars(kind: str) -> "Iterator[Bars | None]":
    """What shows the progress of `calibrate_model`: "bar", "lines" (one JSON object each) or "none"."""
    if kind == "none":
        yield None
        return
    if kind == "lines":
        yield _fit_lines
        return
    open_bars: list[Any] = []

    def new(part: "Part", budget: int) -> "FitProgress":
        _close(open_bars)
        name = f"axis {part.axis} " if part.axis else ""
        bar: Any = tqdm(
            total=budget, desc=f"{name}evaluations", unit="", file=sys.stderr, dynamic_ncols=True, leave=True
        )
        open_bars.append(bar)

        def show(count: int, best: float) -> None:
            bar.total = max(budget, count)
            bar.set_postfix_str(f"best {best:.6g}", refresh=False)
            bar.update(count - bar.n)

        return show

    try:
        yield new
    finally:
        _close(open_bars)


def _close(open_bars: list[Any]) -> None:
    while open_bars:
        open_bars.pop().close()


@contextmanager
def rollout_progress(kind: str = "bar") -> "Iterator[RolloutProgress | None]":
    """How far it is and how long it will take, on stderr.

    A "bar" where that is a terminal, and elsewhere a plain line every SPEAK_EVERY; by "lines" one JSON object each;
    or "none".
    """
    if kind == "lines":
        yield _rollout_lines()
        return
    if kind == "none":
        yield None
        return
    if not sys.stderr.isatty():
        yield _spoken()
        return
    with tqdm(desc="roll-outs", unit="", file=sys.stderr, dynamic_ncols=True) as bar:

        def show(what: str, count: int, of: int = 0, /) -> None:
            if bar.desc != f"{what}: ":
                bar.set_description(what)
            if count < bar.n:
                bar.reset()
            bar.total = of or None
            bar.update(count - bar.n)

        yield show


def _spoken() -> "RolloutProgress":
    """Plain lines, for a file or a pipe that a person watches; nothing of what is over before the first is due."""
    began = last = time.monotonic()

    def show(what: str, count: int, of: int = 0, /) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < SPEAK_EVERY:
            return
        last = now
        print(rollout_line(what, count, of, now - began), file=sys.stderr, flush=True)

    return show


def rollout_line(what: str, count: int, of: int, seconds: float) -> str:
    """How far it is after `seconds`, and about how long it will take, as a line of words."""
    line = f"{what}: {count:,}{f' of about {of:,}' if of else ''} roll-outs in {seconds:.0f} s"
    return line + (f", about {seconds * (of - count) / count:.0f} s to go" if of > count > 0 else "")


def _fit_lines(part: "Part", budget: int) -> "Callable[[int, float], None]":
    last = 0.0

    def show(count: int, best: float) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            line = {"axis": part.axis, "evaluations": count, "of": max(budget, count), "best": best}
            print(json.dumps(line), file=sys.stderr, flush=True)

    return show


def _rollout_lines() -> "RolloutProgress":
    last = 0.0

    def show(what: str, count: int, of: int = 0, /) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            print(json.dumps({"doing": what, "rollouts": count, "of": of}), file=sys.stderr, flush=True)

    return show

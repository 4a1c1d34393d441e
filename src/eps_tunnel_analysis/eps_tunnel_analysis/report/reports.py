# SPDX-License-Identifier: Apache-2.0
"""Reports and their files: of a comparison, of a diagnosis, of one iteration of the loop."""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.calibration.validity import validity_of
from eps_tunnel_analysis.check.check import Check
from eps_tunnel_analysis.compare import JOINTLY, Comparison
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.falls import Three
from eps_tunnel_analysis.diagnose.named_intervals import intervals_json, named_intervals
from eps_tunnel_analysis.inputs import Recorded
from eps_tunnel_analysis.law.proposal import Proposal
from eps_tunnel_analysis.outputs import circumstances, json_text, plain, shown_share, shown_value, today, versions
from eps_tunnel_analysis.report.comparison_sections import (
    at_a_glance,
    errors,
    headline,
    over_k,
    provenance,
    summary,
    tunnels,
    where_it_fails,
)
from eps_tunnel_analysis.report.diagnosis_sections import evidence, ranking, verdict, what_to_do
from eps_tunnel_analysis.report.law_section import law
from eps_tunnel_analysis.report.next_step import MODEL_FILE, next_commands, next_step
from eps_tunnel_analysis.report.page import Block, Chart, Line, Points, Section, Table, render
from eps_tunnel_analysis.report.pictures import last_model, write_pictures
from labyrinth_sim.model import Model, save_model

SECTIONS: tuple[Callable[[Comparison], Section], ...] = (summary, tunnels, over_k, where_it_fails, errors)


@dataclass(frozen=True)
class Findings:
    """A diagnosis of recordings and what goes with it.

    Attributes:
        recorded: what was diagnosed.
        proposal: a law, if the verdict is "unknown".
        checked: quality of the recordings and what they can identify.
    """

    diagnosis: Diagnosis
    recorded: Recorded
    proposal: Proposal | None = None
    checked: Check | None = None


def compare_report(
    comparison: Comparison,
    name: str,
    facts: Sequence[tuple[str, str]],
    step: tuple[str, str] = ("", ""),
    at: Path | None = None,
    checked: Sequence[str] = (),
) -> str:
    """The page as HTML, its title the comparison in a sentence.

    Args:
        name: of the simulation.
        facts: what was compared: bags, hashes, model, versions.
        step: what to do next: a sentence and a command.
        at: the folder in which the page will be found, for links.
        checked: findings on the real recordings, the serious first.
    """
    trials, seconds = comparison.real.count, comparison.real.time[-1] + comparison.real.step
    subtitle = f"{name} against {_trials(trials)}: {', '.join(comparison.signals)}, {seconds:.1f} s"
    found = [section(comparison) for section in SECTIONS]
    sections = [at_a_glance(comparison, step), *_recordings(checked), *found, provenance(facts, at)]
    return render(headline(comparison, name), subtitle, sections)


def _recordings(checked: Sequence[str]) -> list[Section]:
    """What needs attention, and, folded, all other findings of the check of the recordings; none without a check."""
    serious = [line.removeprefix("! ") for line in checked if line.startswith("! ")]
    rest = [line for line in checked if not line.startswith("! ")]
    blocks: list[Block] = [Points(serious)] if serious else []
    others = "Other findings" if serious else "Nothing needs attention; findings"
    blocks += [Points(rest, f"{others}, in {len(rest)} sentence{'s' * (len(rest) > 1)}")] if rest else []
    return [Section("What the recordings can identify", blocks)] if blocks else []


def _trials(count: int) -> str:
    return f"{count} real trial{'s' * (count > 1)}"


def write_comparison(
    folder: Path, comparison: Comparison, content: Mapping[str, Any], name: str, facts: Sequence[tuple[str, str]],
    step: tuple[str, str], at: Path, pictures: bool = True, checked: Sequence[str] = (),
) -> None:  # fmt: skip
    """Writes into an existing, empty folder.

    Args:
        content: what compare.json holds, at least `comparison.to_json()`.
        name: of the simulation.
        facts: what was compared, for the end of the report.
        step: what to do next: a sentence and a command.
        at: final name of the folder.
        pictures: also as files, which takes a few seconds.
        checked: findings on the real recordings, the serious first.
    """
    page = compare_report(comparison, name, facts, step, at, checked)
    (folder / "report.html").write_text(page, encoding="utf-8")
    (folder / "compare.json").write_text(json_text(content), encoding="utf-8")
    _csv(folder / "alikeness.csv", *_over_k(comparison))
    for file in ("errors", "where", "spans"):
        rows = content[file]
        _csv(folder / f"{file}.csv", tuple(rows[0]) if rows else ("signal",), (tuple(row.values()) for row in rows))
    _csv(folder / "tunnel.csv", *_tunnel(comparison))
    if pictures:
        write_pictures(comparison, folder)


def _tunnel(comparison: Comparison) -> tuple[Sequence[str], Iterable[Sequence[float]]]:
    """Header and rows in SI units, one per sample."""
    real, sim = comparison.real_tunnel, comparison.sim_tunnel
    columns = {
        "mean": real.mean,
        "lower": real.lower,
        "upper": real.upper,
        "sim": sim.mean,
        "sim_lower": sim.lower,
        "sim_upper": sim.upper,
    }
    header = ["time", *(f"{name}_{what}" for name in comparison.signals for what in columns)]
    signals = range(len(comparison.signals))
    rows = ((t, *(a[n, i] for i in signals for a in columns.values())) for n, t in enumerate(real.time))
    return header, rows


def _over_k(comparison: Comparison) -> tuple[Sequence[str], Iterable[Sequence[float]]]:
    """Header and rows, one per factor k; the rig against itself in separate columns, if known."""
    names, rig = comparison.signals, comparison.against_itself
    header = ["k", *names, JOINTLY, *(f"{name}_rig" for name in (*names, JOINTLY) if rig)]
    rows = [[a.k_real, *(a.shares[n] for n in names), a.joint] for a in comparison.alikeness]
    for row, a in zip(rows, rig, strict=False):
        row += [*(a.shares[n] for n in names), a.joint]
    return header, rows


def _csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)


def diagnosis_report(
    found: Findings, subtitle: str, step: tuple[str, str], add: str, facts: Sequence[tuple[str, str]], at: Path
) -> str:
    """The page as HTML, its title the verdict.

    Args:
        step: what to do next: a sentence and a command.
        add: the command that adds effects by choice.
        facts: what was diagnosed.
        at: the folder in which the page will be found, for links.
    """
    diagnosis, proposal, checked = found.diagnosis, found.proposal, found.checked
    last = last_model(diagnosis.verdict) if diagnosis.verdict.verdict == "undecided" else "after"
    sections = [
        at_a_glance(diagnosis.after, step, diagnosis.given, after=last),
        *_recordings(checked.lines() if checked else ()),
        verdict(diagnosis),
        where_it_fails(diagnosis.before),
        ranking(diagnosis),
        evidence(diagnosis),
        *([law(proposal)] if proposal else []),
        what_to_do(diagnosis, add),
        tunnels(diagnosis.after),
        provenance(facts, at),
    ]
    return render(diagnosis.verdict.sentence, subtitle, sections)


def write_diagnosis(folder: Path, out: Path, findings: Findings, real: Sequence[Path], model: str) -> dict[str, Any]:
    """Writes diagnosis.json, report.html, model.yaml; where there are, the next experiment and the proposal's files.

    The model has the named effects, fitted; where none is named, its own values are refitted.

    Args:
        folder: to write into; it becomes `out`.
        real, model: as the user named them, for the commands to run next.

    Returns:
        The JSON's content.
    """
    diagnosis, recorded, proposal, checked = findings.diagnosis, findings.recorded, findings.proposal, findings.checked
    v = diagnosis.verdict
    content = diagnosis_content(diagnosis, recorded) | ({"check": checked.to_json()} if checked else {})
    save_model(better_model(diagnosis, recorded), folder / MODEL_FILE)
    if proposal:
        content["proposed_effect"] = plain(proposal.to_json())
        proposal.write(folder)
    (folder / "diagnosis.json").write_text(json_text(content), encoding="utf-8")
    if diagnosis.experiment:
        (folder / "next_experiment.yaml").write_text(diagnosis.experiment.to_yaml(), encoding="utf-8")
    facts = [
        ("model", recorded.model.name),
        *[("real bag", f"{path} (SHA-256 {digest[:12]})") for path, digest in recorded.bags],
        *[("note", note) for note in recorded.notes],
        *circumstances(),
    ]
    trials = sum(play.trials.count for play in recorded.plays)
    subtitle = f"What {recorded.model.name} lacks, by {_trials(trials)} and {v.evaluations:,} roll-outs"
    _, add = next_commands(v.effects, recorded, real, model, out)
    step = next_step(diagnosis, recorded, real, model, out, proposal)
    files = [(file.name, str(out / file.name)) for file in sorted(folder.iterdir())]
    page = diagnosis_report(findings, subtitle, step, add, [*facts, *files], out)
    (folder / "report.html").write_text(page, encoding="utf-8")
    return content


def model_provenance(recorded: Recorded, effects: Sequence[str], errors: Three) -> dict[str, Any]:
    """Provenance of a model that was fitted to recordings, for its file."""
    given, before, after = errors
    return {
        **recorded.model.provenance,
        **({"added": list(effects)} if effects else {}),
        "bags": [f"{path} {digest[:12]}" for path, digest in recorded.bags],
        "date": today(),
        "held_out_as_given": given.held_out,
        "held_out_before": before.held_out,
        "held_out_after": after.held_out,
    }


def was_fitted(recorded: Recorded) -> bool:
    """Whether the model comes from a diagnosis of these very recordings, so that its values were fitted to them."""
    provenance = recorded.model.provenance
    if "held_out_as_given" not in provenance:  # a calibration searches elsewhere
        return False
    digests = {str(bag).split()[-1] for bag in provenance.get("bags", ())}
    return digests == {digest[:12] for _, digest in recorded.bags}


def better_model(diagnosis: Diagnosis, recorded: Recorded) -> Model:
    """The model with the named effects; if none is named, the given model with its values refitted."""
    v = diagnosis.verdict
    named, last = (v.effects, v.after) if v.verdict == "effect" else ((), v.before)
    better = diagnosis.model if named else diagnosis.base_model
    provenance = model_provenance(recorded, named, (v.given, v.before, last))
    better = replace(better, rig=recorded.model.rig, provenance=provenance, path=None)
    return replace(better, valid=validity_of(better, recorded.plays, recorded.held, recorded.bags))


def diagnosis_content(diagnosis: Diagnosis, recorded: Recorded) -> dict[str, Any]:
    """diagnosis.json."""
    return {
        "command": "diagnose",
        "versions": versions(),
        "model": recorded.model.name,
        "sources": [[str(path), digest] for path, digest in recorded.bags],
        **diagnosis.verdict.to_json(),
        "intervals": plain(intervals_json(named_intervals(diagnosis.axes, diagnosis.verdict.effects, diagnosis.model))),
    }


def before_after(before: Comparison, after: Comparison) -> list[tuple[str, str, str]]:
    """Rows of (what, before, after): E of each signal that both have (equation 10), and the joint alikeness by k."""
    old, new = ({e.signal: e for e in c.errors} for c in (before, after))
    rows = [
        (f"error E of {s}", shown_value(e.command_error, e.unit), shown_value(new[s].command_error, e.unit))
        for s, e in old.items()
        if s in new
    ]
    for a, b in zip(before.alikeness, after.alikeness, strict=True):
        rows.append((f"alike in every signal, k = {a.k_real:g}", shown_share(a.joint), shown_share(b.joint)))
    for c, d in zip(before.against_itself, after.against_itself, strict=False):
        rows.append((f"the rig against itself, k = {c.k_real:g}", shown_share(c.joint), shown_share(d.joint)))
    return rows


def loop_report(
    before: Comparison, diagnosis: Diagnosis, after: Comparison, sentences: Sequence[str],
    facts: Sequence[tuple[str, str]], step: tuple[str, str], at: Path,
) -> str:  # fmt: skip
    """The page as HTML, its title the first sentence.

    Args:
        sentences: what was found and how much it helped.
        facts: where the files are.
        step: what to do next: a sentence and a command.
        at: the folder in which the page will be found, for links.
    """
    loop: list[Block] = [
        Table(
            ("", "before", "after"),
            before_after(before, after),
            caption=f"Each from {before.real.count} and {after.real.count} trials that were played on both sides.",
            numeric=(1, 2),
        ),
        _both_over_k(before, after),
    ]
    sections = [
        at_a_glance(after, step, before, sentences[1:]),
        Section("The loop", loop),
        replace(where_it_fails(before), title="Where it failed"),
        replace(verdict(diagnosis), title="Why"),
        evidence(diagnosis),
        replace(tunnels(after), title="The gap afterwards"),
        provenance(facts, at),
    ]
    trials = before.real.count + after.real.count
    return render(
        sentences[0], f"From the gap to its reason: {trials} real trials, {', '.join(before.signals)}", sections
    )


def _both_over_k(before: Comparison, after: Comparison) -> Chart:
    lines = [
        Line(name, 100 * np.array([a.joint for a in c.alikeness]), colour, width=2, points=True)
        for name, c, colour in (("before", before, "sim"), ("after", after, "real"))
    ]
    if after.against_itself:
        itself = 100 * np.array([a.joint for a in after.against_itself])
        lines.append(Line("the rig against itself", itself, "muted", dash=True, points=True))
    return Chart(
        x=np.array([a.k_real for a in after.alikeness]),
        lines=lines,
        x_label="k, factor on the real tunnel's width",
        y_label="alikeness in %",
        y_range=(-3, 103),
        label="Share of samples alike in every signal over k, before and after",
    )

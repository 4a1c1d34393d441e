# SPDX-License-Identifier: Apache-2.0
"""Writes what the runs of benchmarks/diagnosis.py measured into docs/diagnosis.md, between its two marks.

    python benchmarks/study_table.py

A run is a file in benchmarks/records with an entry in RUNS. To add one: copy the JSON file of the benchmark there.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from counting import VISIBLE, Figure, Record, figures, is_right, reliability

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "diagnosis.md"
BEGIN, END = "<!-- study: written by benchmarks/study_table.py -->", "<!-- end of the study -->"
RUNS = {  # file in benchmarks/records: what was new
    "diagnosis": "",
    "diagnosis_later": "free curves as rivals of sums of effects",
    "diagnosis_latest": "ticks and further effects are tried beside a little of each of the best",
    "diagnosis_newest": "half of the noise must be explained where no trial is repeated",
    "diagnosis_fresh": "a share for what imitates an effect",
    "diagnosis_visible": "from here on only what shows is judged",
    "diagnosis_next": "descents without the shortest steps; no drift by chance",
    "diagnosis_rivals": "a rival that fits as well calls for a further effect",
    "diagnosis_again": "sets start again after the steps were refined",
    "diagnosis_forms": "friction of bearings, uneven sensors of drives; general forms that leave noise",
    "diagnosis_stated": "stated values may be simply wrong",
    "diagnosis_order": "pairs grow from the best effect; general and simple forms start from one another",
    "diagnosis_settled": "descents at short steps take their own slopes; those near the best go on until they rest",
    "diagnosis_supply": "one supply for all axes; simple forms hold no general one back",
    "diagnosis_limits": "limits reach further; from 870460 on cut-backs leave back-EMF out, limits may be soft",
    "diagnosis_held": "from 870488 on cut-backs are searched for in held roll-outs; 870487 took over half an hour",
    "diagnosis_rested": "from 870515 on a base near the floor is descended until it rests",
    "diagnosis_compiled": "the same diagnosis, faster",
    "diagnosis_starts": "from 870585 on starts are read rightly; from 870640 on what is left is not drawn at random",
    "diagnosis_shows": "tried: what an effect leaves ends at 9 floors",
    "diagnosis_curves": "any effect may replace one of several; an error of a form counts as a smooth curve",
    "diagnosis_woken": "values that show only far from what is stated are fitted there",
    "diagnosis_quick": "as before, nine minutes on 16 cores: what takes longer is missing",
    "diagnosis_begun": "roll-outs begin behind biased sensors; commands have acted on axes at rest (from 870803 on)",
    "diagnosis_ends": "ends where nothing explains; forms end before the noise; 870818 before the rule for one trial",
    "diagnosis_needed": "form's share said once; 870866 on: ranked beside fewer effects, the best calls for more",
    "diagnosis_kinds": "as the end of the last row; 870895 on: where little is left, own values only",
    "diagnosis_bearings": "the library's size moves no path; 870918 on: bearings by direction, a share for each set",
    "diagnosis_split": "as the end of the last row",
    "diagnosis_reached": "limits that a descent never reached are looked for; as tried, longer steps chose dampings",
    "diagnosis_efforts": "before efforts of smooth motion; five were looked at again with these, the same",
    "diagnosis_trials": "efforts of smooth motion count; from 871048 on a single trial's further effects, too",
    "diagnosis_jumps": "efforts under held commands are not extrapolated; before sets were tried far along valleys",
    "diagnosis_likely": "ticks and waves of commands begin at the likeliest",
    "diagnosis_limited": "drives near their limits are limited at the end of a step",
}
SHARED = "diagnosis_fresh"  # the first run with a share for imitators, from which on probabilities mean the same
COLUMNS = {
    "single": "visible_right", "pair": "pair_both", "unknown": "unknown_found", "false alarms": "false_alarm",
    "over 95 %, wrong": "stated_above_95_wrong",
}  # fmt: skip
KEYS = {  # key: what it means, and the bar
    "visible_right": ("single effects that show at over 3 times the floor: named right", "≥ 0.90"),
    "visible_undecided": ("the same: undecided, with the truth in the stated set", "≤ 0.08"),
    "visible_wrong": ("the same: anything else", "≤ 0.02"),
    "visible_misnamed": ("the same: another effect named", ""),
    "refitted_visible_right": ("those that show so much once the drive's values are refitted: named right", ""),
    "refitted_visible_undecided": ("the same: undecided, with the truth in the stated set", ""),
    "refitted_visible_wrong": ("the same: anything else", ""),
    "false_alarm": ("healthy rigs that are said to lack something", "≤ 0.02"),
    "false_alarm_upper95": ("upper end of its interval", "≤ 0.04"),
    "false_alarm_named": ("healthy rigs on which an effect is named", ""),
    "unknown_found": ("outside the library, or left out of it, at over 3 times the floor: called unknown", "≥ 0.90"),
    "unknown_found_outside": ("outside the library", ""),
    "unknown_found_left_out": ("left out of the library", ""),
    "unknown_as_good_as_true_form": ("left out, and what is named instead predicts as well as the true form", ""),
    "pair_both": ("both of a pair named, and nothing else", "≥ 0.75"),
    "calibration_error": ("expected calibration error of the likeliest hypothesis", "≤ 0.05"),
    "calibration_error_by_chance": ("the same in the mean if every probability were exactly right", ""),
    "stated_above_95_wrong": ("wrong, of what was given more than 95 %", "≤ 0.05"),
    "drop_vs_true_form": ("fall of the held-out error over that of the true form fitted on its own, median", "≥ 0.9"),
    "log_score": ("mean logarithm of the probability given to what is true", ""),
    "failed": ("ended with an error", "0"),
    "median_seconds": ("one diagnosis, s, median", ""),
}
OF_PROBABILITIES = ("calibration_error", "calibration_error_by_chance", "stated_above_95_wrong", "log_score")
BANDS = ((3.0, 10.0), (10.0, float("inf")))  # of visibility, times the floor


def page(runs: dict[str, dict[str, Any]]) -> str:
    """The part of the page, in Markdown."""
    names = list(runs)
    every = [r for content in runs.values() for r in content["cases"]]
    shared = [r for name in names[names.index(SHARED) :] for r in runs[name]["cases"]]
    kinds = Counter(r["kind"] for r in every)
    counts = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in sorted(kinds.items()))
    lines = [
        "Each run with the code of its day, on seeds that were drawn for it: how many of how many.",
        "",
        f"| seeds | cases | {' | '.join(COLUMNS)} | new |",
        "|---|---|" + "---|" * len(COLUMNS) + "---|",
        *(_run(content, RUNS[name]) for name, content in runs.items()),
        "",
        f"All {len(every)} cases together: {counts}.",
        f"In brackets: how many cases speak to a figure. Intervals are of 95 %. What concerns probabilities is of the "
        f"{len(shared)} cases",
        "since effects have a share for what imitates them.",
        "",
        "| key | means | measured | interval | bar |",
        "|---|---|---|---|---|",
        *_keys(figures(every), figures(shared)),
        "",
        *_by_effect(every),
        "",
        *_reliability(shared),
        "",
        *_misses(every),
    ]
    return "\n".join(lines) + "\n"


def _run(content: dict[str, Any], new: str) -> str:
    """One run as a row."""
    measured = figures(content["cases"])
    cells = (_count(measured[key]) for key in COLUMNS.values())
    return f"| {_seeds(content)} | {len(content['cases'])} | {' | '.join(cells)} | {new} |"


def _count(figure: Figure) -> str:
    return f"{round((figure.value or 0.0) * figure.n)} of {figure.n}" if figure.n else ""


def _seeds(content: dict[str, Any]) -> str:
    """From the first to the last, and those between that were not run; what does not show was drawn as well."""
    run = sorted([*content.get("passed_over", []), *(r["seed"] for r in content["cases"])])
    missing = sorted(set(range(run[0], run[-1])) - set(run))
    left_out = f" without {', '.join(map(str, missing))}" if missing else ""
    return f"{run[0]} to {run[-1]}{left_out}"


def _keys(every: dict[str, Figure], shared: dict[str, Figure]) -> Iterator[str]:
    for key, (means, bar) in KEYS.items():
        figure = (shared if key in OF_PROBABILITIES else every)[key]
        if figure.value is not None and figure.interval is not None:
            low, high = figure.interval
            yield f"| `{key}` | {means} | {figure.value:.3f} ({figure.n}) | {low:.3f} to {high:.3f} | {bar} |"


def _by_effect(records: Sequence[Record]) -> Iterator[str]:
    """How often single effects were named right, by visibility."""
    cells: dict[tuple[str, int], list[bool]] = defaultdict(list)
    for r in (r for r in records if r["kind"] == "single" and r["visibility"] > VISIBLE):
        band = next(i for i, (low, high) in enumerate(BANDS) if low <= r["visibility"] < high)
        cells[r["truth"].partition(".")[0], band].append(is_right(r))
    heads = [f"{low:g} to {high:g}" if high < float("inf") else f"over {low:g}" for low, high in BANDS]
    yield "Single effects named right, of how many, by how many times the floor they show:"
    yield ""
    yield f"| effect | {' | '.join(heads)} |"
    yield "|---|" + "---|" * len(BANDS)
    for name in sorted({name for name, _ in cells}):
        row = (cells.get((name, i), []) for i in range(len(BANDS)))
        yield f"| {name} | " + " | ".join(f"{sum(c)} of {len(c)}" if c else "" for c in row) + " |"


def _reliability(records: Sequence[Record]) -> Iterator[str]:
    yield 'How often the likeliest hypothesis was true; of what shows below the floor, "none" counts as true:'
    yield ""
    yield "| it was given | cases | on average | was true | interval |"
    yield "|---|---|---|---|---|"
    for r in reliability(records):
        low, high = r["interval"]
        yield (
            f"| {r['from']:.0%} to {r['to']:.0%} | {r['n']} | {r['stated']:.1%} | {r['true']:.1%} "
            f"| {low:.0%} to {high:.0%} |"
        )


def _misses(records: Sequence[Record]) -> Iterator[str]:
    shown = [r for r in records if r["kind"] == "healthy" or r["visibility"] > VISIBLE]
    missed = [r for r in shown if not is_right(r)]
    yield f"Not named right are {len(missed)} of {len(shown)} that are healthy or show at over 3 times the floor:"
    yield ""
    yield "| seed | rig | hidden | shows | verdict | stated set |"
    yield "|---|---|---|---|---|---|"
    for r in missed:
        stated = ", ".join(r["stated"][:3]) + (f" and {len(r['stated']) - 3} more" if len(r["stated"]) > 3 else "")
        hidden = " + ".join(f"{h['effect']}.{h['place']} ({h['form']})" for h in r.get("hidden", ())) or r["truth"]
        kind = f"{r['kind'].replace('_', ' ')}: " if r["kind"] in ("outside", "left_out") else ""
        rig = f"{r['rig']}, {r['law']}"
        yield f"| {r['seed']} | {rig} | {kind}{hidden} | {r['visibility']:.1f} | {r['verdict']} | {stated} |"


def main() -> None:
    """Rewrites the page's part."""
    runs = {
        name: json.loads((ROOT / "benchmarks" / "records" / f"{name}.json").read_text(encoding="utf-8"))
        for name in RUNS
    }
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n{page(runs)}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

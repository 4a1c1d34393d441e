# SPDX-License-Identifier: Apache-2.0
"""Writes what a run of benchmarks/diagnosis.py measured into docs/diagnosis.md, between its two marks.

python benchmarks/study_table.py out.json

With --later NAME a shorter table of a run that followed, between two marks with that name.
"""

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from counting import Figure, Record, figures, is_right, is_undecided, reliability

PAGE = Path(__file__).resolve().parents[1] / "docs" / "diagnosis.md"
BEGIN, END = "<!-- study: written by benchmarks/study_table.py -->", "<!-- end of the study -->"
LATER = "<!-- {0} cases: written by benchmarks/study_table.py --later {0} -->", "<!-- end of the {0} cases -->"
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
    "pair_both": ("both of a pair named, and nothing else", "≥ 0.75"),
    "calibration_error": ("expected calibration error of the likeliest hypothesis", "≤ 0.05"),
    "stated_above_95_wrong": ("wrong, of what was given more than 95 %", "≤ 0.05"),
    "drop_vs_true_form": ("fall of the held-out error over that of the true form fitted on its own, median", "≥ 0.9"),
    "log_score": ("mean logarithm of the probability given to what is true", ""),
    "failed": ("ended with an error", "0"),
    "median_seconds": ("one diagnosis, s, median", ""),
}
BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, float("inf")))  # of visibility, times the floor


def page(content: dict[str, Any], later: bool = False) -> str:
    """The part of the page, in Markdown."""
    records: list[Record] = content["cases"]
    kinds = Counter(r["kind"] for r in records)
    counts = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in sorted(kinds.items()))
    study = "" if content["study"] == "drawn" else f" --study {content['study']}"
    study += " --visible" if content.get("visible") else ""
    asked = max([records[-1]["seed"], *content.get("passed_over", [])]) - content["seed"] + 1
    lines = [
        f"{len(records)} cases of {content['date']}, seeds {_seeds(content)}: {counts}. In",
        "brackets: how many cases speak to a figure. Intervals are of 95 %.",
        "",
        f"    python benchmarks/diagnosis.py --cases {asked} --seed {content['seed']}{study} "
        f"--workers {content['workers']} --threads {content['threads']} --json out.json",
        "",
        "| key | means | measured | interval | bar |",
        "|---|---|---|---|---|",
    ]
    measured = figures(records)
    told = [key for key in KEYS if measured[key].n or not later]
    lines += [f"| `{key}` | {KEYS[key][0]} | {_cells(measured[key])} | {KEYS[key][1]} |" for key in told]
    if not later:
        lines += ["", *_by_effect(records), "", *_reliability(records)]
    lines += ["", *_misses(records)]
    return "\n".join(lines) + "\n"


def _seeds(content: dict[str, Any]) -> str:
    """From the first to the last, those between that were not run, and how many do not show and were only drawn."""
    drawn = content.get("passed_over", [])
    run = sorted([*drawn, *(r["seed"] for r in content["cases"])])
    missing = sorted(set(range(run[0], run[-1])) - set(run))
    left_out = f" without {', '.join(map(str, missing))}" if missing else ""
    return f"{run[0]} to {run[-1]}{left_out}" + (f", {len(drawn)} more that do not show" if drawn else "")


def _cells(figure: Figure) -> str:
    if figure.value is None or figure.interval is None:
        return f"– ({figure.n}) | –"
    return f"{figure.value:.3f} ({figure.n}) | {figure.interval[0]:.3f} to {figure.interval[1]:.3f}"


def _by_effect(records: Sequence[Record]) -> Iterator[str]:
    """How often single effects were named right, by visibility."""
    cells: dict[tuple[str, int], list[bool]] = defaultdict(list)
    for r in (r for r in records if r["kind"] == "single"):
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
    missed = [r for r in records if not is_right(r)]
    left_open = sum(is_undecided(r) for r in missed)
    yield f"Cases not named right, {len(missed)} of {len(records)}; {left_open} of them undecided with the truth:"
    yield ""
    yield "| seed | rig | hidden | shows | verdict | stated set |"
    yield "|---|---|---|---|---|---|"
    for r in missed:
        stated = ", ".join(r["stated"][:3]) + (f" and {len(r['stated']) - 3} more" if len(r["stated"]) > 3 else "")
        hidden = " + ".join(f"{h['effect']}.{h['place']} ({h['form']})" for h in r.get("hidden", ())) or r["truth"]
        rig = f"{r['rig']}, {r['law']}" if "rig" in r else "testbed"
        kind = f"{r['kind'].replace('_', ' ')}: " if r["kind"] in ("outside", "left_out") else ""
        yield f"| {r['seed']} | {rig} | {kind}{hidden} | {r['visibility']:.1f} | {r['verdict']} | {stated} |"


def main() -> None:
    """Rewrites the page's part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("json", type=Path)
    parser.add_argument("--later", metavar="NAME", help="shorter, between marks with this name")
    given = parser.parse_args()
    content = json.loads(given.json.read_text(encoding="utf-8"))
    begin, end = (mark.format(given.later) for mark in LATER) if given.later else (BEGIN, END)
    before, rest = PAGE.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    PAGE.write_text(f"{before}{begin}\n{page(content, bool(given.later))}{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

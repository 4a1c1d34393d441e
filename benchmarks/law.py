# SPDX-License-Identifier: Apache-2.0
"""What is found of an effect that the library does not have: its variable, its period, how much of the gap it closes.

    python benchmarks/law.py --cases 200 --seed 100000 --workers 16 --json out.json

Of three cases in a row one is a healthy rig, one has something outside the library, and one has an effect of the
library that is left out. Cases are those of benchmarks/drawn_rigs. One more command of another style is recorded, never
fitted, and used to judge what is proposed: by how much the error falls there, compared with the true form fitted to the
same plays, of the library or of drawn_rigs/true_forms.py, or with the noise if it has none. The diagnosis before has no
effects to choose from, so that it says "complete" or "unknown". Seeds below 100000 are for tuning. With --visible what
does not show at over 3 times the floor is drawn and not judged; the rates count only what shows anyway.

An interrupted run keeps its results: the JSON file is rewritten after each case, and --continue resumes the run.
"""

import argparse
import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from counting import VISIBLE, wilson
from diagnosis import earlier, write
from drawn_rigs.cases import Case, draw
from drawn_rigs.reading import (
    Dependence,
    Model,
    Play,
    Proposal,
    floors_on,
    law_of,
    loaded,
    with_effect_fitted,
    with_own_effect_fitted,
)
from drawn_rigs.true_forms import true_form

TUNING = 100_000
KINDS = ("healthy", "outside", "left_out")
PERIOD = 0.03  # relative error that is still right
HALF = 0.5  # of what the true form takes away on another command
WORTH = 2.0  # floors left there at least; with less there is nothing to take away
SHOWS = 1.6  # floors that a refitted model leaves, beyond which anything is proposed at all
RIGHT = {
    "cogging": {"curve_angle"},
    "eccentric_gear": {"curve_sensor", "curve_angle"},
    "quadratic_drag": {"curve_speed"},
    "tight_places": {"curve_angle_friction"},
    "other_axis_friction": {"curve_other_friction"},
    "resonance": {"swing"},
    "thermal_drift": {"curve_time_friction", "curve_time"},
    "coulomb_friction": {"curve_speed"},
    "viscous_friction": {"curve_speed"},
    "stribeck_friction": {"curve_speed"},
    "direction_friction": {"curve_speed"},
    "direction_viscous_friction": {"curve_speed"},
    "lugre_friction": {"curve_speed", "curve_reversal"},
    "load_friction": {"curve_load_friction"},
    "directional_load_friction": {"curve_load_friction"},
    "gravity_load": {"curve_angle"},
    "return_spring": {"curve_angle"},
    "positioning_error": {"curve_angle", "command"},  # of the feedback, or of the target
    "gain_error": {"command"},
    "command_quantisation": {"command"},
    "command_delay": {"late"},
    "rate_limit": {"late"},
    "motion_profile": {"late"},
    "cross_coupling": {"curve_other", "curve_sensor_other", "other_command"},
    "sensor_gain": {"curve_sensor"},
    "sensor_bias": {"curve_sensor"},
    "sensor_delay": {"curve_sensor_speed"},
    "sensor_lag": {"curve_sensor_speed"},
}
"""Effect -> free curves whose variable is the one that it depends on, "command" for its error over itself, "late" for
one that takes effect late; what is not listed depends on none of them."""

Record = dict[str, Any]


def judge(seed: int, threads: int, effect: str | None, visible: bool = False) -> Record:
    """One case from its bags to what is proposed; only "passed_over" if what is hidden should show and does not."""
    started = time.process_time()
    kind = KINDS[seed % len(KINDS)]
    with tempfile.TemporaryDirectory() as folder:
        case = draw(seed, Path(folder), kind=kind, effect=None if kind == "healthy" else effect, fresh=True)
        if visible and case.hidden and case.visibility <= VISIBLE:
            return {"seed": seed, "passed_over": True}
        record: Record = {**case.to_json(), "visibility": case.visibility}
        try:
            record |= _said(case, threads)
        except Exception as error:  # a case that crashes is a result, and the others still run
            record |= {"error": f"{type(error).__name__}: {error}", "proposal": None}
    return record | {"seconds": time.process_time() - started}


def _said(case: Case, threads: int) -> Record:
    model, plays = loaded(case.model, case.bags)
    verdict, base, proposal = law_of(model, plays, threads, case.seed)
    other = loaded(case.model, case.fresh)[1] if case.fresh else []
    record: Record = {"verdict": verdict, "proposal": _told(proposal) if proposal else None}
    if other and proposal and proposal.model is not None:
        on_other = [floors_on(m, other, proposal.axis, threads) for m in (base, proposal.model)]
        record["proposal"]["other_command"] = on_other
    axis = _axis(model, case)
    if other and axis:
        record["base_on_other"] = floors_on(base, other, axis, threads)
        record["base_on_own"] = floors_on(base, plays, axis, threads)
        true = _true_form(base, plays, axis, case, threads) if record["base_on_own"] > SHOWS else None
        if true is not None:
            record["true_on_other"] = floors_on(true, other, axis, threads)
    return record


def _told(proposal: Proposal) -> Record:
    depends = proposal.depends
    first = depends.first
    return {
        "axis": proposal.axis, "place": proposal.place, "kind": proposal.kind, "equation": proposal.equation,
        "curve": _named(first) if first else "", "variable": first.variable if first else "",
        "period": first.period if first else None, "ties": [_named(d) for d in depends.ties],
        "share": first.share if first else 0.0, "chance": depends.chance, "floors": list(proposal.missing.floors),
    }  # fmt: skip


def _named(dependence: Dependence) -> str:
    """The free curve over what is named; a command is no angle, and a pair is not one of the two."""
    return "pair" if dependence.pair else "command" if dependence.variable == "command" else dependence.over


def _axis(model: Model, case: Case) -> str:
    """The axis on which something is hidden; "" on a healthy rig."""
    place = case.hidden[0].place if case.hidden else ""
    return next((a.name for a in model.rig.axes if place == a.name or place in [m.signal for m in a.measured]), "")


def _true_form(base: Model, plays: Sequence[Play], axis: str, case: Case, threads: int) -> Model | None:
    """The model with what is hidden, fitted to what was recorded; None where it has no form."""
    hidden = case.hidden[0]
    if case.kind == "left_out":
        return with_effect_fitted(base, plays, axis, hidden.name, threads)
    own = true_form(hidden.effect, hidden.period)
    on = base.rig.axis(axis)
    if own is None or (own.where == "signal" and on.belt):  # there it is the belt that goes unevenly
        return None
    place = on.positions[-1] if own.where == "signal" else axis
    return with_own_effect_fitted(base, plays, axis, own, place, threads)


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """Key -> rate or median, with _n and _interval.

    A case is visible by what the true rig's own values cannot make up for; `_shown` counts only those of which the
    refitted model leaves more than noise, because nothing can be found of the others.
    """
    visible = [r for r in records if r["kind"] != "healthy" and r["visibility"] > VISIBLE]
    shown = [r for r in visible if r.get("base_on_own", 0.0) > SHOWS]
    healthy = [r for r in records if r["kind"] == "healthy"]
    waves = [(_of(r).get("period"), r["hidden"][0]["period"]) for r in shown if r["hidden"][0]["period"]]
    errors = [abs(p / true - 1.0) for p, true in waves if p]
    rates: dict[str, Any] = {}
    for key, hits in {
        "variable_right": [_is_right(r) for r in visible if r["hidden"][0]["effect"] in RIGHT],
        "variable_right_shown": [_is_right(r) for r in shown if r["hidden"][0]["effect"] in RIGHT],
        "variable_among_shown": [_is_among(r) for r in shown if r["hidden"][0]["effect"] in RIGHT],
        "half_of_true_form": [h for r in visible if (h := _is_half(r)) is not None],
        "half_of_true_form_shown": [h for r in shown if (h := _is_half(r)) is not None],
        "healthy_silent": [not (r["proposal"] and r["proposal"]["kind"]) for r in healthy],
        "period_right": [e <= PERIOD for e in errors],
        "failed": ["error" in r for r in records],
    }.items():
        rates[key] = float(np.mean(hits)) if hits else None
        rates[f"{key}_n"] = len(hits)
        rates[f"{key}_interval"] = list(wilson(sum(hits), len(hits))) if hits else None
    rates["period_error"] = float(np.median(errors)) if errors else None
    rates["period_error_n"] = len(errors)
    rates["period_error_interval"] = [float(np.quantile(errors, q)) for q in (0.05, 0.95)] if errors else None
    return rates


def _is_right(record: Record) -> bool:
    return _of(record).get("curve") in _right(record)


def _is_among(record: Record) -> bool:
    """Whether the right variable is among those reported as indistinguishable."""
    proposal = _of(record)
    return bool({proposal.get("curve"), *proposal.get("ties", ())} & _right(record))


def _right(record: Record) -> set[str]:
    """What the hidden effect depends on; by any of its names, where its form is literally that of several."""
    hidden = record["hidden"][0]
    return set().union(*(RIGHT.get(name, set()) for name in (hidden["effect"], *hidden["also"])))


def _is_half(record: Record) -> bool | None:
    """Whether the error on another command falls by half of what the true form takes away; None if that is nothing."""
    before = record.get("base_on_other")
    if before is None or before < WORTH:
        return None
    true = record.get("true_on_other", 1.0)
    if before - true < HALF * before:
        return None  # the true form, fitted to what was played, does not hold there either
    after = _of(record).get("other_command", (before, before))[1]
    return bool(before - after >= HALF * (before - true))


def _of(record: Record) -> Record:
    """The proposal, if it is for the axis on which something is hidden; else empty."""
    place, proposal = record["hidden"][0]["place"], record["proposal"]
    mine = proposal and (proposal["axis"] in (place, place.rpartition("_")[2]) or place.startswith(proposal["axis"]))
    return proposal if mine else {}


def judged(seeds: Sequence[int], given: argparse.Namespace) -> Iterator[Record]:
    """Cases as they are done."""
    judge_one = partial(judge, threads=given.threads, effect=given.effect, visible=given.visible)
    if given.workers == 1:
        yield from map(judge_one, seeds)
        return
    with ProcessPoolExecutor(given.workers, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(judge_one, seed) for seed in seeds]):
            yield done.result()


def _line(record: Record) -> str:
    """One case on one line."""
    found = record["proposal"]
    text = record.get("error") or record["verdict"]
    if found:
        law = f"{found['curve'] or '-'} {found['kind']} {found['equation']}"
        text += f"; {found['axis']}: {law} {found['floors'][0]:.3g} floors"
    hidden = ", ".join(f"{h['effect']}.{h['place']}" for h in record["hidden"]) or "nothing"
    return f"{record['seed']} {hidden} ({record['visibility']:.1f} x floor) -> {text} [{record['seconds']:.0f} s]"


def main() -> None:
    """Runs the cases and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=TUNING, help="of the first case; the others follow")
    parser.add_argument("--effect", help="this effect only, outside the library or of it; healthy rigs stay healthy")
    parser.add_argument("--visible", action="store_true", help="judge only what shows, and healthy rigs")
    parser.add_argument("--threads", type=int, default=1, help="of each case; 0 for one per CPU")
    parser.add_argument("--workers", type=int, default=1, help="cases side by side")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--continue", dest="goes_on", action="store_true", help="keep the cases that --json holds")
    given = parser.parse_args()
    if given.goes_on and not given.json:
        parser.error("--continue needs --json with the file of an earlier run.")
    if given.seed < TUNING:
        print(f"Note: seeds below {TUNING} are for tuning; these figures flatter the result.")
    settings = {"seed": given.seed, "effect": given.effect, "visible": given.visible}
    records, passed_over = earlier(given.json, settings) if given.goes_on else ([], [])
    done = {*passed_over, *(r["seed"] for r in records)}
    seeds = [seed for seed in range(given.seed, given.seed + given.cases) if seed not in done]
    for number, record in enumerate(judged(seeds, given), start=1):
        if record.get("passed_over"):
            passed_over = sorted([*passed_over, record["seed"]])
            print(f"[{number}/{len(seeds)}] {record['seed']} does not show", flush=True)
        else:
            records = sorted([*records, record], key=lambda r: r["seed"])
            print(f"[{number}/{len(seeds)}] {_line(record)}", flush=True)
        if given.json:
            measured = figures(records)
            write(given.json, {
                **measured, **settings, "figures": measured, "passed_over": passed_over, "cases": records,
            })  # fmt: skip
    for key, value in figures(records).items():
        print(f"{key:30s}{value}")


if __name__ == "__main__":
    main()

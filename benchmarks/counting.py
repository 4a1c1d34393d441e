# SPDX-License-Identifier: Apache-2.0
"""What a study's records say: strict rates with their intervals. A case is right or it is not; nothing counts half.

A record is one case: `kind`, `truth`, `as_true` (hypotheses that are as true), `visibility`, and the result:
`verdict`, `effects`, `stated`, `set`, and `leaves`, what the model leaves with its values refitted, root mean square
over the floor.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log, sqrt
from typing import Any

import numpy as np

from eps_tunnel_analysis.diagnose.rank import NAMELESS

Record = dict[str, Any]

VISIBLE = 3.0  # times the floor
INVISIBLE = 1.0  # times the floor; below, "nothing is missing within the noise" is true
SURE = 0.95
LEVELS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)  # of stated probability, for the reliability
LEAST = 1e-4  # a probability below counts as this in the log score
ALIKE = 1.02  # times the held-out error of the true form, within which another one is as good
WORTH = 0.1  # of the held-out error that the true form must take away for its fall to be compared
Z = 1.959964  # of a two-sided 95 %
RESAMPLES = 1000


@dataclass(frozen=True)
class Figure:
    """A measured figure: its value, how many cases speak to it, and its 95 % interval; None if there is none."""

    value: float | None
    n: int
    interval: tuple[float, float] | None


def figures(records: Sequence[Record]) -> dict[str, Figure]:
    """Every key of a study."""
    visible = [r for r in records if r["kind"] == "single" and r["visibility"] > VISIBLE]
    healthy = [r for r in records if r["kind"] == "healthy"]
    shows = [r for r in visible if r["leaves"] > VISIBLE]  # no recording shows what the drive's values compensate for
    foreign = [r for r in records if r["kind"] in ("outside", "left_out") and r["visibility"] > VISIBLE]
    left_out = [r for r in foreign if r["kind"] == "left_out"]
    every_pair = [r for r in records if r["kind"] == "pair"]
    pairs = [r for r in every_pair if r["visibility"] > VISIBLE]  # of the one that shows less
    sure = [r for r in records if likeliest(r)[1] > SURE]
    alarms = rate(healthy, is_false_alarm)
    return {
        "visible_right": rate(visible, is_right),
        "visible_undecided": rate(visible, is_undecided),
        "visible_wrong": rate(visible, is_wrong),
        "visible_misnamed": rate(visible, lambda r: r["verdict"] == "effect" and not is_right(r)),
        "refitted_visible_right": rate(shows, is_right),
        "refitted_visible_undecided": rate(shows, is_undecided),
        "refitted_visible_wrong": rate(shows, is_wrong),
        "false_alarm": alarms,
        "false_alarm_upper95": Figure(alarms.interval[1] if alarms.interval else None, alarms.n, alarms.interval),
        "false_alarm_named": rate(healthy, lambda r: r["verdict"] == "effect"),
        "unknown_found": rate(foreign, is_right),
        "unknown_found_outside": rate([r for r in foreign if r["kind"] == "outside"], is_right),
        "unknown_found_left_out": rate(left_out, is_right),
        "unknown_as_good_as_true_form": rate(
            [r for r in left_out if _compares_with_true_form(r)], as_good_as_true_form
        ),
        "pair_both": rate(pairs, is_right),
        "pair_undecided": rate(pairs, is_undecided),
        "pair_both_of_all": rate(every_pair, is_right),
        "calibration_error": calibration(records),
        "calibration_error_by_chance": calibration_by_chance(records),
        "stated_above_95_wrong": rate(sure, lambda r: not is_true(r, likeliest(r)[0])),
        "log_score": mean([log_score(r) for r in records if r["set"]]),
        "drop_vs_true_form": median([drop for r in records if (drop := drop_vs_true_form(r)) is not None]),
        "failed": rate(list(records), lambda r: r["verdict"] == "failed"),
        "median_seconds": median([r["seconds"] for r in records]),
    }


def flat(measured: dict[str, Figure]) -> dict[str, Any]:
    """KEY, KEY_n and KEY_interval for JSON."""
    out: dict[str, Any] = {}
    for key, figure in measured.items():
        interval = None if figure.interval is None else list(figure.interval)
        out |= {key: figure.value, f"{key}_n": figure.n, f"{key}_interval": interval}
    return out


def is_right(r: Record) -> bool:
    """Whether the verdict is the truth, all of it and nothing more."""
    said = {"complete": "none", "unknown": "unknown", "effect": " + ".join(sorted(r["effects"]))}
    return said.get(r["verdict"]) in _truths(r)


def is_undecided(r: Record) -> bool:
    """Whether the verdict leaves it open, with the truth in the stated set."""
    return r["verdict"] == "undecided" and bool(_truths(r) & {spelled(name) for name in r["stated"]})


def is_wrong(r: Record) -> bool:
    """Whether the truth is neither named nor left open."""
    return not is_right(r) and not is_undecided(r)


def is_false_alarm(r: Record) -> bool:
    """Whether a healthy rig is said to lack something: anything but "complete", or a set that holds "none"."""
    return r["verdict"] != "complete" and not (r["verdict"] == "undecided" and "none" in r["stated"])


def likeliest(r: Record) -> tuple[str, float]:
    """The hypothesis that the diagnosis holds most probable."""
    return max(r["set"].items(), key=lambda item: item[1]) if r["set"] else ("", 0.0)


def is_true(r: Record, hypothesis: str) -> bool:
    """Whether a hypothesis holds: the truth, or what is visible of it, "none" if nothing is."""
    if spelled(hypothesis) in _truths(r):
        return True
    if hypothesis in ("overlooked", "imitated"):
        foreign = _truths(r) & ({"none", "unknown"} if hypothesis == "overlooked" else {"none"})
        return not foreign and not any(is_true(r, name) for name in r["set"] if name not in NAMELESS)
    if r["kind"] == "pair":
        return spelled(hypothesis) in _visible_parts(r)
    return bool(r["kind"] != "healthy" and r["visibility"] < INVISIBLE and hypothesis == "none")


def _visible_parts(r: Record) -> set[str]:
    """Names, in every way that is right, of the effects of a pair that show, if one of them does not."""
    seen = [h for h in r.get("hidden", ()) if h["visibility"] >= INVISIBLE]
    if len(seen) == len(r.get("hidden", ())):
        return set()
    # Records of earlier runs have no names of their own.
    names = [h.get("names") or [f"{effect}.{h['place']}" for effect in (h["effect"], *h["also"])] for h in seen]
    return {spelled(" + ".join(chosen)) or "none" for chosen in itertools.product(*names)}


def _truths(r: Record) -> set[str]:
    return {r["truth"], *r.get("as_true", ())}


def spelled(hypothesis: str) -> str:
    """The name of a set with its effects in alphabetical order, as a truth is written."""
    return " + ".join(sorted(hypothesis.split(" + ")))


def log_score(r: Record) -> float:
    """Logarithm of the probability that was given to what is true."""
    return log(max(sum(p for name, p in r["set"].items() if is_true(r, name)), LEAST))


def _compares_with_true_form(r: Record) -> bool:
    """Whether there is a held-out error both of the verdict and of the true form."""
    return r.get("true_form") is not None and r.get("held_out") is not None


def as_good_as_true_form(r: Record) -> bool:
    """Whether what was named predicts what was left out as well as the true form, so that nothing tells them apart."""
    return bool(r["effects"]) and r["held_out"][1] <= ALIKE * r["true_form"]


def drop_vs_true_form(r: Record) -> float | None:
    """Fall of the held-out error over that of the true form, fitted on its own; None if nothing can fall."""
    judged = r["kind"] in ("single", "pair") and r["visibility"] > VISIBLE
    if not (judged and _compares_with_true_form(r)):
        return None
    before, after = r["held_out"]
    possible = before - r["true_form"]
    return (before - after) / possible if possible > WORTH * before else None


def rate(records: Sequence[Record], holds: Callable[[Record], bool]) -> Figure:
    """Share of the records for which something holds, with Wilson's interval."""
    count = sum(bool(holds(r)) for r in records)
    return Figure(count / len(records), len(records), wilson(count, len(records))) if records else Figure(None, 0, None)


def wilson(count: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share (Wilson 1927)."""
    share = count / n
    middle = (share + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z / (1 + Z**2 / n) * sqrt(share * (1 - share) / n + Z**2 / (4 * n**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def mean(values: Sequence[float]) -> Figure:
    """Mean, with the interval of a normal; none of a single value."""
    if not values:
        return Figure(None, 0, None)
    middle = float(np.mean(values))
    if len(values) == 1:
        return Figure(middle, 1, None)
    half = Z * float(np.std(values, ddof=1)) / sqrt(len(values))
    return Figure(middle, len(values), (middle - half, middle + half))


def median(values: Sequence[float]) -> Figure:
    """Median, with the interval between the order statistics that a binomial puts about it."""
    if not values:
        return Figure(None, 0, None)
    ranked, n = sorted(values), len(values)
    low = max(0, int(np.floor(0.5 * n - 0.5 * Z * sqrt(n))))
    return Figure(float(np.median(ranked)), n, (ranked[low], ranked[n - 1 - low]))


def calibration(records: Sequence[Record]) -> Figure:
    """Expected calibration error of the likeliest hypothesis, with a bootstrap's interval."""
    pairs = _stated(records)
    if not len(pairs):
        return Figure(None, 0, None)
    rng = np.random.default_rng(0)
    drawn = [_calibration_error(pairs[rng.integers(len(pairs), size=len(pairs))]) for _ in range(RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Figure(_calibration_error(pairs), len(pairs), (float(low), float(high)))


def calibration_by_chance(records: Sequence[Record]) -> Figure:
    """What `calibration` would be for as many cases if every probability were exactly right: its mean, and where 95 %
    of the draws lie. It is 0 only for endlessly many cases.
    """
    pairs = _stated(records)
    if not len(pairs):
        return Figure(None, 0, None)
    rng = np.random.default_rng(0)
    chances = pairs[:, 0]
    drawn = [
        _calibration_error(np.column_stack([chances, rng.random(len(chances)) < chances])) for _ in range(RESAMPLES)
    ]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Figure(float(np.mean(drawn)), len(pairs), (float(low), float(high)))


def _stated(records: Sequence[Record]) -> np.ndarray:
    """(n, 2) probability of the likeliest hypothesis of each case, and whether it is true."""
    said = [(p, is_true(r, name)) for r in records if r["set"] for name, p in [likeliest(r)]]
    return np.array(said, dtype=float).reshape(-1, 2)


def _calibration_error(pairs: np.ndarray) -> float:
    error = 0.0
    for _, _, inside in _by_level(pairs):
        if len(inside):
            error += len(inside) * abs(float(inside[:, 1].mean() - inside[:, 0].mean()))
    return error / len(pairs)


def _by_level(pairs: np.ndarray) -> Iterator[tuple[float, float, np.ndarray]]:
    """Both ends of each level of probability, and those of `_stated` pairs that lie in it."""
    for low, high in itertools.pairwise(LEVELS):
        yield low, high, pairs[(pairs[:, 0] >= low) & (pairs[:, 0] < high)]


def reliability(records: Sequence[Record]) -> list[dict[str, Any]]:
    """How often the likeliest hypothesis was true, by the probability it was given."""
    rows = []
    for low, high, inside in _by_level(_stated(records)):
        if len(inside):
            count = int(inside[:, 1].sum())
            rows.append({
                "from": low, "to": min(high, 1.0), "n": len(inside), "stated": float(inside[:, 0].mean()),
                "true": count / len(inside), "interval": list(wilson(count, len(inside))),
            })  # fmt: skip
    return rows


def confusion(records: Sequence[Record]) -> Iterator[tuple[str, str, int]]:
    """What was hidden, what was said, how often; without places."""

    def said(r: Record) -> str:
        return " + ".join(r["effects"]) if r["verdict"] == "effect" else str(r["verdict"])

    def bare(name: str) -> str:
        return " + ".join(sorted(part.partition(".")[0] for part in name.split(" + ")))

    pairs = Counter((bare(r["truth"]), bare(said(r))) for r in records)
    yield from ((truth, word, n) for (truth, word), n in sorted(pairs.items()))

# SPDX-License-Identifier: Apache-2.0
"""What each form of a hidden effect leaves to the effect of the library that it is a form of, refitted by itself.

    python benchmarks/forms.py --effect load_friction --form carried --cases 2

The share that is left of the misfit, on drawn rigs on which it shows: a form that the library lacks leaves more than a
diagnosis allows, and is called unknown. Seeds below 100000 are for tuning.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

from counting import VISIBLE
from drawn_rigs.cases import Case, draw
from drawn_rigs.effects import FORMS
from drawn_rigs.reading import diagnose, loaded

SEED = 4000
MOST = 30  # seeds drawn for a form at most: few rigs have a place for some


def left(case: Case, threads: int) -> Iterator[tuple[float, float]]:
    """Floors that the base leaves on the axis of what is hidden, and that the effect leaves by itself, refitted."""
    model, plays = loaded(case.model, case.bags)
    (hidden,) = case.hidden
    found = diagnose(model, plays, seed=case.seed, only=(hidden.effect,), nthread=threads, experiments=False)
    for axis in found.axes:
        fitted = [h.refit.cost for h in axis.hypotheses if h.refit.effects == (hidden.name,)]
        if fitted:
            yield axis.base.cost, min(fitted)


def main() -> None:
    """Prints the share that is left of each form."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", help="of this effect only")
    parser.add_argument("--form", help="in this form only")
    parser.add_argument("--cases", type=int, default=2, help="of each form")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first rig that is drawn; the others follow")
    parser.add_argument("--threads", type=int, default=1, help="0 for one per CPU")
    given = parser.parse_args()
    for form in (f for f in FORMS if not f.outside and given.effect in (None, f.effect)):
        if given.form not in (None, form.name):
            continue
        shares: list[float] = []
        for seed in range(given.seed, given.seed + MOST):
            if len(shares) == given.cases:
                break
            with tempfile.TemporaryDirectory() as folder:
                case = draw(seed, Path(folder), kind="single", effect=form.effect, form=form.name)
                if case.hidden and case.hidden[0].form == form.name and case.visibility > VISIBLE:
                    shares += [(after - 1.0) / max(before - 1.0, 1.0) for before, after in left(case, given.threads)]
        told = ", ".join(f"{max(share, 0.0):.3f}" for share in shares)
        print(f"{form.effect} ({form.name}): {told or 'does not show'}", flush=True)


if __name__ == "__main__":
    main()

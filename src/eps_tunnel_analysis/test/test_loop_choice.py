# SPDX-License-Identifier: Apache-2.0
"""What the loop adds after each kind of verdict, and how the gap of a play is measured."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_recordings import record, write_rig

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, itself, with_imitated
from eps_tunnel_analysis.diagnose.verdict import AxisVerdict, Errors, Verdict, decide
from eps_tunnel_analysis.error import mean_error
from eps_tunnel_analysis.loop.experimenter import chosen_effects
from eps_tunnel_analysis.loop.gap import Bags, Gap, measure_gap
from eps_tunnel_analysis.study import StudyGap
from labyrinth_sim.model import load_model
from labyrinth_sim.registry import Registry
from labyrinth_sim.trials import Trials

REGISTRY = Registry.load()


def verdict(probabilities: Mapping[str, float]) -> Verdict:
    found = {NONE: 0.0, UNKNOWN: 0.0, **probabilities}
    kind, effects, stated = decide(found, 0.9)
    names = {effect for name in probabilities for effect in name.split(" + ") if name not in (NONE, UNKNOWN)}
    marginals = {n: itself(sum(p for name, p in probabilities.items() if n in name.split(" + "))) for n in names}
    axis = AxisVerdict(marginals, found[NONE], found[UNKNOWN], {}, {}, (9.0, 1.0), (), ())
    nothing = Errors(0.0, 0.0, 0.0)
    return Verdict(
        kind, effects, with_imitated(found), stated, 0.9, "", (), nothing, nothing, nothing, {"x": axis}, {}, 0, 0, 0.0
    )  # fmt: skip


@pytest.mark.parametrize(
    ("probabilities", "added", "why"),
    [
        ({"backlash.x": 0.97}, ("backlash.x",), ""),
        ({NONE: 0.97}, (), ""),
        ({UNKNOWN: 0.6, "backlash.x": 0.4}, (), ""),
        # What all of them contain, as gravity load and load friction on a pendulum.
        (
            {"backlash.x + gravity_load.x": 0.5, "backlash.x + coulomb_friction.x": 0.45},
            ("backlash.x",),
            "These recordings leave 2 sets of effects; all of them contain backlash (belt slack) on x.",
        ),
        ({"backlash.x + gravity_load.x": 0.45, "gravity_load.x": 0.35, UNKNOWN: 0.2}, ("gravity_load.x",), "These"),
        (
            {"backlash.x": 0.6, UNKNOWN: 0.4},
            ("backlash.x",),
            "More likely than not, backlash (belt slack) on x is missing;",
        ),
        # Less likely than not: something unknown may be all there is.
        ({"backlash.x": 0.46, UNKNOWN: 0.45, "gravity_load.x": 0.09}, (), ""),
        # Twins: fewer effects first, then fewer values, then the more probable.
        ({"stribeck_friction.x": 0.5, "coulomb_friction.x": 0.48}, ("coulomb_friction.x",), "No recording at hand"),
        ({"backlash.x + return_spring.x": 0.5, "gravity_load.x": 0.48}, ("gravity_load.x",), "No recording at hand"),
        ({"gravity_load.x": 0.45, "coulomb_friction.x": 0.5}, ("coulomb_friction.x",), "No recording at hand"),
        # The simplest is to add nothing.
        ({"gravity_load.x": 0.5, NONE: 0.45}, (), ""),
    ],
)
def test_what_is_added(probabilities: dict[str, float], added: tuple[str, ...], why: str) -> None:
    names, reason = chosen_effects(verdict(probabilities), REGISTRY)
    assert names == added
    assert reason.startswith(why) if why else reason == ""


def test_the_gap_of_a_play_is_compared_at_the_rate_of_its_rig(tmp_path: Path) -> None:
    model = load_model(write_rig(tmp_path))
    bags = Bags((record(model, tmp_path / "real"),), (record(model, tmp_path / "sim", seed=1),))
    for step in (0.005, 0.01):
        gap = measure_gap(bags, replace(model.rig, sample_time=step))
        assert gap.comparison.real.time[1] == pytest.approx(step)


def test_the_error_of_a_rig_that_turns_and_slides_is_that_of_what_turns() -> None:
    time = np.arange(100) * 0.01
    wave = np.column_stack([np.sin(time), np.cos(time)])[None]
    both = {"time": time, "signals": ("hip", "rail"), "units": ("rad", "m"), "command_channels": ()}
    real, sim = (
        Trials(**both, values=v, commands=np.empty((len(v), 100, 0))) for v in (wave, wave + np.array([0.1, 0.3]))
    )
    shown = compare(real, sim)
    assert mean_error([0.1, 0.3], ["rad", "m"]) == 0.1
    assert mean_error([0.1, 0.3], ["rad", "m"], "m") == 0.3
    assert np.isnan(mean_error([np.nan, 0.3], ["rad", "m"]))
    for gap in (Gap(shown, (), 0.0), StudyGap(shown)):
        assert gap.error == pytest.approx(0.1)

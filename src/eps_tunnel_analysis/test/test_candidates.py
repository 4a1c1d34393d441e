# SPDX-License-Identifier: Apache-2.0
"""Candidates: which there are, and from which values they are sought."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from fit_cases import plays
from small_recordings import write_rig

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.candidates import Candidate, library, starts
from eps_tunnel_analysis.diagnose.ticks import MOST_TICKS, PART_OF_A_TICK, every_tick
from eps_tunnel_analysis.diagnose.waves import MOST_PERIODS, PART_OF_A_WAVE, every_period
from eps_tunnel_analysis.stamped import Series
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model


def test_every_candidate_has_starts_within_its_bounds() -> None:
    found = library(load_model("labyrinth_manual"), ["drive.x.p"])
    assert {"backlash.x", "sensor_gain.board_y"} <= {c.name for c in found.candidates}
    for candidate in found.candidates:
        rows = starts(candidate)
        assert len(rows)
        for column, p in enumerate(candidate.effect.parameters):
            assert (rows[:, column] >= p.low).all() and (rows[:, column] <= p.high).all()


def test_waves_start_at_every_phase_of_every_period() -> None:
    """And where targets are uneven; a descent finds out whether a sensor is."""
    found = library(load_model("labyrinth_manual"), [], only=["positioning_error"]).find("positioning_error.x")
    rows = starts(found)
    sizes, periods, phases, seen = (len(np.unique(column)) for column in rows.T)
    assert len(rows) == sizes * periods * phases and min(periods, phases) >= 4 and seen == 1


def test_each_of_several_limits_is_tried_by_itself() -> None:
    found = library(load_model("labyrinth_manual"), [], only=["motion_profile"]).find("motion_profile.x")
    acceleration, speed = ((starts(found)[:, k] < p.high) for k, p in enumerate(found.declared))
    assert (acceleration & ~speed).any() and (speed & ~acceleration).any() and (acceleration & speed).any()


def test_a_limit_that_may_lie_in_any_of_many_decades_is_tried_in_each() -> None:
    found = library(load_model("labyrinth_manual"), [], only=["rate_limit"]).find("rate_limit.x")
    (rate,), tried = found.declared, np.sort(starts(found)[:, 0])
    assert np.ptp(np.diff(np.log10([rate.low, *tried, rate.high]))) < 1e-9 and tried[1] < 2.3 * tried[0]


def test_a_value_starts_where_its_effect_declares() -> None:
    found = library(load_model("labyrinth_manual"), [], only=["duty_cut_back", "torque_saturation"])
    cut, limit = (starts(found.find(f"{name}.x")) for name in ("duty_cut_back", "torque_saturation"))
    assert len(np.unique(cut[:, 2])) > 3 and ((cut[:, 2] > 0.0) & (cut[:, 2] < 0.1)).any(), "most are fast"
    firmwares = np.array([0.02, 0.4, 0.8])  # of small motions, and the bounds that makers set
    assert (np.abs(np.log(firmwares[:, None] / np.unique(cut[:, 1]))).min(axis=1) < np.log(2.0)).all()
    assert len(limit) > 3 and not limit[:, 1].any(), "a descent finds how soft a limit is"


def test_ticks_start_at_whole_multiples_of_a_known_one() -> None:
    model = load_model("labyrinth_mx64")
    register = model.values()["drive.x.goal_tick"]
    found = library(model, [], only=["command_quantisation"]).find("command_quantisation.x")
    tried, low, high = starts(found)[:, 0], found.declared[0].low, found.declared[0].high
    assert register > 0.0 and low <= tried.min() and tried.max() <= high
    for many in (2, 3, 8):
        assert np.min(np.abs(tried / (many * register) - 1.0)) < 1e-12, "its valley is a thousandth wide"
    untold = library(load_model("labyrinth_manual"), [], only=["command_quantisation"]).find("command_quantisation.x")
    assert len(starts(untold)) < len(tried)


def test_all_ticks_lie_a_part_of_one_apart_over_the_reach_of_a_command() -> None:
    tried = every_tick(0.4, 0.002, 0.05)
    assert np.diff(0.4 / tried) == pytest.approx(PART_OF_A_TICK)
    assert 0.002 <= tried.min() < 0.4 / (200.0 - PART_OF_A_TICK)
    assert tried.max() == pytest.approx(0.05)
    assert len(every_tick(0.4, 1e-9, 0.05)) == MOST_TICKS
    assert not len(every_tick(0.4, 0.5, 0.05)), "coarser than the reach: no tick rounds so little"


def test_periods_are_evenly_spaced_in_how_many_of_them_a_command_spans() -> None:
    tried = every_period(0.4, 0.02, 2.0)
    assert np.diff(0.4 / tried) == pytest.approx(PART_OF_A_WAVE)
    assert tried[0] == 2.0 and 0.02 <= tried[-1] < 0.4 / (20.0 - PART_OF_A_WAVE)
    assert len(every_period(0.4, 1e-6, 2.0)) == MOST_PERIODS


def test_the_known_tick_of_an_axis_is_not_that_of_a_sensor_of_the_same_name(tmp_path: Path) -> None:
    write_rig(tmp_path, position={"resolution": 0.002})
    for name, key in (("rig", "axes"), ("model", "drives")):
        content = yaml.safe_load((tmp_path / f"{name}.yaml").read_text())
        content[key] = {"arm": content[key]["a"]}
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(content))
    model = load_model(tmp_path / "model.yaml").with_values({"drive.arm.goal_tick": 0.003})
    found = library(model, [], only=["command_quantisation", "sensor_quantisation"])
    assert {c.name: c.register for c in found.candidates} == {
        "command_quantisation.arm": 0.003,
        "sensor_quantisation.arm": 0.002,
    }


def test_candidates_of_a_sliding_axis_start_within_the_bounds_of_its_size(tmp_path: Path) -> None:
    found = library(load_model(write_rig(tmp_path, slides=True)), ["drive.a.stiffness"])
    infos = found.model.parameters()
    for candidate in found.candidates:
        for column, name in enumerate(candidate.parameters):
            values = starts(candidate)[:, column]
            assert (values >= infos[name].low).all() and (values <= infos[name].high).all(), name


def test_the_phase_of_a_wave_is_any_angle_on_a_sliding_axis_too(tmp_path: Path) -> None:
    """Its likeliest one is found as an angle."""
    infos = library(load_model(write_rig(tmp_path, slides=True)), [], only=["positioning_error"]).model.parameters()
    phase, period = (infos[f"positioning_error.a.{name}"] for name in ("phase", "period"))
    assert (phase.unit, period.unit) == ("rad", "m")
    assert phase.low < -np.pi and phase.high > np.pi


def test_ticks_that_readings_contradict_are_no_candidate() -> None:
    model, (recorded,) = load_model("labyrinth_manual"), plays((5.0,))
    part = next(p for p in axis_parts(model, [recorded]) if p.name == "x")

    def offered(tick: float) -> list[Candidate]:
        read = [replace(t, signals={n: rounded(s, tick) for n, s in t.signals.items()}) for t in recorded.at_stamps]
        stamped = replace(recorded, stamped=tuple(read))
        search = axis_search(model, [stamped], part, SearchOptions(("sensor_quantisation.motor_x",), nthread=1))
        for candidate in search.library.candidates:
            (column, *_) = search.columns(candidate)
            assert starts(candidate)[:, 0].max() <= search.high[column] == pytest.approx(tick)
        return list(search.library.candidates)

    def rounded(series: Series, tick: float) -> Series:
        return replace(series, values=tick * np.round(series.values / tick)) if tick else series

    assert not offered(0.0), "readings that differ by anything are no whole ticks"
    assert [c.name for c in offered(0.008)] == ["sensor_quantisation.motor_x"]


def test_an_effect_in_the_model_is_no_candidate() -> None:
    model = load_model("labyrinth_manual").with_effect("backlash", "x")
    assert "backlash.x" not in {c.name for c in library(model, []).candidates}


def test_what_acts_on_every_axis_is_one_candidate_of_axes_that_are_judged_together() -> None:
    model, recorded = load_model("labyrinth_manual"), plays((5.0,))

    def offered(axes: str, *only: str) -> dict[str, tuple[str, ...]]:
        part = AxisPart(tuple(axes), tuple(f"motor_{axis}" for axis in axes), ())
        search = axis_search(model, recorded, part, SearchOptions(only, nthread=1))
        return {c.name: c.axes for c in search.library.candidates}

    assert offered("xy", "supply_sag") == {"supply_sag.x": ("x", "y")}
    assert offered("y", "supply_sag") == {"supply_sag.y": ("y",)}
    assert offered("xy", "supply_sag.y", "supply_sag.x").keys() == {"supply_sag.x", "supply_sag.y"}, "asked for both"
    model = model.with_effect("supply_sag", "x")
    assert offered("xy", "supply_sag", "constant_torque").keys() == {"constant_torque.x", "constant_torque.y"}


def test_an_unknown_effect_is_refused_with_the_names() -> None:
    with pytest.raises(InputError, match="backlash"):
        library(load_model("labyrinth_manual"), [], only=["blacklash"])

# SPDX-License-Identifier: Apache-2.0
"""Where efforts are compared: not beside sudden changes of the command's speed."""

from dataclasses import replace

import numpy as np
import pytest
from small_recordings import record, write_rig

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search, is_steady
from eps_tunnel_analysis.diagnose.base_values import base_refit
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.stamped import Series
from labyrinth_sim.model import load_model, save_model
from labyrinth_sim.trials import Array

TIME = np.arange(400) * 0.01  # s


def smooth_move(time: Array) -> Array:
    """0.2 rad in a second with the least jerk, then still."""
    s = np.clip(time - 1.0, 0.0, 1.0)
    return np.asarray(0.2 * (10 * s**3 - 15 * s**4 + 6 * s**5))


def test_a_smooth_move_is_steady_and_sudden_ones_are_not() -> None:
    assert is_steady(smooth_move(TIME), 0.01).all()
    step, corner = np.where(TIME < 2.0, 0.0, 0.2), np.maximum(TIME - 2.0, 0.0) * 0.1
    for sudden in (step, corner):
        near = (TIME > 1.995) & (TIME < 2.2)
        assert not is_steady(sudden, 0.01)[near].any()
        assert is_steady(sudden, 0.01)[(TIME < 1.95) | (TIME > 2.3)].all()


def test_a_drive_that_is_off_is_not_steady() -> None:
    off = np.where(TIME < 2.0, 0.1, np.nan)
    assert not is_steady(off, 0.01)[TIME > 2.0].any()


@pytest.fixture(scope="module")
def search(tmp_path_factory: pytest.TempPathFactory) -> Search:
    """Of the base values of a sledge whose mass and drive are stated wrongly."""
    tmp_path = tmp_path_factory.mktemp("sledge")
    model = load_model(write_rig(tmp_path, slides=True))
    bag = record(model, tmp_path / "bag", moves=lambda time: 0.1 - 0.1 * np.cos(np.pi * time))
    heavier = save_model(model.with_values({"body.sledge.mass": 2.3, "drive.a.stiffness": 66.0}), tmp_path / "off.yaml")
    recorded = load_recorded(heavier, [bag], efforts=True)
    (part,) = axis_parts(recorded.model, recorded.plays)
    return axis_search(recorded.model, recorded.plays, part, SearchOptions(only=(), nthread=1))


def test_the_efforts_of_smooth_moves_tell_the_mass(search: Search) -> None:
    found = search.library.base_of(base_refit(search).values)
    assert found["body.sledge.mass"] == pytest.approx(2.0, rel=0.02)
    assert found["drive.a.stiffness"] == pytest.approx(60.0, rel=0.02)


@pytest.mark.parametrize("every", [0.01, 0.002])
def test_longer_steps_tell_efforts_as_shorter_ones_do(search: Search, every: float) -> None:
    held = search.levels["fine"]
    (play,) = held.plays
    sent = play.trials[0].commands["arm"]
    times = np.arange(0.0, sent.time[-1], every) + 0.3 * every
    faster = replace(play.trials[0], commands={"arm": Series(times, np.interp(times, sent.time, sent.values))})
    plays = [replace(play, trials=(faster,))]
    late = held.model.with_values({"drive.a.delay": 0.004})
    long = Evidence(late, held.free, plays, held.signals, held.step(0), extrapolate=True)
    values = search.start.copy()
    values[list(held.free).index("drive.a.delay")] = 0.004
    off = (long(values) - long.finer().finer()(values))[0]
    efforts = np.isin(long.blocks, [held.signals.index("arm_effort")])
    used = np.isin(np.arange(len(off)), search.used) & efforts
    scale = np.ones(len(off))
    scale[search.used] = search.scale
    assert used.sum() > 100
    assert np.mean((off / scale)[used] ** 2) < 1e-3


def test_plain_steps_keep_their_own_efforts(search: Search) -> None:
    """Else what they get wrong of the motion would show in efforts times the drive's stiffness."""
    assert [search.levels[level].parts(0) for level in ("coarse", "own")] == [1, 1]
    assert search.levels["fine"].parts(0) > 1

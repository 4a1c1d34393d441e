# SPDX-License-Identifier: Apache-2.0
"""The next experiment for values."""

import json
import math

import numpy as np
import pytest
from command_line import eps_tunnel, refused
from fit_cases import TRUTH, bag_of, plays, start

from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.values.value_experiment import ValueExperiment, information, value_experiment
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Trials

FREE = ("drive.x.p", "drive.x.d", "drive.x.delay")


def right() -> Model:
    return start().with_values(TRUTH)


def as_play(model: Model, time: np.ndarray, targets: np.ndarray) -> Play:
    run = simulate(model, time, targets).select(("motor_x", "motor_y", "board_x", "board_y"))
    noise = 3e-4 * np.random.default_rng(0).standard_normal((3, *run.values.shape[1:]))
    trials = Trials(run.time, run.signals, run.units, run.values + noise, run.command_channels,
                    np.repeat(run.commands, 3, axis=0))  # fmt: skip
    return Play("", trials)


@pytest.fixture(scope="module")
def designed() -> ValueExperiment:
    return value_experiment(right(), (), FREE, seconds=12.0, nthread=1)


def test_it_stays_within_time_and_limits_and_ends_at_rest(designed: ValueExperiment) -> None:
    command = designed.command
    assert 6.0 < command.duration <= 12.0
    low, high = right().rig.axis("x").limits
    time, targets = command.sample(100.0)
    answer = simulate(right(), time, targets)
    assert low < answer.values[0, :, answer.index("motor_x")].min()
    assert answer.values[0, :, answer.index("motor_x")].max() < high
    assert targets[-1] == pytest.approx([0.0, 0.0])
    assert np.ptp(targets[:, 1]) == 0.0, "no value of y is to be narrowed"


def test_it_tells_half_again_as_much_as_the_usual_sequence_of_the_same_length(designed: ValueExperiment) -> None:
    model = right()
    usual = find_sequence("excite_12s").commands[0]
    widths = []
    for command in (usual, designed.command):
        known = information(model, FREE, [as_play(model, *command.sample(100.0))], nthread=1)
        widths.append(np.sqrt(np.diag(np.linalg.inv(known))))
    ratio = np.exp(np.mean(np.log(widths[1] / widths[0])))
    assert ratio < 0.5, widths


@pytest.mark.study
def test_what_is_known_already_is_narrowed_further() -> None:
    model = right()
    found = value_experiment(model, plays((1.0,)), FREE, seconds=9.0, nthread=1)
    assert [v.name for v in found.values] == list(FREE)
    for value in found.values:
        assert 0.0 < value.after < value.before
    alone = value_experiment(model, (), FREE, seconds=9.0, nthread=1)
    assert all(math.isnan(v.before) for v in alone.values)


def test_information_of_two_plays_is_the_sum() -> None:
    one, other = plays((2.0,)), plays((-4.0,))
    both = information(right(), FREE, [*one, *other], nthread=1)
    parts = [information(right(), FREE, p, nthread=1) for p in (one, other)]
    # The noise is estimated from what is there, so the sum is not exact.
    assert np.allclose(both, sum(parts), rtol=0.3, atol=0.05 * np.abs(both).max())


def test_axes_move_at_the_same_time() -> None:
    found = value_experiment(load_model("labyrinth_mx64"), (), ("drive.*.p",), seconds=6.0, nthread=1)
    assert set(found.pieces) == {"x", "y"}
    _, targets = found.command.sample(100.0)
    assert (np.ptp(targets, axis=0) > 0.05).all()
    assert found.command.duration <= 6.0


def test_what_cannot_be_designed_is_refused() -> None:
    with pytest.raises(InputError, match="shortest takes"):
        value_experiment(right(), (), FREE, seconds=0.3)
    with pytest.raises(InputError, match="Did you mean"):
        value_experiment(right(), (), ("drive.x.q",))


def test_the_command_writes_a_sequence_that_can_be_played(tmp_path) -> None:
    bag_of(tmp_path / "bag", plays((3.0,), trials=1)[0].trials)
    out = tmp_path / "next.yaml"
    call = ["next-experiment", "--for", "values", "--model", "labyrinth_mx64", "--free", "drive.x.p", "--out", out,
            "--seconds", 6]  # fmt: skip
    result = eps_tunnel(*call, "--real", tmp_path / "bag", "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    (command,) = find_sequence(str(out)).commands
    assert command.duration == pytest.approx(told["seconds"])
    assert told["values"][0]["after"] < told["values"][0]["before"]
    refused(*call, told=["exists already"])
    refused("next-experiment", "--for", "names", "--model", "labyrinth", "--out", tmp_path / "n.yaml",
            told=["--for names needs --real"])  # fmt: skip

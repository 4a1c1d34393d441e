# SPDX-License-Identifier: Apache-2.0
"""Which experiment is proposed, of a menu of commands."""

from typing import Any

import numpy as np
import pytest
import yaml

from eps_tunnel_analysis.diagnose.experiment import Experiment, Harsh, chosen, harshness, left_after_fit, menu
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_sim.model import load_model


def test_every_experiment_can_be_written_read_back_and_played() -> None:
    model = load_model("labyrinth_manual")
    limits = {axis.command: axis.limits for axis in model.rig.axes}
    for name, command in menu(model, "x").items():
        text = Experiment(name, command, ("a.x", "b.x"), 3.0, "Decides.").to_yaml()
        sequence = parse_sequence(yaml.safe_load(text), name, name)
        sequence.check_limits(limits)
        np.testing.assert_allclose(sequence.commands[0].sample(100.0)[1], command.sample(100.0)[1], atol=1e-7)


def test_rivals_differ_by_what_neither_can_be_fitted_to() -> None:
    rng = np.random.default_rng(4)
    truth, rival, way = rng.standard_normal((3, 50))
    stiff = np.array([rival])
    assert left_after_fit(truth, stiff, np.zeros((20, 0))) == pytest.approx(np.sum((truth - rival) ** 2))
    towards = np.array([rival, rival + 0.01 * (truth - rival)])
    assert left_after_fit(truth, towards, np.zeros((20, 1))) == pytest.approx(0.0, abs=1e-12)
    held = left_after_fit(truth, towards, np.full((20, 1), 1e3))  # what the old recordings forbid
    assert held == pytest.approx(np.sum((truth - rival) ** 2), rel=1e-3)
    aside = np.array([rival, rival + way])
    assert 0.0 < left_after_fit(truth, aside, np.zeros((20, 1))) < np.sum((truth - rival) ** 2)


@pytest.mark.parametrize(
    ("offers", "taken"),
    [
        ({"chirp": (1.2, 9.0, True), "triangle": (1.1, 2.0, True), "steps": (8.0, 1.0, False)}, "triangle"),
        ({"chirp": (0.5, 9.0, True), "triangle": (0.4, 2.0, True), "steps": (8.0, 1.0, False)}, "chirp"),
        ({"chirp": (0.1, 9.0, True), "quick": (9.0, 30.0, False), "steps": (1.5, 12.0, False)}, "steps"),
        ({"chirp": (0.1, 9.0, True), "steps": (0.6, 12.0, False)}, "steps"),
        ({"chirp": (0.5, 9.0, True), "triangle": (2.0, 2.0, True, True), "steps": (8.0, 1.0, False)}, "chirp"),
        ({"triangle": (0.1, 2.0, True, True), "steps": (8.0, 1.0, False, True)}, "steps"),
        ({}, None),
    ],
)
def test_a_command_beyond_what_was_recorded_or_into_a_stop_is_chosen_only_where_no_other_decides(
    offers: dict[str, tuple[Any, ...]], taken: str | None
) -> None:
    command = next(iter(menu(load_model("labyrinth_manual"), "x").values()))
    listed = [
        (Experiment(name, command, ("a.x", "b.x"), misfit, ""), Harsh(*harsh))
        for name, (misfit, *harsh) in offers.items()
    ]
    best = chosen(listed)
    assert (best.name if best else None) == taken


def test_how_harsh_a_motion_is_does_not_hang_on_how_often_it_was_sampled() -> None:
    def jerk(rate: float) -> float:
        time = np.arange(0.0, 4.0, 1.0 / rate)
        return harshness(np.where(time < 2.0, 0.0, 0.1)[:, None], time, 3)

    assert jerk(100.0) == pytest.approx(jerk(200.0), rel=0.01)
    time = np.arange(0.0, 10.0, 0.01)
    assert harshness(0.1 * np.sin(5.0 * time)[:, None], time, 2) == pytest.approx(0.1 * 25.0 / np.sqrt(2.0), rel=0.01)

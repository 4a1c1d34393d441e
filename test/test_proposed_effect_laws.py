# SPDX-License-Identifier: Apache-2.0
"""A proposed file obeys the laws of effects, whatever terms it is made of."""

import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src" / "labyrinth_sim" / "test"))

from effect_laws import LAWS, STEP, drive_scene, every_scene, played

from eps_tunnel_analysis.diagnose.added_force import Playing
from eps_tunnel_analysis.law.effect_file import declared, effect_file, seen_mark
from eps_tunnel_analysis.law.formula import Chosen, command_dictionary, dictionary, sensor_dictionary
from eps_tunnel_analysis.law.missing_force import SWINGS
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.build import own_inertia
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

SIZE = 0.2  # of the drive's torque, root mean square, that each term adds
OFF = 0.01  # rad, root mean square, that each term of a sensor adds
FORCES = ("constant", "wave", "spring", "bend", "cubic", "friction", "stribeck", "viscous", "drag", "uneven",
          "trailing", "creeping", "swinging", "link", "bristles", "load", "tight", "places", "fading", "warming",
          "coupling", "rubbing")  # fmt: skip
# Others are in TOGETHER.
BY_THEMSELVES = ("constant", "spring", "bend", "cubic", "link", "bristles", "tight", "places", "coupling", "rubbing")
SENSORS = ("offset", "scale", "bend", "wave", "late", "play", "far_end", "coupled")
COMMANDS = ("offset", "scale", "wave", "ticks", "late", "lag", "limit", "profile", "coupled")
TOGETHER = ("fading + drag", "friction + stribeck + viscous", "wave + trailing + creeping + warming",
            "uneven + drag", "-viscous + drag", "-friction + load", "swinging + trailing + swinging",
            "bristles + fading + link")  # fmt: skip
LATE = ("offset + late", "late + wave + scale")
COMMANDED = ("scale + late", "limit + wave", "coupled + offset")
DICTIONARIES = {"force": dictionary, "sensor": sensor_dictionary, "command": command_dictionary}


@pytest.fixture(scope="module")
def scenes():
    """A law is found over angles that were visited, so the single axis is not to go far beyond those of the others."""
    return every_scene() | {"pendulum": drive_scene(load_model("pendulum"), 0.07)}


@pytest.fixture(scope="module")
def without(scenes):
    return played(scenes)


@cache
def recorded():
    """The scene of two axes as a recording of its model, and what its first axis goes through."""
    scene = every_scene()["labyrinth"]
    model, rig = scene.model, scene.model.rig
    values = scene.play(model)
    signals = tuple(m.signal for m in rig.measured)
    trials = Trials(np.arange(values.shape[1]) * STEP, signals, rig.units[: len(signals)], values[..., : len(signals)],
                    rig.command_channels, scene.commands[None])  # fmt: skip
    play = Play("scene", trials)
    motion = Playing(model, [play], "x", signals[:1]).motion(0)
    return model, play, motion


def design():
    """What a dictionary asks of a design."""
    inertia = SWINGS * own_inertia(recorded()[0], "x")
    made = SimpleNamespace(plays=[SimpleNamespace(motion=recorded()[2])], missing=SimpleNamespace(inertia=inertia))
    made.at = lambda signal: made
    return made


@cache
def proposed(kind, names):
    """The effect that is proposed of these terms, of one size each; a minus before a term turns it round."""
    model, play, motion = recorded()
    terms = {t.name: t for t in DICTIONARIES[kind](design())}
    size = SIZE * np.sqrt(np.mean(motion.drive**2)) if kind == "force" else OFF
    chosen = []
    for name in names.split(" + "):
        term = terms[name.removeprefix("-")]
        shape = term.shape[len(term.shape) // 2] if term.shape else 0.0
        each = size / np.sqrt(np.mean(term.columns(motion, shape)[:, 0] ** 2)) * (-1.0 if name[0] == "-" else 1.0)
        each = shape if term.shape and len(term.numbers) == 1 else each
        values = {n.name: each if n.switches else shape if np.isnan(n.begins) else n.begins for n in term.numbers}
        chosen.append(Chosen(term, values | ({"phase": 0.5} if "phase" in values else {})))
    place = "board_x" if kind == "sensor" else "x"
    mark = seen_mark(model, declared(effect_file(chosen)), place, play)
    return declared(effect_file(chosen, mark))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("names", BY_THEMSELVES + TOGETHER)
def test_a_force(names, law, scenes, without):
    law(proposed("force", names), scenes, without)


@pytest.mark.study
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("names", [name for name in FORCES if name not in BY_THEMSELVES])
def test_a_force_that_is_also_tried_with_others(names, law, scenes, without):
    law(proposed("force", names), scenes, without)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("names", SENSORS + LATE)
def test_a_sensor(names, law, scenes, without):
    law(proposed("sensor", names), scenes, without)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("names", COMMANDED)
def test_a_command(names, law, scenes, without):
    law(proposed("command", names), scenes, without)


@pytest.mark.study
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("names", COMMANDS)
def test_a_term_of_a_command(names, law, scenes, without):
    law(proposed("command", names), scenes, without)


def test_every_term_is_tried():
    for kind, names in {"force": FORCES, "sensor": SENSORS, "command": COMMANDS}.items():
        assert sorted(t.name for t in DICTIONARIES[kind](design())) == sorted(names)
    often = {part.removeprefix("-") for names in BY_THEMSELVES + TOGETHER for part in names.split(" + ")}
    assert often == set(FORCES), "without the long studies, too"

# SPDX-License-Identifier: Apache-2.0
"""Laws that every effect obeys, and the scenes that they are played in; none is named here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from labyrinth_sim.build import compiled
from labyrinth_sim.effect import Effect
from labyrinth_sim.marks import MARKS, Pair
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.stepping import Stepper

STEP = 0.01
RESOLUTION = 1e-4  # rad, m, and the like; below it a recorded signal says nothing


@dataclass(frozen=True)
class Scene:
    """A model under a command that shows what its effects do."""

    model: Model
    commands: np.ndarray
    start: dict[str, float]

    @property
    def time(self) -> np.ndarray:
        return np.arange(len(self.commands)) * STEP

    def play(
        self, model: Model, names: tuple[str, ...] = (), values: np.ndarray | None = None, nthread: int = 0
    ) -> np.ndarray:
        """(n, T, m) for n parameter sets."""
        table = np.empty((1, 0)) if values is None else values
        result = simulate_batch(
            model, names, table, self.time, self.commands[None], self.start, timestep=self.timestep, nthread=nthread
        )
        assert not result.failed.any(), result.messages
        return np.asarray(result.values[:, 0])

    @property
    def timestep(self) -> float | None:
        """s; coarse, to be quick, but for the ball."""
        return None if self.start else 0.005

    def column(self, place: str) -> int:
        """Of the signal that shows an effect at a place best: the load of an axis, the signal itself, the ball."""
        rig = self.model.rig
        names = [m.signal for m in rig.measured] + list(BALL_SIGNALS)
        if place in names or place == "ball":
            return names.index("ball_x" if place == "ball" else place)
        axis = rig.axis(place)
        return names.index(next(m.signal for m in axis.measured if m.joint == axis.load and m.quantity == "position"))


def drive_scene(model: Model, size: float) -> Scene:
    """A slow triangle, then steps of both axes, one of them small, then a sine of the other axis alone."""
    t = np.arange(601) * STEP
    x = np.interp(t, [0, 0.8, 2.4, 3.2], [0, 1, -1, 0])
    x[(t > 3.3) & (t < 3.8)], x[(t > 3.8) & (t < 4.3)], x[(t > 4.3) & (t < 4.6)] = 0.83, -0.8, -0.3
    y = np.where(t > 4.8, 0.9 * np.sin(8 * (t - 4.8)), 0.0)
    y[(t > 3.8) & (t < 4.1)] = 0.9
    return Scene(model, size * np.stack([x, y], axis=1)[:, : len(model.rig.axes)], {})


def ball_scene(model: Model) -> Scene:
    """The board level for a second, then tilted; 90 mm of corridor before the ball, a wall shortly before the end."""
    t = np.arange(271) * STEP
    return Scene(model, np.stack([0 * t, np.where(t < 1, 0.0, 0.012)], axis=1), {"ball_x": 0.18, "ball_y": 0.135})


Scenes = Mapping[str, Scene]
Played = Mapping[str, np.ndarray]
Law = Callable[[Effect, Scenes, Played], None]


def every_scene() -> dict[str, Scene]:
    """Two axes behind belts, the same with a ball, and a single axis."""
    labyrinth = load_model("labyrinth_manual")
    return {
        "labyrinth": drive_scene(labyrinth, 0.07),
        "ball": ball_scene(labyrinth),
        "pendulum": drive_scene(load_model("pendulum"), 1.0),
    }


def played(scenes: Scenes) -> Played:
    """What each scene shows without any effect added."""
    return {name: scene.play(scene.model)[0] for name, scene in scenes.items()}


def home(effect: Effect) -> str:
    return "ball" if effect.where == "ball" or "ball" in effect.needs else "labyrinth"


def off_changes_no_bit(effect: Effect, scenes: Scenes, without: Played) -> None:
    scene = scenes[home(effect)]
    for place in scene.model.places(effect):
        assert np.array_equal(scene.play(scene.model.with_effect(effect, place, effect.off))[0], without[home(effect)])


def one_size_over_the_bounds_at_any_number_of_threads(effect: Effect, scenes: Scenes, _: Played) -> None:
    scene = scenes[home(effect)]
    place = scene.model.places(effect)[0]
    model = scene.model.with_effect(effect, place)
    names = tuple(f"{effect.name}.{place}.{p.name}" for p in effect.parameters)
    ends = np.array([[p.low for p in effect.parameters], [p.high for p in effect.parameters]])
    plans = [compiled(model.with_values(dict(zip(names, end, strict=True))), home(effect) == "ball") for end in ends]
    assert plans[0] is plans[1]
    seen = scene.play(model, names, ends, nthread=1)
    assert np.isfinite(seen).all()
    assert np.array_equal(seen, scene.play(model, names, ends, nthread=3))


def the_live_stepper_is_the_batch(effect: Effect, scenes: Scenes, _: Played) -> None:
    scene = scenes[home(effect)]
    model = scene.model.with_effect(effect, scene.model.places(effect)[0])
    short = replace(scene, commands=scene.commands[150:300])
    stepper = Stepper(model, step=STEP, with_ball=home(effect) == "ball", timestep=scene.timestep)
    live = [stepper.reset(short.start)] + [stepper.advance(command) for command in short.commands[:-1]]
    seen = [i for i, unit in enumerate(model.rig.units[: len(live[0])]) if unit != "N m"]  # efforts: of the last step
    assert np.array_equal(short.play(model)[0][:, seen], np.array(live)[:, seen])


def the_declared_mark_shows(effect: Effect, scenes: Scenes, without: Played) -> None:
    scores = {}
    for name in [home(effect)] + (["pendulum"] if home(effect) == "labyrinth" else []):
        scene = scenes[name]
        present = {use.effect.name for use in scene.model.effects}
        places = () if effect.name in present else scene.model.places(effect)
        for place in places:
            column = scene.column("ball" if name == "ball" else place)
            seen = scene.play(scene.model.with_effect(effect, place))[0]
            others = [a for a in scene.model.rig.axes if place not in (a.name, *(m.signal for m in a.measured))]
            other = without[name][:, scene.column(others[0].name)] if others else 0 * scene.time
            command = np.abs(scene.commands).sum(axis=1) if name == "ball" else scene.commands[:, 0]
            pair = Pair(STEP, command, without[name][:, column], seen[:, column], other)
            scores[f"{name} {place}"] = MARKS[effect.shows](pair)
    assert max(scores.values()) > 0.4, scores


def it_hears_of_the_other_axes_if_and_only_if_it_says_so(effect: Effect, scenes: Scenes, without: Played) -> None:
    scene = scenes["labyrinth"]
    places = scene.model.places(effect) if home(effect) == "labyrinth" else ()
    other_still = replace(scene, commands=scene.commands * [1.0, 0.0])
    for place in (p for p in places if p in ("x", *(m.signal for m in scene.model.rig.axis("x").measured))):
        own = scene.column(place)
        model = scene.model.with_effect(effect, place)
        heard = scene.play(model)[0, :, own] - other_still.play(model)[0, :, own]
        anyway = without["labyrinth"][:, own] - other_still.play(scene.model)[0, :, own]
        assert (np.abs(heard - anyway).max() > RESOLUTION) == effect.couples


def a_known_value_is_recovered(effect: Effect, scenes: Scenes, _: Played) -> None:
    scene = scenes[home(effect)]
    p = effect.main
    assert p.off is not None
    place = scene.model.places(effect)[-1 if scene.start else 0]
    told = slice(-2 if scene.start else 0, None)  # a ball's knocks on the board are below any sensor's noise
    model, name = scene.model.with_effect(effect, place), f"{effect.name}.{place}.{p.name}"
    truth = p.off + 0.9 * (p.typical - p.off)
    seen = scene.play(model.with_values({name: truth}))[0, :, told]
    scale = np.maximum(seen.std(axis=0), RESOLUTION)
    low, high = p.low, p.high
    # A grid, then a finer one about its best point. What works sample by sample may have a jagged misfit.
    many = 161 if effect.stage in ("command", "measurement") else 41
    for points in (21 if home(effect) == "ball" else many, 9):
        grid = np.linspace(low, high, points)
        misfit = (((scene.play(model, (name,), grid[:, None])[..., told] - seen) / scale) ** 2).mean(axis=(1, 2))
        best, pitch = grid[misfit.argmin()], grid[1] - grid[0]
        low, high = max(p.low, best - pitch), min(p.high, best + pitch)
    assert best == pytest.approx(truth, abs=0.015 * (p.high - p.low))


LAWS: tuple[Law, ...] = (
    off_changes_no_bit,
    one_size_over_the_bounds_at_any_number_of_threads,
    the_live_stepper_is_the_batch,
    the_declared_mark_shows,
    it_hears_of_the_other_axes_if_and_only_if_it_says_so,
    a_known_value_is_recovered,
)

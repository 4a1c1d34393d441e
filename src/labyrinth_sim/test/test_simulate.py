# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labyrinth_sim.build import compiled
from labyrinth_sim.effect import effects
from labyrinth_sim.engine import Engine
from labyrinth_sim.errors import InputError
from labyrinth_sim.first_state import first_state
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import BatchResult, numbers_of, rest_targets, simulate, simulate_batch
from labyrinth_sim.stepping import Stepper

TIME = np.arange(151) * 0.01


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("labyrinth_manual")


@pytest.fixture(scope="module")
def commands() -> np.ndarray:
    """(151, 2) rad: steps of both axes."""
    u = np.full((len(TIME), 2), np.radians(2.5))
    u[10:60, 0] *= -1
    u[40:90, 1] *= -1
    return u


def test_a_servo_reaches_its_target(model: Model, commands: np.ndarray) -> None:
    trials = simulate(model, TIME, commands)
    for signal in ("motor_x", "motor_y", "board_x", "board_y"):
        assert trials.values[0, -1, trials.index(signal)] == pytest.approx(np.radians(2.5), abs=1e-3)


@pytest.mark.parametrize("drive", ["labyrinth_mx64", "horn"])
def test_goals_in_ticks_are_targets_rounded(drive: str) -> None:
    given = load_model(drive)
    ticks = [name for name in given.values() if name.endswith(".goal_tick")]
    coarse, fine = (given.with_values(dict.fromkeys(ticks, tick)) for tick in (0.004, 0.0))
    ramp = np.repeat(0.03 * np.sin(3.0 * TIME)[:, None], len(ticks), axis=1)
    ramp[100:110] = np.nan
    rounded = simulate(fine, TIME, np.round(ramp / 0.004) * 0.004)
    assert np.array_equal(simulate(coarse, TIME, ramp).values, rounded.values)
    assert not np.allclose(simulate(fine, TIME, ramp).values, rounded.values, atol=1e-4)


def test_threads_do_not_change_a_bit(model: Model, commands: np.ndarray) -> None:
    rich = model.with_effect("load_friction", "x").with_effect("backlash", "y")
    values = np.linspace(5, 20, 7)[:, None]
    one, three = (
        simulate_batch(rich, ["drive.x.p"], values, TIME, [commands, -commands], nthread=n).values for n in (1, 3)
    )
    assert np.array_equal(one, three)


def started(model: Model, targets: np.ndarray) -> Engine:
    plan, n = compiled(model, False), len(targets)
    engine = Engine(model, plan, numbers_of(model, n), n, 0.01, 1)
    qpos, qvel = first_state(model, plan.mj, False, n, {})
    engine.start(qpos, qvel, rest_targets(plan, qpos, targets[:, 0]))
    return engine


@pytest.mark.parametrize("name", ["labyrinth_manual", "labyrinth_mx64", "horn", "two_link_arm"])
def test_mujoco_without_a_stop_gives_what_single_steps_give(name: str) -> None:
    """Bit for bit, efforts included; drives are switched off and on, in each simulation at times of its own."""
    model = load_model(name)
    model = model.with_values({n: 3.0 for n in model.values() if n.startswith("drive.") and n.endswith(".d")})
    targets = np.repeat(0.05 * np.sin(5.0 * TIME)[None, :, None], len(model.rig.axes), axis=2) * [[[1.0]], [[-0.6]]]
    targets[0, 60:75, 0] = targets[1, 70:, 0] = targets[1, :5, -1] = np.nan
    rolled, stepped = started(model, targets), started(model, targets)
    through = rolled.roll(targets)
    assert np.array_equal(through, stepped._stepped(targets))
    assert not np.array_equal(through[0], through[1])
    more = targets[:, ::-1]  # and the next roll-out goes on from where both stand
    assert np.array_equal(rolled.roll(more), stepped._stepped(more))


def test_what_only_a_sensor_shows_is_not_stepped_again(model: Model, commands: np.ndarray) -> None:
    rich = model.with_effect("sensor_bias", "board_y").with_effect("sensor_delay", "motor_x")
    names = ["sensor_bias.board_y.bias", "sensor_delay.motor_x.delay", "drive.x.p"]
    values = np.array([[0.0, 0.0, 8.0], [0.01, 0.0, 8.0], [0.0, 0.02, 8.0], [0.01, 0.02, 12.0]])
    batch = simulate_batch(rich, names, values, TIME, commands[None])
    rows = [simulate_batch(rich, names, row, TIME, commands[None]) for row in values]
    assert np.array_equal(batch.values, np.concatenate([row.values for row in rows]))
    assert not np.array_equal(batch.values[0], batch.values[1])
    assert batch.steps == 2 * rows[0].steps  # one for each gain of the drive
    both = simulate_batch(rich, names, values[:2], TIME, [commands, -commands])
    assert both.steps == 2 * rows[0].steps  # and for each command


def test_extrapolated_steps_come_nearer_to_steps_of_no_length(model: Model) -> None:
    rich = model.with_effect("sensor_quantisation", "motor_x", {"tick": 0.002, "noise": 0.0})
    swing = np.repeat(0.03 * np.sin(3.0 * TIME)[:, None], 2, axis=1)

    def at(step: float, **more: bool) -> np.ndarray:
        return simulate_batch(rich, (), np.empty((1, 0)), TIME, swing[None], timestep=step, **more).values[0, 0]

    limit, plain = at(0.000625, extrapolate=True), at(0.00125)
    extrapolated = at(0.0025, extrapolate=True)
    board = rich.rig.signals.index("board_x")
    plain_error, error = (np.sqrt(np.mean((seen - limit)[:, board] ** 2)) for seen in (plain, extrapolated))
    assert error < 0.05 * plain_error
    ticks = extrapolated[:, rich.rig.signals.index("motor_x")] / 0.002
    assert np.allclose(ticks, np.round(ticks), atol=1e-9)  # sensors see what was extrapolated
    both = simulate_batch(model, ["drive.x.p"], [[8.0], [15.0]], TIME, swing[None], extrapolate=True)
    first = simulate_batch(model, ["drive.x.p"], [[8.0]], TIME, swing[None], extrapolate=True)
    assert np.array_equal(both.values[:1], first.values)


def test_a_batch_is_its_simulations(model: Model, commands: np.ndarray) -> None:
    names, values = ["drive.x.p", "joint.motor_y.armature"], np.array([[5.0, 0.02], [12.0, 0.005]])
    batch = simulate_batch(model, names, values, TIME, commands[None])
    for i, row in enumerate(values):
        alone = simulate(model.with_values(dict(zip(names, row, strict=True))), TIME, commands)
        assert np.array_equal(batch.values[i, 0], alone.values[0])


@pytest.mark.parametrize(("friction", "ball"), [(False, False), (True, False), (True, True)])
def test_the_live_stepper_is_the_batch(model: Model, commands: np.ndarray, friction: bool, ball: bool) -> None:
    rich = model.with_effect("sensor_bias", "board_y").with_effect("command_delay", "y")
    rich = rich.with_values({"drive.x.d": 5.0}).with_effect("camera_latency", "ball")
    if friction:  # a hook before every step; without one MuJoCo steps through without a stop
        rich = rich.with_effect("load_friction", "x")
    block = commands.copy()
    block[100:120, 0] = np.nan
    whole = simulate(rich, TIME, block, with_ball=ball).values[0]
    stepper = Stepper(rich, with_ball=ball)
    live = [stepper.reset(first_command=block[0])] + [stepper.advance(u) for u in block[:-1]]
    position = [i for i, unit in enumerate(model.rig.units[: whole.shape[1]]) if unit != "N m"]
    assert np.array_equal(whole[:, position], np.array(live)[:, position])


def test_an_effort_is_the_one_that_acts_from_its_sample_on(model: Model) -> None:
    bare = model.with_values({"drive.x.delay": 0.0, "drive.x.p": 12.0, "drive.x.d": 4.0, "drive.x.goal_tick": 0.0})
    ramp = np.tile(0.05 * TIME[:, None], 2)
    seen = simulate(bare, TIME, ramp)
    angle, speed, effort = (seen.values[0, :, seen.index(f"motor_x{n}")] for n in ("", "_velocity", "_effort"))
    wanted = 12.0 * (ramp[:, 0] - angle) + 4.0 * 0.01 * (np.gradient(ramp[:, 0], TIME) - speed)  # equation 8
    expected = bare.values()["drive.x.speed_gain"] * (wanted - speed)
    assert effort[1:] == pytest.approx(expected[1:], abs=1e-9)


@pytest.mark.parametrize("effect", ["", "load_friction", "backlash"])
def test_the_effort_of_an_extrapolated_ramp_is_the_friction(model: Model, effect: str) -> None:
    """Beside nothing, a force before every step, and an error; a target held for a sample would add to it."""
    bare = model.with_effect("coulomb_friction", "x", {"torque": 0.2, "slow": 0.0})
    bare = bare.with_effect(effect, "x") if effect else bare

    def ramp(time: np.ndarray, step: float) -> np.ndarray:
        return np.tile(0.08 * (time[:, None] + step / 2.0), 2)

    parts, often = np.arange(4 * len(TIME)) * 0.0025, np.arange(20 * (len(TIME) - 1) + 1) * 0.0005
    seen = simulate_batch(
        bare, (), np.empty((1, 0)), TIME, ramp(parts, 0.0025)[None], signals=("motor_x_effort",), timestep=0.01,
        extrapolate=True, parts=4,
    )  # fmt: skip
    exact = simulate(bare, often, ramp(often, 0.0005))
    wanted = exact.values[0, often > 0.75, exact.index("motor_x_effort")]
    assert np.mean(seen.efforts["motor_x_effort"][0, 0, parts > 0.75]) == pytest.approx(np.mean(wanted), abs=0.003)


def test_only_motion_is_extrapolated(model: Model, commands: np.ndarray) -> None:
    def at(step: float, extrapolate: bool = False) -> np.ndarray:
        seen = simulate_batch(model, (), np.empty((1, 0)), TIME, commands[None], timestep=step, extrapolate=extrapolate)
        assert not seen.efforts
        return np.asarray(seen.values[0, 0])

    torque = np.array([m.quantity == "torque" for m in model.rig.measured])
    short, long, extrapolated = at(0.00125), at(0.0025), at(0.0025, extrapolate=True)
    assert np.allclose(extrapolated[:, ~torque], (2.0 * short - long)[:, ~torque], atol=1e-12)
    assert np.array_equal(extrapolated[:, torque], short[:, torque])


EFFORT_STEP, FINE = 0.0025, 0.0001  # s
HELD_FOR = 0.01  # s, of each command, the first of which begins within a step
WITHIN = 0.0033


@pytest.mark.parametrize(
    ("values", "effect"),
    [
        ({}, ""),
        ({"drive.x.d": 3.0, "drive.x.i": 5.0}, ""),
        ({"drive.x.torque": 0.05}, ""),  # saturated much of the time
        ({}, "viscous_friction"),
        ({}, "load_friction"),  # laws between the steps
        ({"drive.x.torque": 0.3, "supply_sag.x.sag": 5.0}, "supply_sag"),  # a lower limit than the servo's
    ],
)
def test_efforts_between_steps_are_those_of_fine_steps(model: Model, values: dict[str, float], effect: str) -> None:
    stiff = model.with_effect(effect, "x") if effect else model
    stiff = stiff.with_values({"drive.x.p": 20.0, "drive.x.delay": 0.0112, **values})

    def commands(time: np.ndarray) -> np.ndarray:
        held = HELD_FOR * np.floor((time - WITHIN) / HELD_FOR + 1e-9) + WITHIN
        return np.tile(np.where(time < WITHIN, 0.0, 0.05 * np.sin(5.0 * held))[:, None], 2)

    def rolled(step: float, parts: int, extrapolate: bool) -> BatchResult:
        time = np.arange(round(1.5 / step) + 1) * step
        often = (np.arange(len(time) * parts * 50) + 0.5) * step / parts / 50.0
        means = commands(often).reshape(len(time) * parts, 50, 2).mean(axis=1)
        return simulate_batch(
            stiff, (), np.empty((1, 0)), time, means[None], signals=("motor_x", "motor_x_effort"), timestep=step,
            extrapolate=extrapolate, parts=parts,
        )  # fmt: skip

    coarse, fine = rolled(EFFORT_STEP, 8, True), rolled(FINE, 1, False)
    efforts = coarse.efforts["motor_x_effort"][0, 0]
    time = np.arange(len(efforts)) * EFFORT_STEP / 8.0
    every = np.arange(fine.values.shape[2]) * FINE
    apart = np.abs((time - WITHIN - 0.0112 + HELD_FOR / 2.0) % HELD_FOR - HELD_FOR / 2.0)
    clear = (time > 0.05) & (time < 1.49) & (apart > 0.0004)  # where no part has a jump in it
    exact = np.interp(time, every, fine.values[0, 0, :, 1])
    steps = np.arange(coarse.values.shape[2]) * EFFORT_STEP
    held = np.interp(time, steps, coarse.values[0, 0, :, 1])
    error, before = (float(np.sqrt(np.mean((seen - exact)[clear] ** 2))) for seen in (efforts, held))
    assert error < 0.25 * before


def test_efforts_between_steps_are_none_where_the_drive_is_off(model: Model) -> None:
    parts = np.tile(0.05 * np.sin(5.0 * np.arange(4 * len(TIME)) * 0.0025)[:, None], 2)
    parts[200:260, 0] = np.nan
    seen = simulate_batch(model, (), np.empty((1, 0)), TIME, parts[None], extrapolate=True, parts=4)
    assert set(seen.efforts) == {"motor_x_effort", "motor_y_effort"}
    effort = seen.efforts["motor_x_effort"][0, 0]
    (none,) = np.nonzero(effort[100:] == 0.0)
    assert len(none) == np.ptp(none) + 1 == 60  # later by the drive's delay


def test_a_sample_has_one_part_or_an_even_number_of_them(model: Model) -> None:
    with pytest.raises(InputError, match="parts must be 1 or even, got 3"):
        simulate_batch(model, (), np.empty((1, 0)), TIME, np.zeros((1, 3 * len(TIME), 2)), parts=3)
    with pytest.raises(InputError, match=r"commands must have shape \(c, 604, 2\)"):
        simulate_batch(model, (), np.empty((1, 0)), TIME, np.zeros((1, len(TIME), 2)), parts=4)


def test_a_drive_switched_off_lets_go(model: Model) -> None:
    off = np.full((len(TIME), 2), np.nan)
    trials = simulate(model, TIME, off, {"motor_x": 0.05, "motor_x_velocity": 0.2})
    assert np.abs(trials.values[0, :, trials.index("motor_x_effort")]).max() == 0.0
    assert trials.values[0, 20, trials.index("motor_x")] > 0.06


def test_effects_survive_a_drive_that_is_switched_off_and_on(model: Model) -> None:
    for name in (
        "backlash",
        "dead_band",
        "rate_limit",
        "positioning_error",
        "load_friction",
        "supply_sag",
        "gain_error",
    ):
        model = model.with_effect(name, "x")
    time = np.arange(201) * 0.01
    commands = np.stack([0.05 * np.sin(3 * time), 0 * time], axis=1)
    commands[60:120] = np.nan
    seen = simulate(model, time, commands)
    assert np.isfinite(seen.values).all()
    off = seen.values[0, 65:120, seen.index("motor_x_effort")]  # the drive is 30 ms late
    assert np.abs(off).max() == 0.0
    assert np.ptp(seen.values[0, 125:, seen.index("motor_x")]) > 0.01


def test_one_divergence_leaves_the_others_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    horn = load_model("horn").with_effect("return_spring", "horn", {"stiffness": 20.0})
    mjcf = tmp_path / "horn.xml"
    mjcf.write_text(horn.rig.mjcf.read_text().replace("implicitfast", "Euler"))
    model = replace(horn, rig=replace(horn.rig, mjcf=mjcf))
    names, commands = ["joint.horn.armature"], np.full((1, len(TIME), 1), 0.1)
    values = np.array([[0.01], [1e-6], [0.02]])  # the spring throws so light a horn further with every step
    batch = simulate_batch(model, names, values, TIME, commands)
    alone = simulate_batch(model, names, values[[0, 2]], TIME, commands)
    assert batch.failed[:, 0].tolist() == [False, True, False]
    assert np.isnan(batch.values[1]).all()
    assert "diverged" in batch.messages[1, 0]
    assert np.array_equal(batch.values[[0, 2]], alone.values)
    assert list(tmp_path.iterdir()) == [mjcf]


def test_all_complaints_come_at_once(model: Model, commands: np.ndarray) -> None:
    with pytest.raises(InputError) as caught:
        simulate_batch(model, ["drive.x.q", "drive.z.p"], [[1.0, 2.0]], TIME, commands[None, :, :1], {"motor_z": 0.0})
    assert len(caught.value.complaints) == 4
    assert "drive.x.p" in str(caught.value)


def test_a_value_known_per_command_is_that_commands(model: Model, commands: np.ndarray) -> None:
    both = simulate_batch(model, (), np.empty((1, 0)), TIME, [commands] * 2, per_command={"drive.x.p": [6.0, 12.0]})
    for i, p in enumerate((6.0, 12.0)):
        alone = simulate(model.with_values({"drive.x.p": p}), TIME, commands)
        assert np.array_equal(both.values[0, i], alone.values[0])
    with pytest.raises(InputError, match=r"shape \(2,\)"):
        simulate_batch(model, (), np.empty((1, 0)), TIME, [commands] * 2, per_command={"drive.x.p": [6.0]})


def test_chosen_signals_are_those_of_all(model: Model, commands: np.ndarray) -> None:
    every = simulate_batch(model, (), np.empty((1, 0)), TIME, commands[None])
    two = simulate_batch(model, (), np.empty((1, 0)), TIME, commands[None], signals=["board_y", "motor_x"])
    assert two.signals == ("board_y", "motor_x")
    for column, name in enumerate(two.signals):
        assert np.array_equal(two.values[..., column], every.values[..., every.signals.index(name)])
    with pytest.raises(InputError, match="ball_x"):
        simulate_batch(model, (), np.empty((1, 0)), TIME, commands[None], signals=["ball_x"])


def test_a_drive_that_rests_under_its_first_command_carries_its_load_from_the_start() -> None:
    """A pendulum that hangs in its servo's error stays there; without friction only its drive can hold it."""
    given = load_model("pendulum").without_effect("coulomb_friction", "pendulum")
    given = given.without_effect("viscous_friction", "pendulum").with_values({"drive.pendulum.delay": 0.04})
    goal = np.full((1, 600, 1), 0.5)
    long = 0.01 * np.arange(600)
    reached = simulate_batch(given, (), np.empty((1, 0)), long, goal, {"pendulum": np.array([0.5])})
    rest = reached.values[0, 0, -1, :1]
    assert 0.02 < 0.5 - rest[0] < 0.4

    def moved(resting: list[list[bool]] | None) -> float:
        start = {"pendulum": rest}
        found = simulate_batch(given, (), np.empty((1, 0)), TIME, goal[:, : len(TIME)], start, resting=resting)
        return float(np.ptp(found.values[0, 0, :, 0]))

    assert moved([[True]]) < 1e-4 < 1e-2 < moved([[False]])
    assert moved(None) == moved([[False]])


def test_a_word_on_rest_is_one_for_each_command_and_axis(model: Model, commands: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"resting must have shape \(1, 2\), got \(1, 1\)"):
        simulate_batch(model, (), np.empty((1, 0)), TIME, commands[None], resting=[[True]])


def test_a_step_within_a_sample_counts_as_long_as_it_acts_though_the_drive_saturates() -> None:
    """Delays of parts of a sample: a coarse roll-out goes where a fine one does, and not by whole samples."""
    given = load_model("pendulum").with_values({"drive.pendulum.kp": 4000.0})
    delays = np.arange(0.010, 0.015, 0.0005)[:, None]
    step, fine = 0.005, 0.0005

    def moved(every: float, parts: int | None) -> np.ndarray:
        time = np.arange(round(0.4 / every) + 1) * every
        sent = np.where(time >= 0.05 - 1e-9, 1.0, 0.0)[None, :, None]
        found = simulate_batch(given, ["drive.pendulum.delay"], delays, time, sent, timestep=fine, parts=parts)
        return found.values[:, 0, :: round(step / every), 0]

    exact = moved(fine, None)
    off = [float(np.abs(moved(step, parts) - exact).max()) for parts in (1, None)]
    assert off[0] < 0.005 < 0.15 * off[1]
    assert np.array_equal(moved(step, 1)[0], moved(step, None)[0])  # here every sample holds all of a command


SATURATED = {
    "pendulum": {"drive.pendulum.kp": 4000.0},  # full duty, with back-EMF beyond its limit
    "horn": {"drive.horn.stiffness": 100.0, "drive.horn.damping": 1.0, "drive.horn.back_emf": 0.1},
}


@pytest.mark.parametrize("name", SATURATED)
@pytest.mark.parametrize("law", [False, True])
def test_a_drive_that_gives_all_it_has_turns_around_within_a_sample(name: str, law: bool) -> None:
    """To and fro, saturated before each command and after it, so that the instants decide on the motion."""
    given = load_model(name).with_values(SATURATED[name])
    if law:  # stepped one by one, with laws between the steps
        given = given.with_effect("load_friction", name, {"share": 0.01})
    delays = np.array([[0.0102], [0.0115], [0.0138]])
    step = 0.002

    def moved(every: float) -> np.ndarray:
        time = np.arange(round(0.6 / every) + 1) * every
        turns = np.floor((time + 1e-9) / 0.06)
        sent = np.where(turns < 1, 0.0, np.where(turns % 2 == 1, 1.0, -1.0))[None, :, None]
        found = simulate_batch(
            given, [f"drive.{name}.delay"], delays, time, sent, timestep=every, extrapolate=True,
            parts=1 if every == step else None,
        )  # fmt: skip
        return found.values[:, 0, :: round(step / every), 0]

    exact, seen = moved(0.0001), moved(step)
    assert np.abs(exact).max() > 0.25
    assert np.abs(seen - exact).max() < 0.005  # 0.02 to 0.035 if each turn waits for the next sample


def test_a_ramp_is_no_step_however_fast_for_a_stiff_drive() -> None:
    step, slope = 0.001, 2.0
    given = load_model("horn").with_values({"drive.horn.stiffness": 500.0, "drive.horn.torque": 0.1}, "stiff")
    time = step * np.arange(400)
    ramp = (slope * (time + step / 2.0))[None, :, None]  # the mean over each sample
    found = [
        simulate_batch(given, (), np.empty((1, 0)), time, ramp, timestep=step, parts=parts).values
        for parts in (1, None)
    ]
    assert found[0] == pytest.approx(found[1], abs=1e-12)


@pytest.mark.parametrize("name", [name for name, effect in effects().items() if effect.command])
def test_an_axis_that_rests_under_its_first_command_stays_there(model: Model, name: str) -> None:
    """Though a drive that acts late would hear for a while what was not yet changed on its way."""
    effect = effects()[name]
    typical = {p.name: p.typical for p in effect.parameters}
    late = model.with_values({"drive.x.delay": 0.03}).with_effect(effect, "x", typical)
    held = np.broadcast_to([0.07, -0.05], (400, 2))
    time, positions = np.arange(400) * 0.01, ("motor_x", "board_x", "motor_y", "board_y")
    moved = simulate(late, time, held)
    pose = {signal: moved.values[0, -1, moved.index(signal)] for signal in positions}
    first = {signal: np.array([value]) for signal, value in pose.items()}
    rested = simulate_batch(
        late, (), np.empty((1, 0)), time[:60], held[None, :60], first, resting=np.array([[True] * 2])
    )
    for signal in positions:
        seen = rested.values[0, 0, :, rested.signals.index(signal)]
        assert seen == pytest.approx(pose[signal], abs=1e-4), signal

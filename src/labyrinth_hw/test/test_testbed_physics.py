# SPDX-License-Identifier: Apache-2.0
"""What the emulated rig's physics must obey, whatever is hidden in it."""

import numpy as np
import pytest

from labyrinth_hw.testbed.ball import GRAVITY, Ball
from labyrinth_hw.testbed.hidden import EFFECTS, STRENGTHS, TestbedConfig, TestbedFile, build, draw, hide, load_testbed
from labyrinth_hw.testbed.offline import run_many, run_offline
from labyrinth_hw.testbed.plant import CONTROL_PERIOD, Plant
from labyrinth_hw.testbed.quantities import HEALTHY, Reality, stack
from labyrinth_hw.testbed.scene import Layout, load_layout

TIME = np.arange(0.0, 2.5, 0.01)
STEPS = np.radians(np.column_stack([2.5 * np.sign(np.sin(2.5 * TIME + 0.1)), 2.0 * np.sin(4 * TIME)]))
QUIET = HEALTHY.with_values({"viscous": 0.0, "board_viscous": 0.0, "torque_noise": 0.0, "idle_friction": 0.0})


def rig(content: dict) -> TestbedConfig:
    return build(TestbedFile.model_validate(content), "rig")


def plant(reality: Reality, start: tuple[float, float] = (0.0, 0.0)) -> Plant:
    return Plant(stack([reality]), np.array([start]))


def released(reality: Reality, board: float) -> Plant:
    """Servos without torque, the board pulled aside against its belt."""
    p = plant(reality)
    p.torque_on[:] = False
    p.board = p.board + board
    return p


def energy(p: Plant) -> float:
    """Mechanical energy of motion and belt stretch, J."""
    q = p.q
    beyond = q.ratio * p.servo - p.board
    beyond = beyond - np.clip(beyond, -p.belt.slack, p.belt.slack)
    motion = q.rotor_inertia * p.servo_speed**2 + q.board_inertia * p.board_speed**2
    return float(0.5 * (motion + q.belt_stiffness * beyond**2).sum())


def test_energy_never_grows_without_torque() -> None:
    p = released(QUIET.with_values({"coulomb": 0.02, "board_friction": 0.01, "play": 0.003, "ke": 0.0}), 0.03)
    energies = []
    for _ in range(300):
        p.advance(1)
        energies.append(energy(p))
    before = np.array(energies)
    assert before[0] > 1e-2
    # A symplectic step lets energy swing by a few per cent within a period of the belt; it must never drift upwards.
    assert before[100:].max() < before[:20].max()
    assert before[-1] < 0.2 * before[0]


def test_static_friction_holds_below_its_limit_and_yields_above() -> None:
    for torque, moves in ((0.09, False), (0.11, True)):
        p = plant(QUIET.with_values({"coulomb": 0.1}))
        p.torque_on[:] = False
        p.push = np.array([[torque, 0.0]])
        p.advance(500)
        assert (abs(p.servo[0, 0]) > 1e-3) == moves, torque
        assert p.servo[0, 1] == 0.0


def test_coulomb_friction_leaves_the_error_that_statics_predict() -> None:
    """At rest gain * error = friction at most; the servo stops where the loop's torque falls below it."""
    friction = 0.3
    p = plant(QUIET.with_values({"coulomb": friction}))
    p.command(np.array([[0.08, 0.0]]))
    p.advance(2500)
    left = 0.08 - p.servo[0, 0]
    stiffness = 20.0 * 2.0  # p * velocity_gain
    assert 0.5 * friction / stiffness < left <= 1.05 * friction / stiffness


def test_backlash_is_as_wide_as_told() -> None:
    width = 0.012
    # Slow enough for the board to rest against the belt instead of coasting through the play.
    p = plant(QUIET.with_values({"play": width, "board_friction": 0.02, "command_rate": 0.1}))
    gaps = []
    for goal in (0.06, 0.0, -0.06, 0.0):
        p.command(np.array([[goal, 0.0]]))
        p.advance(1200)
        gaps.append(float(p.board[0, 0] - p.servo[0, 0]))
    bent = 2 * 0.02 / 100.0  # the belt's stretch under the board's friction, both ways
    assert gaps[1] - gaps[3] == pytest.approx(width + bent, rel=0.02)


def test_a_healthy_servo_follows_the_speed_law() -> None:
    """J s^2 + G s + G P = 0: with P = 20/s, G = 2 N m s/rad and both inertias the slow root is -23.8/s, not -P."""
    lag = (1.0e-2 + 3.4e-3) / 2.0
    root = (1 - np.sqrt(1 - 4 * 20 * lag)) / (2 * lag)
    p = plant(QUIET)
    p.command(np.array([[0.04, 0.0]]))
    p.advance(100)
    first = 0.04 - p.servo[0, 0]
    p.advance(50)
    assert (0.04 - p.servo[0, 0]) / first == pytest.approx(np.exp(-root * 0.05), rel=0.03)


def test_the_motor_obeys_its_back_emf() -> None:
    """Without load or limit the duty servo runs at supply / ke."""
    free = QUIET.with_values(
        {"firmware": 1, "duty_gain": 1e4, "stop_angle": 1e9, "belt_stiffness": 0, "belt_damping": 0}
    )
    p = plant(free)
    p.command(np.array([[1e3, 0.0]]))
    p.advance(600)
    assert p.servo_speed[0, 0] == pytest.approx(12.0 / 1.75, rel=0.01)


def test_the_supply_gives_what_both_motors_draw() -> None:
    """At full duty the circuit says V = (V0 + r sum(ke w) / R) / (1 + 2 r / R); at once, and it never flutters."""
    r, winding, ke = 10.0, 2.9, 1.75
    p = plant(
        QUIET.with_values({"supply_resistance": r, "current_limit": 100.0, "rotor_inertia": 0.05, "command_delay": 0.0})
    )
    p.command(np.array([[0.12, 0.12]]))
    seen = []
    for _ in range(8):
        p.advance(1)
        circuit = (12.0 + r * ke * p.servo_speed[0].sum() / winding) / (1 + 2 * r / winding)
        if np.abs(p.firmware.duty).min() == 1.0:
            seen.append(float(p.motor.supply[0, 0]) / circuit)
    # At once: a motor that had the full voltage for a millisecond would be off to a flying start.
    assert len(seen) >= 6
    np.testing.assert_allclose(seen, 1.0, rtol=0.03)


def test_gravity_moves_the_board_to_the_statics_answer() -> None:
    p = plant(QUIET.with_values({"gravity_moment": 0.2}))
    p.advance(2000)
    sag = -0.2 / 100.0  # moment / belt stiffness
    assert p.board[0, 0] - p.servo[0, 0] == pytest.approx(sag, rel=0.05)


def test_paper_rig_misses_its_goal_on_x_more_than_on_y() -> None:
    goals = np.tile(np.radians([2.5, 2.5]), (len(TIME), 1)) * np.sign(TIME - 0.5)[:, None]
    run = run_offline(load_testbed("paper"), TIME, goals, 3, 1)
    error = np.abs(goals[-1] - run.motor[:, -50:].mean(axis=(0, 1)))
    assert error[0] > 2 * error[1]
    assert error[0] > np.radians(0.2)


ON_AXES = [name for name, entry in EFFECTS.items() if not entry.ball]


@pytest.fixture(scope="module")
def changes() -> dict[tuple[str, str], float]:
    """(effect, strength) -> by how much it changes what is measured, rad."""
    hidden = [(effect, strength) for effect in ON_AXES for strength in ("weak", "strong")]
    rigs = [rig({"hidden": [{"effect": e, "axis": "x", "strength": s}]}) for e, s in hidden]
    healthy, *runs = run_many([rig({}), *rigs], TIME, STEPS, 3, [5] * (1 + len(rigs)))
    both = [(np.abs(run.motor - healthy.motor), np.abs(run.board - healthy.board)) for run in runs]
    return {key: float(motor.max() + board.max()) for key, (motor, board) in zip(hidden, both, strict=True)}


@pytest.mark.parametrize("effect", ON_AXES)
def test_every_effect_changes_what_is_measured_and_more_when_stronger(
    effect: str, changes: dict[tuple[str, str], float]
) -> None:
    assert changes[effect, "strong"] > 1e-3
    assert changes[effect, "strong"] > changes[effect, "weak"]


def test_same_seed_same_answer_whatever_runs_beside_it() -> None:
    first, second = rig({}), rig({"hidden": [{"effect": "backlash", "axis": "y"}]})
    alone = run_offline(second, TIME, STEPS, 2, 9)
    beside = run_many([first, second, first], TIME, STEPS, 2, [1, 9, 3])[1]
    again = run_offline(second, TIME, STEPS, 2, 10)
    for name in ("stamps", "motor", "motor_speed", "effort", "board"):
        assert np.array_equal(getattr(alone, name), getattr(beside, name)), name
    assert not np.array_equal(alone.motor, again.motor)


def test_trials_differ_by_noise_only() -> None:
    run = run_offline(rig({}), TIME, STEPS, 6, 2)
    assert 1e-4 < run.motor.std(axis=0).mean() < 1.5e-3
    assert 1e-4 < run.board.std(axis=0).mean() < 1e-3


def test_drawing_is_fixed_by_its_seed_and_reaches_everything() -> None:
    assert draw(3) == draw(3)
    names = {draw(seed, known=None, ball=True).effect for seed in range(600)}
    assert names == set(EFFECTS)
    assert {draw(seed).strength for seed in range(30)} == set(STRENGTHS)


def test_factors_and_signs_of_hidden_effects() -> None:
    assert hide("gain_error", "x", "weak", sign=-1).values == {"command_gain": 0.98}
    assert hide("sensor_bias", "board_y", "weak").values == {"pot_bias": 0.0015}
    assert hide("sensor_bias", "y", "weak").name == "sensor_bias.motor_y"


OPEN = Layout(board=(2.0, 2.0), walls=(), holes=(), path=((0.2, 1.0),))


def roll(layout: Layout, tilt: tuple[float, float], seconds: float, **quantities: float) -> Ball:
    q = stack([HEALTHY.with_values({"rolling_friction": 0.0, **quantities})])
    ball = Ball(q, layout, np.array([layout.path[0]]))
    for _ in range(round(seconds / CONTROL_PERIOD)):
        ball.step(np.array([tilt]), CONTROL_PERIOD)
    return ball


def test_the_ball_accelerates_with_five_sevenths_of_gravity() -> None:
    tilt = np.radians(3.0)
    ball = roll(OPEN, (0.0, tilt), 1.0)
    assert ball.speed[0, 0] == pytest.approx(5 / 7 * GRAVITY * np.sin(tilt), rel=1e-3)
    assert ball.speed[0, 1] == 0.0
    assert roll(OPEN, (tilt, 0.0), 0.5).speed[0, 1] < 0


def test_rolling_resistance_holds_the_ball_below_its_angle() -> None:
    assert roll(OPEN, (0.0, 0.009), 1.0, rolling_friction=0.01).position[0, 0] == 0.2
    assert roll(OPEN, (0.0, 0.011), 1.0, rolling_friction=0.01).position[0, 0] > 0.2


def test_the_ball_bounces_with_the_restitution_told() -> None:
    wall = Layout(board=(2.0, 2.0), walls=((0.5, 0.0, 0.51, 2.0),), holes=(), path=((0.4, 1.0),))
    ball = roll(wall, (0.0, 0.0), 0.0, restitution=0.6)
    ball.speed[0] = (0.3, 0.1)
    for _ in range(600):
        ball.step(np.zeros((1, 2)), CONTROL_PERIOD)
    assert ball.speed[0] == pytest.approx([-0.18, 0.1], rel=1e-6)


def test_the_ball_never_passes_a_wall_under_violent_tilting() -> None:
    """Forty balls, ten seconds each; without holes none leaves the board or enters a wall."""
    layout = load_layout("medium")
    layout = Layout(layout.board, layout.walls, (), layout.path)
    rng = np.random.default_rng(4)
    ball = Ball(stack([HEALTHY], 40), layout, np.tile(np.array(layout.path[0]), (40, 1)))
    boxes = np.array(layout.walls)
    for k in range(10_000):
        if k % 150 == 0:
            tilt = rng.uniform(-0.14, 0.14, (40, 2))
        ball.step(tilt, CONTROL_PERIOD)
        if k % 10 == 0:
            near = np.clip(ball.position[:, None], boxes[:, :2], boxes[:, 2:])
            assert np.linalg.norm(ball.position[:, None] - near, axis=2).min() > 0.6 * layout.ball_radius
    assert ball.position.min() > 0 and (ball.position < np.array(layout.board)).all()
    assert np.ptp(ball.position, axis=0).min() > 0.03


def test_the_ball_falls_into_a_hole_and_the_hole_is_told() -> None:
    hole = Layout(board=(1.0, 1.0), walls=(), holes=((0.9, 0.1), (0.5, 0.5)), path=((0.3, 0.5),))
    ball = roll(hole, (0.0, 0.05), 2.0)
    assert ball.lost[0] and ball.hole[0] == 2

# SPDX-License-Identifier: Apache-2.0
"""Effects on the ball against the equations that their files state, on a table that stands still where it is put."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from small_rigs import CENTRE, RADIUS, WALL, G, checks, play

from labyrinth_sim.model import Model

ROLLING = 5 / 7  # of gravity's pull that a rolling solid ball keeps
TIME = np.linspace(0.0, 0.3, 61)
ModelOf = Callable[..., Model]


def rolled(model: Model, a: float = 0.0, b: float = 0.0, x: float = 0.25, y: float = 0.2) -> dict[str, np.ndarray]:
    """Ball from rest for 0.3 s on a table turned by a and b."""
    return play(model, TIME, a=a, b=b, ball_x=x, ball_y=y)


def test_a_ball_on_the_table_rolls_as_a_ball_does(model_of: ModelOf) -> None:
    found = rolled(model_of("table"), b=0.03)
    assert found["ball_x"] == pytest.approx(0.25 + ROLLING * G * math.sin(0.03) * TIME**2 / 2, abs=1e-4)
    assert rolled(model_of("table"), a=0.03)["ball_y"][-1] == pytest.approx(
        0.2 - ROLLING * G * math.sin(0.03) * 0.3**2 / 2, abs=1e-4
    )


@checks("board_not_level", "gravity' = gravity turned by -angle about the axis")
@pytest.mark.parametrize("angle", [0.03, -0.02])
def test_board_not_level(model_of: ModelOf, angle: float) -> None:
    """The level ball feels what it would on a table turned by the angle."""
    way = ROLLING * G * math.sin(angle) * TIME**2 / 2
    x = rolled(model_of("table").with_effect("board_not_level", "b", {"angle": angle}))
    assert (x["ball_x"], x["ball_y"]) == (pytest.approx(0.25 + way, abs=1e-4), pytest.approx(0.2, abs=1e-4))
    y = rolled(model_of("table").with_effect("board_not_level", "a", {"angle": angle}))
    assert (y["ball_x"], y["ball_y"]) == (pytest.approx(0.25, abs=1e-4), pytest.approx(0.2 - way, abs=1e-4))


@checks("rolling_friction", "torque <= c r times the force on the contact, against the spin; the ball slows by c g 5/7")
@pytest.mark.parametrize("tilt", [0.03, -0.03])
def test_rolling_friction(model_of: ModelOf, tilt: float) -> None:
    rolls = model_of("table").with_effect("rolling_friction", "ball", {"coefficient": 0.02})
    time = np.linspace(0.0, 0.5, 101)
    x = play(rolls, time, b=math.copysign(0.05, tilt), ball_x=CENTRE[0], ball_y=CENTRE[1])["ball_x"]
    late = time > 0.2  # MuJoCo's grows to its full size with the speed
    found = 2 * np.polyfit(time[late], x[late], 2)[0]
    assert found * tilt > 0
    assert ROLLING * G * math.sin(0.05) - abs(found) == pytest.approx(ROLLING * G * 0.02, rel=0.02)
    rests = model_of("table").with_effect("rolling_friction", "ball", {"coefficient": 0.05})
    assert rolled(rests, b=tilt)["ball_x"] == pytest.approx(0.25, abs=4e-4)  # it would roll 9.5 mm


@checks(
    "restitution", "speed after = -max(e, 0.135) speed before, across the contact, before the ball's spin brakes it"
)
@pytest.mark.parametrize("e", [0.0, 0.2, 0.3, 0.5, 0.8])
def test_restitution(model_of: ModelOf, e: float) -> None:
    """A ball that slides without friction, so that it has no spin, meets the wall."""
    model = model_of("slippery").with_effect("restitution", "ball", {"coefficient": e})
    time = np.arange(401) * 0.001
    x = play(model, time, timestep=1e-4, b=0.05, ball_x=WALL - RADIUS - 0.01, ball_y=0.2)["ball_x"]
    speed = np.diff(x) / 0.001
    arrives = int(speed.argmax())
    leaves = arrives + int(speed[arrives : arrives + 40].argmin())
    assert speed[arrives] == pytest.approx(math.sqrt(2 * G * math.sin(0.05) * 0.01), rel=0.02)
    assert speed[leaves] == pytest.approx(-max(e, 0.135) * speed[arrives], rel=0.03)


@checks("camera_latency", "ball'(t) = ball(t - T)")
@pytest.mark.parametrize("delay", [0.05, 0.033])
def test_camera_latency(model_of: ModelOf, delay: float) -> None:
    model = model_of("table").with_effect("camera_latency", "ball", {"delay": delay})
    late = np.maximum(TIME - delay, 0.0)
    expected = 0.25 + ROLLING * G * math.sin(0.05) * late**2 / 2
    assert rolled(model, b=0.05)["ball_x"] == pytest.approx(expected, abs=1e-4)


@checks("camera_scale", "ball' = c + s (ball - c), c being the board's centre")
@pytest.mark.parametrize("scale", [1.1, 0.9])
def test_camera_scale(model_of: ModelOf, scale: float) -> None:
    model = model_of("table").with_effect("camera_scale", "ball", {"scale": scale})
    way = ROLLING * G * math.sin(0.03) * TIME**2 / 2
    assert rolled(model, b=0.03)["ball_x"] == pytest.approx(0.25 + scale * way, abs=1e-4)  # starts where it is seen
    rests = play(model, TIME)  # at -0.1, 0.05 from the centre
    expected = CENTRE[0] - 0.1 * scale, CENTRE[1] + 0.05 * scale
    assert (rests["ball_x"][-1], rests["ball_y"][-1]) == pytest.approx(expected, abs=1e-4)

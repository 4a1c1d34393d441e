# SPDX-License-Identifier: Apache-2.0
"""How long one control cycle occupies the bus: bytes on the wire at ten bits each, half duplex."""

from labyrinth_hw.errors import InputError
from labyrinth_hw.registers import ServoModel

BLOCKS = (
    ("present_position", "present_speed", "effort", "present_voltage", "present_temperature"),
    ("present_position", "present_speed", "effort"),
    ("present_position", "present_speed"),
    ("present_position",),
)


def block(model: ServoModel, what: tuple[str, ...]) -> tuple[int, int]:
    """First address and length of the smallest contiguous block that holds these registers."""
    names = [model.effort_register if name == "effort" else name for name in what]
    registers = [model.register(name) for name in names]
    start = min(r.address for r in registers)
    return start, max(r.address + r.size for r in registers) - start


def bytes_per_cycle(models: list[ServoModel], what: tuple[str, ...]) -> int:
    """Bytes on the wire to read `what` from every servo and to write every goal position in one packet."""
    lengths = [block(model, what)[1] for model in models]
    goal = models[0].register("goal_position").size
    if models[0].protocol == 1:
        grouped = len(models) > 1 and all(m.bulk_read for m in models) and len({m.name for m in models}) == 1
        request = 7 + 3 * len(models) if grouped else 8 * len(models)
        return request + sum(6 + n for n in lengths) + 8 + len(models) * (goal + 1)
    grouped = len(models) > 1 and len({m.name for m in models}) == 1
    request = 14 + len(models) if grouped else 14 * len(models)
    return request + sum(11 + n for n in lengths) + 14 + len(models) * (goal + 1)


def cycle_time(models: list[ServoModel], baud: int, period: float, share: float = 0.9) -> tuple[tuple[str, ...], float]:
    """The largest block of state that fits into a share of the period, and the seconds its cycle takes.

    Raises:
        InputError: not even positions fit; tells the least baud rate.
    """
    for what in BLOCKS:
        seconds = 10 * bytes_per_cycle(models, what) / baud
        if seconds <= share * period:
            return what, seconds
    count = bytes_per_cycle(models, BLOCKS[-1])
    raise InputError(
        f"{len(models)} servos need {count} bytes a cycle, {10 * count / baud * 1e3:.1f} ms at {baud} baud, more than "
        f"{share:.0%} of the period of {period * 1e3:g} ms. Use at least {10 * count / (share * period):.0f} baud."
    )

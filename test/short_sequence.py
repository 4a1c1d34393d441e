# SPDX-License-Identifier: Apache-2.0
"""The sequence files that the tests of the loop play: short, and yet they excite what is looked for."""

SHORT = """
description: Two seconds on one axis.
initial_deg: {motor_x: 0, motor_y: 0}
command:
  motor_x:
    - hold: {lasts_s: 0.1}
    - step: {to_deg: 3, lasts_s: 0.4}
    - step: {to_deg: -3, lasts_s: 0.4}
    - ramp: {to_deg: 1, lasts_s: 0.4}
    - triangle: {amplitude_deg: 1.5, frequency_hz: 1.25, lasts_s: 0.8}
    - step: {to_deg: 0, lasts_s: 0.3}
  motor_y:
    - hold: {lasts_s: 2.4}
"""

# For the tests against real time, which look for one strong effect.
SHORTER = """
description: Two seconds on one axis.
initial_deg: {motor_x: 0, motor_y: 0}
command:
  motor_x: [{hold: {lasts_s: 0.2}}, {step: {to_deg: 3, lasts_s: 0.6}}, {ramp: {to_deg: -3, lasts_s: 1.2}}]
  motor_y: [{hold: {lasts_s: 2.0}}]
"""

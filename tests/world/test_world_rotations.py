"""Rotations as roll, pitch and yaw."""

from __future__ import annotations

from math import pi

import pytest

from deepbots_cli import frames

ANGLES = (-2.9, -0.4, 0.0, 1.3, 3.0)


@pytest.mark.parametrize("pitch", [-pi / 2, pi / 2])
@pytest.mark.parametrize("noise", [0.0, 1e-12, -1e-12])
def test_a_vertical_pitch_keeps_the_rotation(pitch: float, noise: float) -> None:
    """Only the difference of roll and yaw counts there, and the roll is 0."""
    for roll in ANGLES:
        for yaw in ANGLES:
            turned = frames.quaternion(roll, pitch + noise, yaw)
            angles = frames.roll_pitch_yaw(turned)
            assert angles[:2] == (0.0, pitch)
            again = frames.quaternion(*angles)
            assert abs(sum(map(float.__mul__, turned, again))) == pytest.approx(1.0, abs=1e-9)


def test_other_angles_come_back() -> None:
    for roll in ANGLES:
        for pitch in (-1.57, -0.3, 0.0, 1.2, 1.57):
            for yaw in ANGLES:
                angles = frames.roll_pitch_yaw(frames.quaternion(roll, pitch, yaw))
                assert angles == pytest.approx((roll, pitch, yaw), abs=1e-9)

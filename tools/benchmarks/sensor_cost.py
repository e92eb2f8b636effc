"""What each sensor adds to a step of an environment.

    python -m tools.benchmarks.sensor_cost [--json] [--pairs 9] [--steps 1000]

A rover drives in an arena and sends one joint velocity, with and without the sensor in question: the
difference is the reading, what it does in the substeps, and its place in the message (struct). Both worlds
make the same motion; the two sides take turns, and the median of the differences of the pairs counts. Times
are CPU times.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tools.benchmarks.report import Row, difference, options, pairs, show
from tools.benchmarks.step_cost import opened, plan, whole

SCENARIO = """
deepbots: 1
name: SensorCost
world: {{timestep: 32 ms, substeps: 4, ground: {{}}, arena: {{size: 2 2 m, wall_height: 0.2 m}}}}
robots:
  rover:
    urdf: rover
    sensors:
      plain: {{type: joint_velocity, joint: left_wheel}}
      {sensor}
    actuators: {{wheels: {{type: velocity_motor, joints: ["*_wheel"]}}}}
    emit: [plain{sent}]
    apply: {{wheels: drive * 2 rad/s}}
messages: {{format: struct}}
action: {{drive: {{choices: {{forward: 1, backward: -1}}}}}}
observation: {{rover.plain: -10 .. 10 rad/s}}
reward: {{alive: 1}}
truncation: {{max_steps: 100}}
reset: {{place: {{rover: {{z: 0.04 m}}}}}}
"""
HERE = "link: base_link, pose: {x: 10 cm, z: 10 cm}"
LOOKUP = (
    "{distance: 0 5 10 15 20 30 40 50 60 70 mm, value: 4095 2133 1466 601 384 235 158 120 104 67,"
    " noise: 0.2 0.3 0.7 4 1.5 2.4 2.9 4.2 3.1 4.9 %}"
)
SENSORS = (
    ("joint position", "{type: joint_position, joint: left_wheel}"),
    (
        "joint position with noise, bias and latency",
        "{type: joint_position, joint: left_wheel, noise: 1 deg, bias: 1 deg, latency: 64 ms}",
    ),
    ("position", f"{{type: position, {HERE}}}"),
    ("velocity", f"{{type: velocity, {HERE}}}"),
    ("orientation", f"{{type: orientation, {HERE}}}"),
    ("compass", f"{{type: compass, {HERE}}}"),
    ("gyro", f"{{type: gyro, {HERE}}}"),
    ("accelerometer", f"{{type: accelerometer, {HERE}}}"),
    ("inclinometer", f"{{type: projected_gravity, {HERE}}}"),
    ("touch, two links", "{type: touch, links: [bumper_left, bumper_right]}"),
    ("force, one link", "{type: force, link: bumper_left}"),
    ("laser, one ray", f"{{type: laser, {HERE}, range: 0 .. 1 m}}"),
    ("sonar, 13 rays", f"{{type: sonar, {HERE}, rays: 13, angle_range: 90 .. -90 deg, range: 0 .. 1 m}}"),
    (
        "infrared, 8 rays with look-up and noise",
        f"{{type: infrared, {HERE}, rays: 8, angle_range: 90 .. -90 deg, lookup: {LOOKUP}}}",
    ),
    ("lidar, 180 rays", f"{{type: lidar, {HERE}, rays: 180, angle_range: 90 .. -90 deg, range: 0 .. 3 m}}"),
    ("reflectance, 5 rays", f"{{type: reflectance, {HERE}, rays: 5, angle_range: 20 .. -20 deg}}"),
    ("camera, 84 x 84 rgb", f"{{type: camera, {HERE}, resolution: 84 84}}"),
)


def cost(folder: Path, what: str, sensor: str, steps: int, count: int) -> Row:
    texts = (
        SCENARIO.format(sensor=f"tested: {sensor}", sent=", tested"),
        SCENARIO.format(sensor="", sent=""),
    )
    files = [folder / name for name in ("with.yaml", "without.yaml")]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text, encoding="utf-8")
    with opened(str(files[0])) as tested, opened(str(files[1])) as bare:
        episodes = plan(bare, steps, 0)
        return Row(what, difference(pairs(whole(tested, episodes), whole(bare, episodes), count)), "us")


def main() -> None:
    arguments = options(__doc__, pairs=9, steps=1000)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pyproject.toml").touch()
        rows = [cost(Path(folder), *entry, arguments.steps, arguments.pairs) for entry in SENSORS]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()

"""A task for what has rotors: fly to a point and stay there."""

from __future__ import annotations

from deepbots_cli.cli.starters.draft import Draft, figure, listed, word
from deepbots_cli.cli.starters.parts import GRAVITY, Robot, train
from deepbots_cli.cli.starters.survey import Survey


def hover(survey: Survey, robot: Robot) -> Draft:
    """At a height of one metre."""
    draft = Draft("A body with rotors flies to a point and stays there.")
    each = survey.mass * GRAVITY / len(survey.rotors)
    draft.remarks.append(
        "A robot file says nothing of how air turns a rotor's body: to steer about the upright axis, give `drag` and `spin`, "
        "and observe `robot.gyro` as a whole."
    )
    draft.add(
        "parameters", "home: 0 0 1 m", f"hover: {figure(each)} N    # per rotor, against its weight", f"gain:  {figure(0.3 * each)} N"
    )
    draft.add("world", "timestep: 10 ms", "substeps: 4")
    mark = figure(max(0.1 * survey.size, 0.01))
    draft.add("objects", f"mark: {{shape: sphere, radius: {mark} m, solid: false, fixed: true, colour: red, pose: {{xyz: home}}}}")
    chassis = word(survey.chassis)
    robot.add("groups", *listed("rotors", survey.rotors))
    robot.add("sensors", f"gyro: {{type: gyro, link: {chassis}}}", f"down: {{type: inclinometer, link: {chassis}}}")
    robot.add("actuators", f"rotors: {{type: thrust, links: rotors, range: 0 .. {figure(2.0 * each)} N}}")
    robot.add("emit", "[gyro, down]")
    robot.add("apply", "rotors: hover + gain * push")
    draft.add("action", "push: {range: -1 .. 1, each: robot.rotors}")
    draft.add("augment", "error: local(robot, home - position(robot))", "v: local(robot, velocity(robot))")
    draft.add("observation", "error: -2 .. 2 m", "v: -3 .. 3 m/s", "robot.down: -1 .. 1", "robot.gyro.xy: -10 .. 10 rad/s")
    draft.add("signals", "away: norm(error)")
    draft.add("reward", "near:   exp(-away / (0.3 m))", "effort: -0.01 * mean(push^2)")
    draft.add("termination", "failure:", "  lost:    away > 1.5 m", "  flipped: tilt(robot) > 100 deg", "  crashed: contact(robot, ground)")
    draft.add("truncation", "max_time: 8 s")
    robot.into(draft, {"xyz": "uniform(-0.3 -0.3 0.8 .. 0.3 0.3 1.2 m)", "yaw": "any"})
    train(draft, "PPO", 400_000, 64)
    return draft

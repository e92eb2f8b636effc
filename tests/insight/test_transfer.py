"""Two worlds of a policy: what differs, the changes that explain it, and the gate.

The log of a robot beside the simulation.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.robot_log import compare_log, distance, logged_episodes
from deepbots_cli.learning import policy, train
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout import Episode, recordings
from deepbots_cli.rollout.recordings import RobotLog
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.replay import open_player

pytest.importorskip("onnxruntime")

import yaml

from deepbots_cli.insight.recorded_worlds import EngineWorld
from deepbots_cli.insight.transfer import (
    Gate,
    Transfer,
    WorldComparison,
    compare_worlds,
    transfer,
    world_names,
    worlds_that_work,
)
from deepbots_cli.learning.robustness import base_document, changed_scenario
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout.source import Source
from tests.commands import Deepbots
from tests.few import few
from tests.files import written
from tests.insight.logs import train_shuttle

BRIEF = (
    "train={algorithm: PPO, total_timesteps: 128, environments: 2, n_steps: 64, batch_size: 64, network:"
    " {hidden: [16]}}"
)


@pytest.fixture(scope="module")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A run of a shipped scenario whose policy has learned nothing yet: its actions move the robot."""

    @cache
    def of(name: str) -> Run:
        folder = tmp_path_factory.mktemp("runs") / name
        changes = [BRIEF, "evaluation.episodes=2", "world.engine=mujoco"]
        train(api.compile(name, overrides=changes), run=folder, seed=3)
        return Run.open(folder)

    return of


def compared(
    run: Run,
    change: dict[str, Any],
    episodes: int = 6,
    outcomes: Sequence[tuple[Episode, Episode]] = (),
) -> WorldComparison:
    source = Source.kept(run.path)
    document = base_document(source)
    here = EngineWorld(api.compile(source.checked()).program, run.record.engine)
    there = EngineWorld(changed_scenario(document, change).program, run.record.engine)
    return compare_worlds(run, here, there, document, seed=0, episodes=episodes, outcomes=outcomes)


def cart(change: str) -> str:
    return f"robots: {{cart: {{{change}}}}}"


def bot(change: str) -> str:
    return f"robots: {{bot: {{{change}}}}}"


def rover(change: str) -> str:
    return f"robots: {{rover: {{{change}}}}}"


def arm(change: str) -> str:
    return f"robots: {{panda: {{{change}}}}}"


HALF_TORQUE = "the action push x 0.5|motor strength x 0.5"
"""Of a motor that gives a torque, half the action and half the strength are the same."""
ERRORS = {
    "late sensor of a cart": (
        "cartpole",
        cart("sensors: {pole_angle: {latency: 64 ms}}"),
        r"pole_angle is 2 steps late|latency of the sensor cart.pole_angle \+64 ms",
    ),
    "bias of a sensor": (
        "cartpole",
        cart("emit: {pole_angle: pole_angle + 2 deg}"),
        "cart.pole_angle is larger by 0.0349 rad",
    ),
    "lag of a motor": (
        "cartpole",
        cart("actuators: {wheels: {time_constant: 64 ms}}"),
        r"time constant of cart.wheels \+64 ms",
    ),
    "heavy pole": ("cartpole", cart("links: {pole: {mass: 2 * urdf}}"), "mass of cart.pole x 2"),
    "halved gain of a choice": (
        "cartpole",
        cart("apply: {wheels: 0.5 * drive * wheel_speed}"),
        r"command of cart.wheels x 0.5",
    ),
    "bias of a gyro": (
        "balancer",
        bot("emit: {rate: gyro.y + 0.3 rad/s}"),
        "bot.rate is larger by 0.3 rad/s",
    ),
    "lag of motors": (
        "balancer",
        bot("actuators: {wheels: {time_constant: 20 ms}}"),
        r"time constant of bot.wheels \+20 ms",
    ),
    "halved gain of an action": ("balancer", bot("apply: {wheels: 0.5 * push * top_torque}"), HALF_TORQUE),
    "late ground sensor": (
        "line_follower",
        rover("sensors: {ground: {latency: 64 ms}}"),
        r"are 2 steps late|latency of the sensor rover.ground \+64 ms",
    ),
    "bias of a ground sensor": (
        "line_follower",
        rover("emit: {ground: ground - 0.1}"),
        "rover.ground.left is larger by -0.1; ",
    ),
    "sign of a side": (
        "line_follower",
        rover("emit: {side: 'hold(ground.left - ground.right, abs(ground.right - ground.left) > 0.3)'}"),
        "rover.side has the other sign",
    ),
    "lag of both wheels": (
        "line_follower",
        rover("actuators: {left_wheel: {time_constant: 64 ms}, right_wheel: {time_constant: 64 ms}}"),
        r"time constant of all actuators \+64 ms",
    ),
    "heavy rover": (
        "line_follower",
        rover("links: {base_link: {mass: 2 * urdf}}"),
        "mass of rover.base_link x 2",
    ),
    "halved gain of turns": (
        "line_follower",
        rover(
            "apply: {left_wheel: 'clamp(gas - 0.5 * turn, -1 .. 1) * top_speed', "
            "right_wheel: 'clamp(gas + 0.5 * turn, -1 .. 1) * top_speed'}"
        ),
        "the action turn x 0.5",
    ),
    "sign of a sensor": (
        "cartpole",
        cart("emit: {pole_angle: -1 * pole_angle}"),
        "cart.pole_angle has the other sign",
    ),
    "unit of a sensor": (
        "cartpole",
        cart("emit: {pole_angle: 57.29578 * pole_angle}"),
        "cart.pole_angle is in degrees",
    ),
    "late messages from the robot": (
        "cartpole",
        "messages: {from_robot: {latency: 64 ms}}",
        "pole_angle is 2 steps late",
    ),
    "late messages to the robot": (
        "cartpole",
        "messages: {to_robot: {latency: 64 ms}}",
        r"latency to the robot \+64 ms",
    ),
    "friction": ("cartpole", "world: {ground: {friction: 0.5}}", "friction of the ground x 0.5"),
    "sign of a motor": (
        "cartpole",
        cart("apply: {wheels: -1 * drive * wheel_speed}"),
        "forward and backward are swapped",
    ),
    "sign of a gyro": (
        "balancer",
        "robots: {bot: {emit: {rate: -1 * gyro.y}}}",
        "bot.rate has the other sign",
    ),
    "weak motors": (
        "balancer",
        "robots: {bot: {actuators: {wheels: {strength: 0.5 * uniform(0.9 .. 1.1)}}}}",
        HALF_TORQUE,
    ),
    "mass of a body": (
        "balancer",
        "robots: {bot: {links: {body: {mass: 1.5 * urdf}}}}",
        "mass of bot.body x 1.5",
    ),
    "late sensor": (
        "balancer",
        "robots: {bot: {sensors: {gyro: {latency: 20 ms}}}}",
        "late|latency of the sensor bot.gyro 20 ms",
    ),
    "order of rotors": (
        "quadrotor",
        "robots: {drone: {actuators: {rotors: {links: [prop_fr, prop_fl, prop_rl, prop_rr]}}}}",
        "actions push.prop_fl and push.prop_fr are swapped",
    ),
    "order of axes": (
        "quadrotor",
        'robots: {drone: {emit: {gyro: "vector(gyro.y, gyro.x, gyro.z)", down: down}}}',
        "drone.gyro.x has the value of drone.gyro.y; drone.gyro.y has the value of drone.gyro.x",
    ),
    "payload": (
        "quadrotor",
        "robots: {drone: {links: {base_link: {mass: 1.25 * urdf}}}}",
        "mass of drone.base_link x 1.25",
    ),
    "slippery ground": ("quadruped", "world: {ground: {friction: 0.5}}", "friction of the ground x 0.5"),
    "mass of a trunk": (
        "quadruped",
        'robots: {dog: {links: {trunk: {mass: "1.5 * urdf * uniform(0.9 .. 1.1)"}}}}',
        "mass of dog.trunk x 1.5",
    ),
    "late joints": (
        "quadruped",
        "robots: {dog: {sensors: {q: {latency: 40 ms}}}}",
        "are 2 steps late|latency of the sensor dog.q 40 ms",
    ),
    "sign of three axes": (
        "quadruped",
        "robots: {dog: {emit: {gyro: -1 * gyro}}}",
        "dog.gyro.x has the other sign; dog.gyro.y",
    ),
    "sides of a sensor": (
        "line_follower",
        "robots: {rover: {sensors: {ground: {rays: {left: {y: -12 mm}, right: {y: 12 mm}}}}}}",
        "rover.ground.left has the value of rover.ground.right",
    ),
    "sides of motors": (
        "line_follower",
        "robots: {rover: {apply: {left_wheel: 'clamp(gas + turn, -1 .. 1) * top_speed', "
        "right_wheel: 'clamp(gas - turn, -1 .. 1) * top_speed'}}}",
        "the action turn has the other sign",
    ),
    "amount between levels: mass": (
        "balancer",
        bot("links: {body: {mass: 1.7 * urdf}}"),
        "mass of bot.body x 1.7",
    ),
    "amount beyond doubling: mass": (
        "balancer",
        bot("links: {body: {mass: 4 * urdf}}"),
        "mass of bot.body x 4",
    ),
    "amount between levels: lag": (
        "balancer",
        bot("actuators: {wheels: {time_constant: 55 ms}}"),
        r"time constant of bot.wheels \+55 ms",
    ),
    "long lag": (
        "balancer",
        bot("actuators: {wheels: {time_constant: 80 ms}}"),
        r"time constant of bot.wheels \+80 ms",
    ),
    "delay of motors": (
        "balancer",
        bot("actuators: {wheels: {delay: 90 ms}}"),
        r"delay of bot.wheels \+90 ms",
    ),
    "delay of a vector of motors": (
        "panda_reach",
        arm("actuators: {motors: {delay: 160 ms}}"),
        r"delay of panda.motors \+160 ms",
    ),
    "gain of 0.4": (
        "cartpole",
        cart("apply: {wheels: 0.4 * drive * wheel_speed}"),
        "command of cart.wheels x 0.4",
    ),
    "gain of 0.7": ("balancer", bot("apply: {wheels: 0.7 * push * top_torque}"), "the action push x 0.7"),
    "gain of a vector": (
        "panda_reach",
        arm("apply: {motors: joints + 0.3 * stride * turn}"),
        "the action turn x 0.3",
    ),
    "sign of a vector action": (
        "panda_reach",
        arm("apply: {motors: joints - stride * turn}"),
        "the action turn has the other sign",
    ),
    "slippery track": ("cartpole", "world: {ground: {friction: 0.1}}", "friction of the ground x 0.1"),
    "ice": ("cartpole", "world: {ground: {friction: 0.05}}", "friction of the ground x 0.05"),
    "a small share of the torque": (
        "cartpole",
        cart("actuators: {wheels: {max_torque: 0.02 N*m}}"),
        r"motor strength x 0.002 or torque limit of cart.wheels 0.02 N\*m",
    ),
    "torque limit": (
        "balancer",
        bot("actuators: {wheels: {max_torque: 0.0015 N*m}}"),
        r"torque limit of bot.wheels 0.0015 N\*m",
    ),
    "sensor late by a part of a timestep": (
        "cartpole",
        cart("sensors: {pole_angle: {latency: 70 ms}}"),
        r"pole_angle is 3 steps late or latency from the robot \+96 ms or latency of the sensor"
        r" cart.pole_angle \+96 ms",
    ),
    "late sensor between levels": (
        "balancer",
        bot("sensors: {gyro: {latency: 60 ms}}"),
        r"latency of the sensor bot.gyro \+60 ms",
    ),
    "offset of a sensor": (
        "cartpole",
        cart("emit: {pole_angle: pole_angle + 0.7 deg}"),
        "cart.pole_angle is larger by 0.0122 rad",
    ),
}
"""Errors of a world: the scenario, its change, and what must be named first."""
FEW = ["amount between levels: mass"]


@pytest.mark.parametrize("error", few(list(ERRORS), FEW))
def test_an_error_is_named_first(run_of: Any, error: str) -> None:
    name, change, expected = ERRORS[error]
    report = compared(run_of(name), yaml.safe_load(change))
    assert report.differences
    assert report.causes, report.differences
    assert re.search(expected, report.causes[0].text), report.causes[:3]


@pytest.mark.parametrize("change", [{}, {"reward": {"upright": 0.1}}])
def test_the_same_world_differs_in_nothing_nor_does_one_with_another_reward(
    run_of: Any, change: dict[str, Any]
) -> None:
    report = compared(run_of("cartpole"), change, episodes=2)
    assert (report.differences, report.causes) == ((), ())


@pytest.mark.slow
def test_the_command_compares_engines_and_is_a_gate(run_of: Any, deepbots: Deepbots) -> None:
    path = str(run_of("cartpole").path)
    output = deepbots("transfer", path, "--quick", "--episodes", "2", "--min-return", "200", code=1).out
    score = r"\S+ \(95 %: \S+ \.\. \S+\)"
    assert re.match(
        rf"works neither in mujoco nor in pybullet: mean return {score} and {score}, judged by 2 episodes\n",
        output,
    )
    assert "CartPole in mujoco and in pybullet, 2 held-out starts" in output
    assert "failed: mujoco: mean return" in output
    assert "the changes are alternatives" in output
    assert (
        "was trained in mujoco; name the other engine"
        in deepbots("transfer", path, "--quick", "--engine", "mujoco", code=2).err
    )


@pytest.mark.slow
def test_a_value_of_the_other_world_can_be_set_and_a_piped_output_has_no_progress(
    run_of: Any, deepbots: Deepbots
) -> None:
    path = str(run_of("cartpole").path)
    words = [
        "--set",
        "robots.cart.emit={pole_angle: 'clamp(pole_angle, -0.05 .. 0.05 rad)'}",
        "--quick",
        "--episodes",
        "2",
        "--min-return",
        "1",
        "--json",
    ]
    output = deepbots("transfer", path, *words)
    (report,) = json.loads(output.out)
    assert [world["name"] for world in report["worlds"]] == ["training", "other"]
    (only,) = report["differences"]
    assert only["name"] == "cart.pole_angle"
    assert only["step"] > 1  # where the values part
    assert abs(only["here"]) > 0.05 == pytest.approx(abs(only["there"]))
    assert report["causes"][0]["text"].startswith("cart.pole_angle is multiplied by ")
    assert report["passed"] is True
    assert "\r" not in output.err


@pytest.mark.slow
def test_an_engine_that_is_set_is_the_engine_of_the_other_world(run_of: Any, deepbots: Deepbots) -> None:
    path = str(run_of("cartpole").path)
    words = "--set", "world.engine=pybullet", "--quick", "--episodes", "2"
    assert "training in mujoco and other in pybullet" in deepbots("transfer", path, *words).out


def patient(folder: Path) -> list[str]:
    """The words of a transfer of a carriage that waits until step 104, and succeeds in step 121 if it is near
    its start."""
    run = train_shuttle(
        folder,
        "robots.shuttle.receive={go: 0.05 m/s if time > 5.2 s else 0 m/s}",
        "robots.shuttle.apply={motor: go + 0 * drive * speed}",
        "termination.success={stays: time > 6 s and abs(shuttle.place) < 0.1 m}",
        "reward.parked=1 when stays",
        "truncation.max_steps=160",
    )
    return ["transfer", str(run), "--quick", "--episodes", "4", "--set"]


@pytest.mark.slow
def test_a_cause_after_the_first_hundred_steps_is_found_and_judged_by_its_effect_on_success(
    tmp_path: Path, deepbots: Deepbots
) -> None:
    """`x 8` makes it leave too early."""
    output = deepbots(*patient(tmp_path), "robots.shuttle.apply={motor: 8 * (go + 0 * drive * speed)}").out
    assert "4 of 4 episodes end in another way in other; before this, in steps 72 to 121" in output
    assert re.search(r"share of steps with abs\(shuttle.place\) < 0.1 m +1.00 +0.76", output)
    assert "training with command of shuttle.motor x 8: 0.0%, 100.0% of the difference" in output


@pytest.mark.slow
def test_a_change_that_is_not_tried_explains_no_difference_in_success(
    tmp_path: Path, deepbots: Deepbots
) -> None:
    """An own speed from step 116 is such a change."""
    words = patient(tmp_path)
    late = "robots.shuttle.receive={go: (0.05 m/s if time > 5.2 s else 0 m/s) if time < 5.8 s else 5 m/s}"
    assert (
        "success: training 100.0%, other 0.0%; no change explains this difference"
        in deepbots(*words, late).out
    )


@pytest.mark.slow
def test_a_cause_in_measured_numbers_is_not_followed_by_the_sentence_that_no_change_explains_the_difference(
    tmp_path: Path, deepbots: Deepbots
) -> None:
    run = train_shuttle(
        tmp_path,
        "robots.shuttle.apply={motor: 0.05 m/s + 0 * drive * speed}",
        "termination.success={stays: time > 1 s and abs(shuttle.place) < 0.3 m}",
        "reward.parked=1 when stays",
    )
    words = ["transfer", str(run), "--quick", "--episodes", "4", "--set"]
    output = deepbots(*words, "robots.shuttle.emit={place: 2 * place + 1 m}").out
    assert "gap is larger by -1.0" in output
    assert "success: training 100.0%, other 0.0%; the success under these changes is unknown" in output


def test_a_transfer_goes_on_if_an_ending_holds_at_the_reset_of_a_start_under_a_likely_change(
    tmp_path: Path,
) -> None:
    """The carriage sinks 0.4 mm before the first step if its motor is weak; `edge` is nearer in a few
    starts."""
    run = Run.open(
        train_shuttle(
            tmp_path,
            "robots.shuttle.pose={pitch: -90 deg}",
            "robots.shuttle.apply={motor: 0 * drive * speed}",
            "parameters.edge=uniform(-8 .. -0.1 mm)",
            "reset={settle: 1 s}",
            "termination.failure={out: shuttle.place < edge}",
            "truncation.max_steps=20",
        )
    )
    won, lost = (Episode(0.0, 20, is_success, "") for is_success in (True, False))
    weak = {"robots": {"shuttle": {"actuators": {"motor": {"max_torque": "0.5 N"}}}}}
    (cause,) = compared(run, weak, episodes=2, outcomes=[(won, lost)] * 20).causes
    assert "torque limit of shuttle.motor 0.5 N" in cause.text
    assert (cause.explained, cause.success) == (pytest.approx(1.0), None)


def test_a_quick_transfer_ends_long_evaluations_after_eight_episodes(run_of: Any) -> None:
    report = transfer(run_of("cartpole"), engine="mujoco", max_steps=1, with_conditions=False)
    assert (report.here.episodes, report.there.episodes) == (8, 8)
    assert [episode.seed for episode in report.here.outcomes] == [
        episode.seed for episode in report.there.outcomes
    ]


def test_a_success_rate_cannot_be_required_if_the_other_world_defines_no_success(tmp_path: Path) -> None:
    far = "termination.success={far: abs(x) > 1 m}"
    trained = train(
        api.compile("cartpole", overrides=[BRIEF, "evaluation.episodes=1", far]), run=tmp_path / "run"
    )
    with pytest.raises(UsageError, match="--min-success: CartPole defines no success; use --min-return"):
        transfer(Run.open(trained.run), engine="mujoco", scenario=api.compile("cartpole"), min_success=0.5)


def test_whether_a_policy_works_follows_from_the_requirements_or_from_solved() -> None:
    from types import SimpleNamespace as Result

    names: Any = ("here", "there")
    results: Any = (Result(mean_return=200.0, success_rate=0.9), Result(mean_return=80.0, success_rate=0.9))
    gates = [
        Gate("here", "success rate", True),
        Gate("there", "success rate", False),
        Gate("there", "mean return", True),
    ]
    assert worlds_that_work(names, results, gates, None)[0] == (True, False)
    assert worlds_that_work(names, results, [], Solved(100, 195.0, None)) == (
        (True, False),
        "the thresholds of `solved` (mean return >= 195)",
    )
    assert worlds_that_work(names, results, [], None) == ((None, None), "")


def test_two_worlds_in_one_engine_do_not_read_as_a_change_of_the_engine() -> None:
    assert (
        world_names(("CartPole", "CartPoleReal"), ("mujoco", "mujoco"), True)[1]
        == "CartPole and CartPoleReal, both in mujoco"
    )
    assert world_names(("CartPole", "CartPole"), ("mujoco", "mujoco"), True) == (
        ("training", "other"),
        "training and other, both CartPole in mujoco",
    )
    assert world_names(("CartPole", "CartPole"), ("pybullet", "mujoco"), False) == (
        ("pybullet", "mujoco"),
        "CartPole in pybullet and in mujoco",
    )


def test_a_policy_that_works_in_both_worlds_with_half_the_return_has_a_much_lower_return() -> None:
    from types import SimpleNamespace as Result

    here: Any = Result(mean_return=39.7, return_interval=(39.0, 40.4))
    there: Any = Result(mean_return=18.5, return_interval=(17.9, 19.1))
    rest: Any = (None, None, (), (True, True), "")
    assert Transfer(Path(), ("here", "there"), "", here, there, *rest).is_much_lower
    assert not Transfer(Path(), ("here", "there"), "", here, here, *rest).is_much_lower


PERIOD = 0.032


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("runs") / "cartpole"
    train(
        api.compile("cartpole", overrides=[BRIEF, "evaluation.episodes=2", "world.engine=mujoco"]),
        run=folder,
        seed=3,
    )
    return Run.open(folder)


def logged(run: Run, path: Path, measured: Callable[[float, float], float], steps: int = 300) -> Path:
    """A log of a robot that moves as the simulation does; `measured` turns time and angle of the pole into
    what its sensor gives."""
    from deepbots_cli.insight.export.control import ControlStep
    from deepbots_cli.insight.export.devices import recorded_steps
    from deepbots_cli.rollout.policies import PolicyDriver
    from deepbots_robot.log import LogWriter

    learner = policy.loaded(run, "best")
    control = ControlStep(run.program, learner)
    writer = LogWriter(path, {})
    simulation = recorded_steps(control, lambda world: PolicyDriver(learner, world))
    for number, step in enumerate(islice(simulation, steps)):
        time = number * PERIOD
        angle = np.array([measured(time, float(step.inputs["cart.pole_angle"][0]))])
        writer.step(100.0 + time, {**step.inputs, "cart.pole_angle": angle}, step.commands, 0.001, "policy")
    writer.close()
    return path


@pytest.mark.slow
def test_a_robot_that_moves_as_the_simulation_differs_in_nothing(run: Run, tmp_path: Path) -> None:
    differences = compare_log(run, logged(run, tmp_path / "log.mcap", lambda time, angle: angle))
    assert not [difference for difference in differences if difference.is_different]


def test_a_bias_is_named_first_with_its_time_and_a_line_for_the_scenario(
    run: Run, tmp_path: Path, deepbots: Deepbots
) -> None:
    log = logged(run, tmp_path / "log.mcap", lambda time, angle: angle + (0.5 if time > 3.2 else 0.0))
    first = compare_log(run, log)[0]
    assert (first.name, first.since) == ("cart.pole_angle", pytest.approx(3.2, abs=2 * PERIOD))
    assert first.robot[0] - first.simulated[0] == pytest.approx(0.5 * 199 / 300, abs=0.02)
    assert re.search(
        r"robots\.cart\.sensors\.pole_angle: \{bias: uniform\(0 \.\. 0\.3[1-5] rad\)\}",
        deepbots("transfer", run.path, "--log", log).out,
    )


@pytest.mark.slow
def test_noise_is_measured(run: Run, tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    log = logged(run, tmp_path / "log.mcap", lambda time, angle: angle + generator.normal(0.0, 0.3))
    (advice,) = {each.advice for each in compare_log(run, log) if each.advice}
    assert float(advice.partition("noise: ")[2].split()[0]) == pytest.approx(0.3, rel=0.15)


def test_the_distance_is_that_of_the_distribution_functions() -> None:
    assert (distance(np.arange(10.0), np.arange(10.0)), distance(np.arange(10.0), np.arange(10.0) + 5.0)) == (
        0.0,
        pytest.approx(0.5),
    )
    assert distance(np.zeros(3), np.ones(7)) == 1.0


def test_a_log_of_another_policy_is_refused(run: Run, tmp_path: Path) -> None:
    damaged = written(tmp_path / "other.mcap", b"no log")
    with pytest.raises(UsageError, match="cannot be read as a log"):
        compare_log(run, damaged)
    with pytest.raises(UsageError, match="has 3 steps of a policy; a comparison needs at least 50"):
        compare_log(run, logged(run, tmp_path / "short.mcap", lambda time, angle: angle, steps=3))
    with pytest.raises(UsageError, match="cannot be read as a log"):
        compare_log(run, tmp_path / "missing.mcap")


def test_the_episodes_of_a_log_are_listed_and_explained(tmp_path: Path, deepbots: Deepbots) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0)
    values, commands = {"cart.pole_angle": np.zeros(1)}, {"cart.wheels": np.zeros(4)}
    for number, begun in enumerate((10.0, 20.0)):
        writer.event(begun, "episode", str(number))
        writer.step(begun + 0.45, values, commands, 0.0, "policy")  # answers no new value
        writer.step(begun + 0.5, values, commands, 0.002, "policy")
    writer.event(20.6, "safe", "no new value of cart.pole_angle")
    writer.step(20.6, {}, commands, 0.0, "safe")
    writer.close()
    episodes = json.loads(deepbots("replay", path, "--json").out)["episodes"]
    assert [
        (episode["number"], episode["begun"], episode["steps"], episode["safe_steps"]) for episode in episodes
    ] == [
        (0, 0.0, 2, 0),
        (1, 10.0, 2, 1),
    ]
    assert [episode["seconds"] for episode in episodes] == [
        0.5,
        0.5,
    ]  # without the time in which no policy acted
    output = deepbots("diagnose", path, "--episode", "1").out
    assert "episode 1: 2 steps of the policy in 0.5 s; median answer 2.00 ms, longest 2.00 ms" in output
    assert "0.60 s  safe posture: no new value of cart.pole_angle" in output
    for command, option, text in (
        ("diagnose", ["--episode", "failed"], "a robot does not see which episodes fail"),
        ("diagnose", ["--last"], "--last does not go with the log of a robot; it takes --episode"),
        ("diagnose", ["--episode", "7"], "has no episode 7; list them with: deepbots replay"),
        ("view", [], "is the log of a robot without the scenario"),
    ):
        assert text in deepbots(command, path, *option, code=2).err


def test_a_log_of_a_robot_that_sent_nothing_says_so(tmp_path: Path, deepbots: Deepbots) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    LogWriter(path, {}).close()
    for words in (["diagnose", str(path)], ["replay", str(path)], ["diagnose", str(path), "--episode", "0"]):
        output = deepbots(*words, code=2)
        assert "contains no step: the robot sent no complete set of values" in output.err
        assert output.out == ""


def test_episodes_of_a_robot_that_restarts_have_numbers_of_their_own(tmp_path: Path) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0)
    writer.event(9.0, "refused", "a message")
    for begun in (10.0, 20.0, 30.0):
        writer.event(begun, "episode", "0")
        writer.step(begun + 1.0, {}, {"cart.wheels": np.zeros(4)}, 0.002, "policy")
    writer.close()
    episodes = logged_episodes(path)
    assert [(episode.number, episode.steps, len(episode.events)) for episode in episodes] == [
        (0, 1, 1),
        (1, 1, 0),
        (2, 1, 0),
    ]


def test_a_page_and_a_diagnosis_of_a_log_have_the_same_episodes_and_events(
    attached: dict[str, bytes], tmp_path: Path
) -> None:
    from deepbots_robot.log import LogWriter

    path = tmp_path / "log.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0, files=attached)
    writer.event(9.0, "remark", "no calibration")
    for number, kinds in ((3, ["refused"]), (4, ["safe", "remark"])):
        begun = 10.0 * number
        writer.event(begun, "episode", str(number))
        writer.step(begun + 1.0, {}, {"cart.wheels": np.zeros(4)}, 0.002, "policy")
        for kind in kinds:
            writer.event(begun + 2.0, kind, f"{kind} {number}")
    writer.close()
    seen = [
        (episode.number, sum(len(step.events) for step in episode.steps))
        for episode in RobotLog.read(path).episodes
    ]
    assert seen == [(episode.number, len(episode.events)) for episode in logged_episodes(path)]
    assert seen == [(0, 2), (1, 2)]


@pytest.mark.slow
def test_a_log_that_a_kill_cut_is_used_with_a_note(run: Run, tmp_path: Path, deepbots: Deepbots) -> None:
    whole = logged(run, tmp_path / "whole.mcap", lambda time, angle: angle)
    cut = tmp_path / "cut.mcap"
    content = whole.read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    for command in (
        ["replay", str(cut)],
        ["diagnose", str(cut)],
        ["transfer", str(run.path), "--log", str(cut)],
    ):
        counts = re.findall(
            r"cut.mcap has no end: its process was killed, or it is damaged; its first (\d+) messages are"
            r" used",
            deepbots(*command).err,
        )
        assert [100 < int(number) < 300 for number in counts] == [True]
        assert "has no end" not in deepbots(*command[:-1], whole).err


# In the page


@pytest.fixture(scope="module")
def attached(run: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of a bundle, as a server attaches them to its log."""
    from deepbots_cli.insight.export.bundle import bundle_files
    from deepbots_robot.bundle import load

    folder = tmp_path_factory.mktemp("bundle")
    for name, content in bundle_files(run, "best").items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return load(folder).description()


@pytest.fixture(scope="module")
def cut_log(attached: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with a step in each of two episodes, then silence; the process was killed."""
    from deepbots_robot.log import LogWriter

    path = tmp_path_factory.mktemp("logs") / "killed.mcap"
    writer = LogWriter(path, {}, clock=lambda: 0.0, files=attached)
    values = {
        "position(cart)": np.array([0.3, 0.1, 0.04]),
        "cart.pole_angle": np.array([0.2]),
        "velocity(cart)": np.zeros(3),
    }
    for number, begun in enumerate((10.0, 20.0)):
        writer.event(begun, "episode", str(number))
        for step in range(3):
            commands = {"cart.wheels": np.full(4, float(step))}
            writer.step(begun + step * PERIOD, values, commands, 0.002, "policy", {"cart.pole_angle": 0.05})
    writer.event(20.2, "safe", "no new value of cart.pole_angle")
    for stamp in (20.2, 20.3):
        writer.step(stamp, {}, {"cart.wheels": np.zeros(4)}, 0.0, "safe", {"cart.pole_angle": 0.15})
    writer._file.flush()
    killed = written(path.with_name("cut.mcap"), path.read_bytes()[:-3])
    writer.close()
    return killed


def test_joints_and_poses_of_a_log_move_the_model_and_all_else_stands(cut_log: Path) -> None:
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        frame = player.begin(0, 1)
        joints = dict(
            zip(
                (joint.name for joint in player.env.world.robots[0].model.moving_joints),
                frame.joints["cart"],
                strict=True,
            )
        )
        assert joints == pytest.approx({**dict.fromkeys(joints, 0.0), "pole_hinge": 0.2})
        root = player.env.world.robots[0].model.root
        assert frame.links["cart", root][0] == pytest.approx((0.3, 0.1, 0.04), abs=1e-6)
        assert "the log moves position(cart), cart.pole_angle" in player.note


def test_what_the_robot_reported_and_got_is_in_the_frames(cut_log: Path) -> None:
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        player.begin(0, 1)
        rows = []
        for _ in range(2):
            frame = player.step()
            (agent,) = frame.agents.values()
            names = [field.name for field in player.reader.layout.observation]
            values = dict(zip(names, agent.observation, strict=True))
            rows.append(
                (
                    frame.time,
                    values["cart.pole_angle"],
                    values["answer time"],
                    values["age of cart.pole_angle"],
                    values["posture"],
                )
            )
            assert agent.action == (frame.step,) * 4
        assert rows == [
            pytest.approx(row) for row in ((PERIOD, 0.2, 2.0, 50.0, 0.0), (2 * PERIOD, 0.2, 2.0, 50.0, 0.0))
        ]


def test_the_page_plays_a_log_that_was_cut_up_to_its_last_whole_step(cut_log: Path) -> None:
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    with closing(Page(Showing(str(cut_log)), port=0, episode=1)) as page:
        page.playback.seek(99)
        assert page.player is not None
        assert page.player.frame.ending == "end of the log"
        assert "safe posture: no new value of cart.pole_angle" in page.banner.content
        assert "return" not in page.banner.content
        assert "reported by the robot" in page.panel.values.content


def test_steps_beyond_the_limit_are_left_out_with_a_note(
    cut_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (note,) = RobotLog.read(cut_log).notes
    assert "has no end: its process was killed" in note
    monkeypatch.setattr(recordings, "MAX_LOGGED_STEPS", 4)
    log = RobotLog.read(cut_log)
    assert [len(episode.steps) for episode in log.episodes] == [3, 1]
    assert log.notes == ("the log is longer than 4 steps; later steps are left out",)
    with closing(open_player(Showing(str(cut_log)).open())) as player:
        player.begin(0, 1)
        assert log.notes[0] in player.note


def test_a_log_with_damaged_content_is_refused_in_one_sentence(
    cut_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from deepbots_robot.log import LogWriter, read_attached

    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    files = read_attached(cut_log)
    wrong = {
        "a description": {**files, "bundle.json": b"{}"},
        "a path": {**files, "inputs/../../evil.urdf": b""},
        "no step": files,
    }
    for number, attached in enumerate(wrong.values()):
        path = tmp_path / f"{number}.mcap"
        LogWriter(path, {}, files=attached).close()
        assert main(["view", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("cannot be read as the log of a robot: ") == 2
    assert "contains no step" in error
    assert list(unpacked.iterdir()) == []

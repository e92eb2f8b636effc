"""Evaluations of a run.

* Evaluating a run.
* Changed conditions of an evaluation.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import stand_in

from deepbots_cli import api
from deepbots_cli.api import Compiled, compile, make
from deepbots_cli.cli.records import case_rows, evaluation_text, robustness_text, summary_text
from deepbots_cli.document import Document, load
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.learning import (
    TrainingResult,
    evaluate,
    evaluate_baselines,
    evaluate_cases,
    evaluate_robustness,
    train,
)
from deepbots_cli.learning.robustness import (
    Change,
    RobustnessLevel,
    Side,
    _bar,
    base_document,
    changed_program,
    changed_scenario,
    delayed,
    plans,
    scaled,
)
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import solved_verdict
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import Source
from tests.commands import Deepbots
from tests.files import written


def figures(trained: TrainingResult, **settings: object) -> dict[str, object]:
    return evaluate(trained.run, build=stand_in.build, **settings).model_dump(mode="json")  # type: ignore[arg-type]


def test_evaluate_takes_the_path_of_a_run_as_text(trained: TrainingResult) -> None:
    assert evaluate(str(trained.run), episodes=1, build=stand_in.build) == evaluate(
        trained.run, episodes=1, build=stand_in.build
    )
    assert evaluate_cases(str(trained.run), build=stand_in.build) == ()


def test_evaluate_takes_another_scenario_by_its_path_as_train_does(trained: TrainingResult) -> None:
    with pytest.raises(RunError, match="was trained with other observations"):
        evaluate(trained.run, episodes=1, scenario="cartpole", build=stand_in.build)


def test_other_seeds_are_other_starts(trained: TrainingResult) -> None:
    assert figures(trained, episodes=20, seed=0) != figures(trained, episodes=20, seed=1)
    assert figures(trained, episodes=20, seed=0) == figures(trained, episodes=20, seed=0)


def test_on_episode_is_called_after_each_episode(trained: TrainingResult) -> None:
    progress: list[tuple[int, int]] = []
    evaluate(
        trained.run,
        episodes=10,
        build=stand_in.build,
        on_episode=lambda done, of: progress.append((done, of)),
    )
    assert progress == [(done, 10) for done in range(1, 11)]


def test_a_single_episode_has_no_standard_deviation(trained: TrainingResult) -> None:
    result = evaluate(trained.run, episodes=1, build=stand_in.build)
    assert result.std_return is None
    assert "standard deviation" not in evaluation_text(result)


def episodes(count: int, total_return: float, successes: int = 0) -> list[Episode]:
    return [Episode(total_return, 1, number < successes, None) for number in range(count)]


def test_the_verdict_follows_the_scenario() -> None:
    solved = Solved(100, mean_return=195.0)
    assert solved_verdict(solved, episodes(100, 199.0)) == (
        True,
        "solved: mean return 199 where 195 is required",
        100,
    )
    assert solved_verdict(solved, episodes(100, 190.0))[0] is False
    assert solved_verdict(solved, episodes(20, 199.0))[0] is None
    assert solved_verdict(None, episodes(100, 199.0))[0] is None
    assert solved_verdict(Solved(10, mean_return=1.0, success_rate=0.9), episodes(10, 5.0, 5))[0] is False


def test_after_failed_confirmations_an_evaluation_that_just_meets_the_criterion_does_not_solve_the_task() -> (
    None
):
    """`train` noted "not confirmed", and ended with "solved: success rate 92.0% where 90.0% is required"."""
    solved = Solved(100, success_rate=0.9)
    met, text, required = solved_verdict(solved, episodes(100, 1.0, 92), number=2)
    assert met is None
    assert required == 150
    assert text.endswith("; evaluate with `--episodes 150`")
    met, text, _ = solved_verdict(solved, episodes(150, 1.0, 138), number=2)
    assert met is False
    assert text.endswith("and to confirm it, at least 142 of 150 successes must be reached")
    assert solved_verdict(solved, episodes(150, 1.0, 142), number=2).solved is True
    assert (
        solved_verdict(solved, episodes(100, 1.0, 92))[0] is True
    )  # of a policy that a confirmation has shown to be good enough


def test_a_scenario_that_no_longer_fits_is_refused_field_by_field(trained: TrainingResult) -> None:
    with pytest.raises(RunError) as caught:
        evaluate(trained.run, scenario=stand_in.compiled(speed_range=2.0), build=stand_in.build)
    assert "observation.speed: run -0.8 .. 0.8 m/s, scenario -2 .. 2 m/s" in str(caught.value)
    assert "observation.x" not in str(caught.value)


def test_reordered_observations_and_other_actions_are_refused(trained: TrainingResult) -> None:
    compiled = stand_in.compiled()
    turned = stand_in.altered(compiled, policy={"observation": compiled.program.agent.observation[::-1]})
    with pytest.raises(RunError, match=r"order: run observation\.x"):
        evaluate(trained.run, scenario=turned, build=stand_in.build)
    with pytest.raises(
        RunError, match=r"action\.drive: run forward \(1\) \| backward \(-1\) sets drive, scenario -1 .. 1"
    ):
        evaluate(trained.run, scenario=stand_in.compiled(continuous=True), build=stand_in.build)


def test_changed_messages_are_refused(trained: TrainingResult) -> None:
    compiled = stand_in.compiled()
    robot = compiled.program.robots[0]
    typed = robot.emit[0].typed
    length = typed._replace(type=typed.type._replace(dimension=LENGTH))
    renamed = replace(robot, emit=(replace(robot.emit[0], typed=length),))
    with pytest.raises(
        RunError, match=r"message from robot cart\.pole_angle: run float64 rad, scenario float64 m"
    ):
        evaluate(trained.run, scenario=stand_in.altered(compiled, robots=(renamed,)), build=stand_in.build)


def test_a_policy_may_be_tried_in_a_scenario_with_other_rules(trained: TrainingResult) -> None:
    result = evaluate(
        trained.run, episodes=3, scenario=stand_in.compiled(max_steps=7, name="Short"), build=stand_in.build
    )
    assert (result.scenario, result.greatest_return) == ("Short", 7)


@pytest.mark.parametrize(
    ("episodes", "seed", "words"), [(0, 0, "episodes"), (-1, 0, "episodes"), (1, -1, "seed")]
)
def test_senseless_numbers_are_refused(trained: TrainingResult, episodes: int, seed: int, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        evaluate(trained.run, episodes=episodes, seed=seed, build=stand_in.build)


def test_an_evaluation_under_another_timing_says_so(trained: TrainingResult) -> None:
    later = stand_in.altered(stand_in.compiled(), timing="delayed")
    result = evaluate(trained.run, episodes=3, scenario=later, build=stand_in.build)
    assert "trained with timing immediate, evaluated with delayed" in evaluation_text(result)
    assert evaluate(trained.run, episodes=3, build=stand_in.build).notes == ()


def evaluation_json() -> Compiled:
    """The stand-in with a case `short`, of three episodes of seven steps, and one that changes nothing of
    it."""
    return stand_in.compiled(
        cases="short: {set: {truncation.max_steps: 7}, episodes: 3}, same: {set: {world.substeps: 4}}"
    )


def test_every_case_is_evaluated_from_the_same_starts(tmp_path: Path) -> None:
    run = train(evaluation_json(), run=tmp_path / "run", total_timesteps=200, build=stand_in.build).run
    base = evaluate(run, build=stand_in.build)
    short, same = evaluate_cases(run, build=stand_in.build)
    assert (short.case, short.episodes, short.greatest_return) == ("short", 3, 7.0)
    plain = {"case": None, "circumstances": [], "verdict": base.verdict}
    assert same.model_dump(mode="json") | plain == base.model_dump(mode="json")
    assert evaluate(run, case="short", build=stand_in.build) == short
    assert evaluate(run, case="short", episodes=5, build=stand_in.build).episodes == 5
    assert "case short" in evaluation_text(short)
    assert [row["case"] for row in case_rows([base, short, same])] == [
        "(the scenario itself)",
        "short",
        "same",
    ]
    with pytest.raises(UsageError, match="no case 'long'; there are: short, same"):
        evaluate(run, case="long", build=stand_in.build)


def test_a_run_with_a_case_for_another_policy_is_refused(tmp_path: Path) -> None:
    run = train(evaluation_json(), run=tmp_path / "run", total_timesteps=200, build=stand_in.build).run
    resolved = run / "resolved.yaml"
    text = (run / "resolved.yaml").read_text()
    for forged in ("observation.speed: -2 .. 2 m/s", "evaluation.episodes: 3"):
        resolved.write_text(text.replace("truncation.max_steps: 7", forged))
        with pytest.raises(RunError, match="does not compile"):
            evaluate(run, build=stand_in.build)


def test_small_returns_are_shown_with_four_decimals() -> None:
    done = [Episode(value, 10, False, "max_time") for value in (0.1423, 0.1431)]
    assert (
        "mean return         0.1427 (95 %: 0.1376 .. 0.1478)\n  standard deviation  0.0006"
        in summary_text(Summary.of_episodes(done), success_defined=False)
    )
    assert "mean return       14.27" in summary_text(
        Summary.of_episodes([Episode(14.27, 10, False, None)]), success_defined=False
    )


def test_an_evaluation_that_already_excludes_what_is_asked_for_says_so() -> None:
    solved = Solved(100, success_rate=0.95)
    met, verdict, _ = solved_verdict(solved, episodes(30, 0.0))
    assert met is False
    assert verdict.startswith("not solved: a success rate of 95% is required, and 0 of 30 episodes succeed")
    assert solved_verdict(solved, episodes(30, 0.0, 29))[0] is None


def test_an_episode_keeps_the_seed_and_what_its_reset_drew(tmp_path: Path) -> None:
    task = compile(
        "find_ball",
        overrides=[
            "train.environments=1",
            "train.n_steps=32",
            "train.batch_size=32",
            "truncation.max_steps=50",
        ],
    )
    result = evaluate(train(task, run=tmp_path / "run", total_timesteps=1).run, episodes=2)
    with make("find_ball") as env:
        for episode in result.outcomes:
            assert env.reset(seed=episode.seed)[1]["drawn"] == episode.drawn != {}
    assert list(result.outcomes[0].drawn) == list(result.outcomes[1].drawn)


@pytest.mark.slow
def test_baselines_and_the_policy_have_the_same_starts(tmp_path: Path) -> None:
    task = compile(
        "pit_escape", overrides=["train.environments=1", "train.n_steps=32", "train.batch_size=32"]
    )
    run = train(task, run=tmp_path / "run", total_timesteps=1).run
    results = evaluate_baselines(
        run, episodes=2, seed=5, scenario=compile("pit_escape", overrides=["truncation.max_steps=20"])
    )
    assert [result.model for result in results] == ["random", "zero", "script forward_only", "script rocking"]
    policy = evaluate(
        run, episodes=2, seed=5, scenario=compile("pit_escape", overrides=["truncation.max_steps=20"])
    )
    for result in results:
        assert [episode.drawn for episode in result.outcomes] == [
            episode.drawn for episode in policy.outcomes
        ]


def changes(
    name: str, case: str | None = None, stage: str | None = None
) -> tuple[Document, dict[str, dict[str, Change]]]:
    """A shipped scenario, in a case or stage, and the changes of each condition by level."""
    base = base_document(Source.open(name), (), case, stage)
    assert base.root is not None
    program = api.compile(name).program.variant(case, stage)
    return base, {plan.name: dict(plan.levels) for plan in plans(base.root, program)}


def masses(program: Program) -> list[float]:
    return [
        link.inertial.mass
        for robot in program.world.robots
        for link in robot.model.links
        if link.inertial is not None
    ]


def test_each_condition_changes_what_it_says_and_nothing_else() -> None:
    base, conditions = changes("cartpole")
    plain = api.compile("cartpole").program
    assert list(conditions) == [
        "latency to the robot",
        "latency from the robot",
        "message loss",
        "observation noise",
        "mass of cart.body",
        "friction of the ground",
        "motor strength",
    ]

    def changed(condition: str, level: str) -> Program:
        return changed_scenario(base, conditions[condition][level]).program

    loaded = changed("mass of cart.body", "x 2")
    factors = [after / before for before, after in zip(masses(plain), masses(loaded), strict=True)]
    assert sorted(factors) == pytest.approx([1.0] * (len(factors) - 1) + [2.0])
    assert loaded.robots[0].to_route.perfect
    late = changed("latency to the robot", "+64 ms").robots[0]
    assert late.to_route.latency is not None
    assert late.to_route.latency.scalar.value == pytest.approx(0.064)  # type: ignore[union-attr]
    assert late.from_route.perfect
    lossy = changed("message loss", "20%").robots[0]
    assert lossy.to_route.loses
    assert lossy.from_route.loses
    ground = changed("friction of the ground", "x 0.5").world.ground
    assert ground is not None
    assert ground.friction == 0.5
    noisy = changed("observation noise", "10% of the range").agent.numbers
    assert [number.std.value / (number.high - number.low) for number in noisy] == pytest.approx([0.1] * 4)  # type: ignore[union-attr]


def test_the_link_or_object_whose_mass_is_changed_can_be_named(trained: TrainingResult) -> None:
    for scenario, name in (("cartpole", "cart.pole"), ("panda_push", "block")):
        base = base_document(Source.open(scenario))
        assert base.root is not None
        (plan,) = (
            plan
            for plan in plans(base.root, api.compile(scenario).program, name)
            if plan.name == f"mass of {name}"
        )
        assert changed_scenario(base, dict(plan.levels)["x 2"]).digest != api.compile(scenario).digest
    with pytest.raises(
        UsageError, match=r"there is no link or object 'cart.poel' with a mass; choose from: cart\.body, "
    ):
        evaluate_robustness(trained.run, mass_of="cart.poel", build=stand_in.build)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("5 kg", "(5 kg)"),
        ("5 kg if far else 6 kg", "(5 kg if far else 6 kg)"),
        ("5 kg when far", "(5 kg if far else 0)"),
        ("uniform(0 .. 1 s) each step", "(uniform(0 .. 1 s)) each step"),
        ("(a if far else b) when near  # often", "((a if far else b) if near else 0)"),
        ("a when far every 2 s", "(a if far else 0) every 2 s"),
    ],
)
def test_a_value_with_a_condition_or_of_each_step_is_changed_as_a_whole(text: str, expected: str) -> None:
    assert scaled(2, text) == f"2.0 * {expected}"
    assert delayed(32, text) == f"32.0 ms + {expected}"


def conditions_of(path: Path, mass_of: str | None = None) -> tuple[Document, dict[str, dict[str, Change]]]:
    """The scenario of a file, and the changes of each condition by level."""
    base = base_document(Source.open(path))
    assert base.root is not None
    program = api.compile(path).program
    return base, {plan.name: dict(plan.levels) for plan in plans(base.root, program, mass_of)}


def extended(tmp_path: Path, text: str, name: str = "cartpole") -> Path:
    """A file that extends a shipped scenario."""
    return written(tmp_path / "own.yaml", f"deepbots: 1\nextends: {name}\nname: Own\n{text}")


def test_the_levels_of_a_latency_are_whole_timesteps_whatever_the_timestep(tmp_path: Path) -> None:
    base, conditions = conditions_of(extended(tmp_path, "world: {timestep: 1 s / 60}\n"))
    counts = []
    for change in conditions["latency to the robot"].values():
        latency = changed_scenario(base, change).program.robots[0].to_route.latency
        assert latency is not None
        counts.append(60 * latency.scalar.value)  # type: ignore[union-attr]
    assert counts == pytest.approx([1, 2, 4, 8], abs=1e-12)


def test_the_observation_of_one_agent_of_several_has_noise_and_that_of_the_other_has_not() -> None:
    for agent, other in (("hunter", "prey"), ("prey", "hunter")):
        overrides = [f"role={{agent: {agent}}}"]
        base = base_document(Source.open("tag"), overrides)
        assert base.root is not None
        program = api.compile("tag", overrides=overrides).program
        (plan,) = (plan for plan in plans(base.root, program) if plan.name == "observation noise")
        others = changed_scenario(base, dict(plan.levels)["10% of the range"]).program.others
        assert others is not None
        noisy = {name: member.program.agent.numbers for name, member in others.world.members.items()}
        assert all(number.std is not None for number in noisy[agent])
        assert all(number.std is None for number in noisy[other])


def test_the_observation_of_an_agent_that_shares_a_policy_has_noise_too(tmp_path: Path) -> None:
    path = extended(tmp_path, "agents: {right: {policy: left}}\n", "carry")
    for agent in ("left", "right"):
        base = base_document(Source.open(path), [f"role={{agent: {agent}}}"])
        assert base.root is not None
        program = changed_program(base, {})
        (plan,) = (plan for plan in plans(base.root, program) if plan.name == "observation noise")
        numbers = changed_program(base, dict(plan.levels)["10% of the range"]).agent.numbers
        assert all(number.std is not None for number in numbers)


def with_success(trained: TrainingResult, tmp_path: Path) -> Path:
    """The scenario of a run with a success."""
    text = (trained.run / "resolved.yaml").read_text()
    return written(
        tmp_path / "success.yaml",
        text.replace("inputs/robots/urdf/cartpole.urdf", "cartpole").replace(
            "failure:", "success: {far: abs(x) > 1 m}\n  failure:"
        ),
    )


def test_a_required_return_of_solved_counts_although_the_scenario_defines_success(
    trained: TrainingResult, tmp_path: Path
) -> None:
    path = with_success(trained, tmp_path)
    nominal = evaluate(trained.run, episodes=2, scenario=path, build=stand_in.build)
    assert nominal.success_defined
    assert _bar(api.compile(path).program, nominal, None, None)[:2] == ("mean_return", 195.0)


def test_a_success_rate_is_required_of_the_scenario_that_is_evaluated(
    trained: TrainingResult, tmp_path: Path, deepbots: Deepbots
) -> None:
    path = with_success(trained, tmp_path)
    options = ["--min-success", "50%", "--episodes", "1", "--set", "truncation.max_steps=2"]
    ran = deepbots("robustness", trained.run, *options, "--scenario", path, code=1)
    assert "required: success rate of at least 50.0%" in ran.out
    ran = deepbots("robustness", trained.run, *options, code=2)
    assert "--min-success: stand_in defines no success; use --min-return, or add" in ran.err


ARM = """\
deepbots: 1
name: Arm
world: {timestep: 32 ms}
robots:
  arm:
    urdf: arm.urdf
    base: fixed
    sensors: {angle: {type: joint_position, joint: turn}}
    actuators: {motor: {type: velocity_motor, joint: turn}}
    emit: [angle]
    apply: {motor: drive * 1 rad/s}
objects: {wall: {shape: box, size: 1 1 1 m, fixed: true, mass: 9 kg}}
action: {drive: -1 .. 1}
observation: {arm.angle: -3.2 .. 3.2 rad}
reward: {alive: 1}
truncation: {max_steps: 10}
train: {algorithm: PPO, total_timesteps: 100}
"""
URDF = """<robot name="arm">
<link name="base"><inertial><mass value="50"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="post"><inertial><mass value="20"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="rod"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="weld" type="fixed"><parent link="base"/><child link="post"/></joint>
<joint name="turn" type="continuous"><parent link="post"/><child link="rod"/><axis xyz="0 0 1"/></joint>
</robot>"""


def test_the_mass_of_what_is_fixed_to_the_world_is_not_varied(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(ARM)
    (tmp_path / "arm.urdf").write_text(URDF)
    root, program = load(tmp_path / "arm.yaml").root, api.compile(tmp_path / "arm.yaml").program
    assert root is not None
    assert [plan.name for plan in plans(root, program) if plan.name.startswith("mass")] == ["mass of arm.rod"]
    for name in ("arm.post", "wall"):
        with pytest.raises(
            UsageError,
            match=f"'{name}' is fixed to the world, so its mass has no effect; choose from: arm.rod$",
        ):
            list(plans(root, program, name))


def test_a_policy_is_measured_against_a_bar_at_every_level(trained: TrainingResult) -> None:
    progress: list[tuple[int, int]] = []
    result = evaluate_robustness(
        trained.run,
        episodes=2,
        min_return=1.0,
        overrides=["truncation.max_steps=40"],
        build=stand_in.build,
        on_level=lambda done, of: progress.append((done, of)),
    )
    assert (result.metric, result.bar, result.bar_source) == ("mean_return", 1.0, "given")
    levels = [entry for condition in result.conditions for entry in condition.levels]
    assert progress[-1] == (1 + len(levels), 1 + len(levels))
    assert result.conditions[0].verdicts == {"latency to the robot": "holds up to +256 ms"}
    assert {
        condition.name: [side.holds_up_to for side in condition.sides] for condition in result.conditions
    }["mass of cart.body"] == [
        "x 0.5",
        "x 2",
    ]
    starts = {tuple(episode.seed for episode in entry.evaluation.outcomes) for entry in levels}
    assert starts == {tuple(episode.seed for episode in result.nominal.outcomes)}
    brief: dict[str, Any] = {"episodes": 1, "overrides": ["truncation.max_steps=5"], "build": stand_in.build}
    strict = evaluate_robustness(trained.run, min_return=1e6, **brief)
    # A single episode has no interval.
    assert strict.conditions[0].verdicts == {"latency to the robot": "fails from +32 ms (not significant)"}
    assert (result.nominal_holds, strict.nominal_holds) == (True, False)
    assert (result.nominal_certain, strict.nominal_certain) == (True, False)
    assert re.search(r"\(no change\) .* missed, not significant", robustness_text(strict))
    assert "even without any change; set another one with --min-return" in robustness_text(strict)
    assert "set another one" not in robustness_text(result)
    assert _bar(Run.open(trained.run).program, result.nominal, None, None)[1] == 195.0


def side(**levels: tuple[float, float, float]) -> Side:
    """Levels of a latency with a score, and the ends of its interval; the required score is 0.8."""
    return Side(
        "",
        tuple(
            RobustnessLevel(
                f"+{name[1:]} ms", SimpleNamespace(), score >= 0.8, not low <= 0.8 <= high, (low, high)
            )  # type: ignore[arg-type]
            for name, (score, low, high) in levels.items()
        ),
    )


def test_a_level_that_is_easier_than_a_smaller_one_within_the_intervals_is_not_a_threshold() -> None:
    close = side(l10=(0.95, 0.85, 0.99), l20=(0.76, 0.62, 0.86), l40=(0.84, 0.7, 0.93), l80=(0.1, 0.05, 0.2))
    assert close.verdict == (
        "holds up to +10 ms, fails from +80 ms; not decided at +20 ms and +40 ms, which do not differ within"
        " their intervals"
    )
    assert (close.holds_up_to, close.fails_from) == ("+10 ms", "+80 ms")
    apart = side(l20=(0.5, 0.4, 0.6), l40=(0.9, 0.85, 0.97))
    assert apart.verdict == "fails at +20 ms but holds at +40 ms: here, a larger change is not always harder"


def test_the_verdict_says_up_to_which_level_the_interval_excludes_the_required_score() -> None:
    falling = side(
        l10=(0.95, 0.85, 0.99), l20=(0.84, 0.7, 0.93), l40=(0.76, 0.62, 0.86), l80=(0.1, 0.05, 0.2)
    )
    assert (
        falling.verdict
        == "holds up to +20 ms (up to +10 ms with 95 % confidence), fails from +40 ms (from +80 ms with 95 %"
        " confidence)"
    )


def test_half_the_mass_and_more_mass_are_two_sides_each_from_the_smallest_change_on() -> None:
    base = base_document(Source.open("cartpole"))
    assert base.root is not None
    planned = {plan.name: plan for plan in plans(base.root, api.compile("cartpole").program)}
    for plan in (planned["mass of cart.body"], planned["friction of the ground"]):
        assert {
            side: [plan.level(amount)[0] for amount in amounts] for side, amounts in plan.sides.items()
        } == {
            "smaller": ["x 0.75", "x 0.5"],
            "larger": ["x 1.25", "x 1.5", "x 2"],
        }


STAIR = (
    "{stair: {shape: box, size: 1 1 0.1 m, fixed: true, friction: 0.8}, mark: {shape: sphere, radius: 1"
    " cm, fixed: true, solid: false}}"
)


def test_the_friction_of_a_stair_varies_with_that_of_the_ground_and_is_named() -> None:
    source = Source.open("cartpole")
    base = base_document(source, [f"objects={STAIR}"])
    assert base.root is not None
    program = api.compile(source.checked(overrides=[f"objects={STAIR}"])).program
    (plan,) = (plan for plan in plans(base.root, program) if plan.name.startswith("friction"))
    assert plan.name == "friction of the ground and stair"
    world = changed_scenario(base, dict(plan.levels)["x 0.5"]).program.world
    assert world.ground is not None
    assert world.ground.friction == 0.5
    assert {body.name: body.friction for body in world.objects} == {"stair": 0.4, "mark": 1.0}


def test_a_policy_that_fails_without_any_change_has_nothing_to_keep(
    trained: TrainingResult, tmp_path: Path, deepbots: Deepbots
) -> None:
    hard = with_success(trained, tmp_path)
    hard.write_text(re.sub(r"(?m)^solved:.*\n", "", hard.read_text()))
    options = ["--scenario", str(hard), "--engine", "mujoco", "--episodes", "2"]
    output = deepbots("robustness", trained.run, *options, code=1).out
    assert "nothing to keep: without any change, the success rate is 0.0%" in output
    assert "required" not in output
    result = evaluate_robustness(trained.run, episodes=2, scenario=hard, engine="mujoco")
    assert result.bar is None
    assert result.nominal_holds is False
    assert result.conditions == ()

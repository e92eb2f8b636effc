"""Changed conditions of an evaluation."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import stand_in

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.cli.records import robustness_text
from deepbots_cli.document import Document, load
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import TrainingResult, evaluate_robustness
from deepbots_cli.learning.robustness import (
    Change,
    RobustnessLevel,
    Side,
    _bar,
    base_document,
    changed_scenario,
    plans,
)
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import Program, identity
from deepbots_cli.rollout.source import Source
from tests.few import few


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


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", few(["cartpole_wireless", "quadruped", "find_ball_random", "panda_push"], ["find_ball_random"])
)
def test_every_condition_compiles_and_leaves_the_interface_of_the_policy_alone(name: str) -> None:
    base, conditions = changes(name)
    plain = api.compile(name)
    for levels in conditions.values():
        changed = changed_scenario(base, [*levels.values()][-1])
        assert identity.differences(plain.program, changed.program) == []
        assert changed.digest != plain.digest


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "case", "stage"),
    [("find_ball_random", None, "crowded"), pytest.param("quadruped", "rough", None, marks=pytest.mark.slow)],
)
def test_in_a_case_or_stage_its_settings_apply_before_the_changes(
    name: str, case: str | None, stage: str | None
) -> None:
    base, conditions = changes(name, case, stage)
    plain = api.compile(name).program.variant(case, stage)

    def variant(change: Change) -> Program:
        return changed_scenario(base, change).program.variant(case, stage)

    assert identity.task_digest(variant({})) == identity.task_digest(plain)
    assert any(condition.startswith("friction of the ground") for condition in conditions)
    for levels in conditions.values():
        assert identity.task_digest(variant([*levels.values()][-1])) != identity.task_digest(plain)


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
        build=stand_in.build,
        on_level=lambda done, of: progress.append((done, of)),
    )
    assert result.metric == "mean_return"
    assert result.bar == 1.0
    assert result.bar_source == "given"
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
    trained: TrainingResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (trained.run / "resolved.yaml").read_text()
    without_solved = re.sub(r"(?m)^solved:.*\n", "", text).replace(
        "inputs/robots/urdf/cartpole.urdf", "cartpole"
    )
    hard = tmp_path / "hard.yaml"
    hard.write_text(without_solved.replace("failure:", "success: {far: abs(x) > 1 m}\n  failure:"))
    options = ["--scenario", str(hard), "--engine", "mujoco", "--episodes", "2"]
    assert main(["robustness", str(trained.run), *options]) == 1
    output = capsys.readouterr().out
    assert "nothing to keep: without any change, the success rate is 0.0%" in output
    assert "required" not in output
    result = evaluate_robustness(trained.run, episodes=2, scenario=hard, engine="mujoco")
    assert result.bar is None
    assert result.nominal_holds is False
    assert result.conditions == ()

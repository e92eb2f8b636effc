"""The measurements of a simulation and the findings that follow from them.

The versions of a scenario that lint judges: itself, and with the settings of each stage and each case."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli.starters.templates import Template, from_template
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import shipped
from deepbots_cli.lint import all_findings, simulate
from deepbots_cli.lint.simulation import simulation_plan
from deepbots_cli.program.task import idle_action
from tests.worlds import SCENARIOS

pytestmark = pytest.mark.usefixtures("simulated_here")

CARTPOLE = (
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)
CARTPOLE = CARTPOLE.replace("world:\n", "world:\n  engine: mujoco\n", 1)  # steps it four times as fast
ARM = SCENARIOS / "arm.yaml"
Probed = Callable[[str], list[Finding]]


@pytest.fixture
def simulated_findings(tmp_path: Path) -> Probed:
    (tmp_path / "cartpole.yaml").write_text(CARTPOLE)

    def run(sections: str) -> list[Finding]:
        file = tmp_path / "mine.yaml"
        file.write_text(f"deepbots: 1\nextends: cartpole.yaml\nname: Mine\n{sections}")
        return list(simulate(api.load(file), preview=True).findings)

    return run


def test_findings_are_the_same_on_every_run(simulated_findings: Probed) -> None:
    text = "augment: {height: position(cart.tip).z}\nobservation: {height: 0 .. 30 cm}\n"
    first, second = simulated_findings(text), simulated_findings(text)
    assert [(finding.headline, finding.notes) for finding in first] == [
        (finding.headline, finding.notes) for finding in second
    ]
    assert first


def test_a_value_that_a_case_changes_is_not_a_constant(simulated_findings: Probed) -> None:
    still = "parameters: {lit: 1}\naugment: {shown: lit / 2}\nobservation: {shown: 0 .. 2}\n"
    assert [finding.code for finding in simulated_findings(still)] == ["DB608"]
    assert simulated_findings(still + "evaluation: {cases: {drawn: {set: {lit: uniform(1 .. 2)}}}}\n") == []


def test_bodies_are_checked_before_they_settle(simulated_findings: Probed) -> None:
    findings = simulated_findings("reset: {place: {cart: {z: 1 cm}}, settle: 3.2 s}\n")
    assert ("DB310", "cart") in [(finding.code, finding.span.text) for finding in findings]


@pytest.mark.slow
def test_a_pose_out_of_reach_is_reported_where_only_a_script_commands_it() -> None:
    pytest.importorskip("pybullet_data")
    far = [
        "robots.panda.apply.hand=vector(0.6 m, 0.2 m, 0.3 m) + 2 m * reach",
        "scripts={away: {reach: 1, open: 0}, stay: {reach: 0, open: 1}}",
        "truncation.max_steps=5",
    ]
    (finding,) = simulate(api.load(str(ARM), overrides=far)).findings
    assert finding.code == "DB315"
    assert "the script `away`" in finding.notes[0]


def test_a_pose_out_of_reach_is_reported_beside_the_error_that_it_may_explain(
    simulated_findings: Probed,
) -> None:
    pytest.importorskip("pybullet_data")
    strong = "stiffness: 100_000 N*m/rad, damping: 100_000 N*m*s/rad"
    findings = simulated_findings(
        "world: {engine: pybullet}\nrobots:\n  cart:\n    actuators:\n"
        f"      spring: {{type: position_motor, joint: pole_hinge, {strong}}}\n"
        "    apply: {spring: 5 deg}\n"
        "  arm:\n    urdf: package://pybullet_data/kuka_iiwa/model.urdf\n    base: fixed\n    pose: {y: 2"
        " m}\n    emit: []\n"
        "    actuators: {hand: {type: cartesian, link: lbr_iiwa_link_7, joints: [lbr_iiwa_joint_*]}}\n"
        '    apply: {hand: "vector(5 m, 2 m, 0.4 m)"}\n'
    )
    assert [finding.code for finding in findings] == ["DB309", "DB315"]


@pytest.mark.parametrize(
    ("skids", "height", "notes"),
    [
        ((0.05,), 0.0, []),
        ((0.05, -0.05), -0.001, []),
        ((0.05, -0.05), 0.002, ["`body` reaches 2 mm lower than the driven wheels"]),
    ],
)
def test_a_robot_that_stands_on_its_skids_stays_although_its_wheels_turn(
    tmp_path: Path, skids: tuple[float, ...], height: float, notes: list[str]
) -> None:
    (tmp_path / "car.urdf").write_text(wheeled(skids, height))
    (tmp_path / "car.yaml").write_text(CAR)
    findings = list(simulate(api.load(tmp_path / "car.yaml")).findings)
    assert [finding.code for finding in findings] == ["DB322"] * bool(notes)
    assert [note for finding in findings for note in finding.notes[:-1]] == notes


def wheeled(skids: tuple[float, ...], height: float) -> str:
    """A robot on two driven wheels that stands on skids at these x, each `height` lower than the wheels."""

    def link(name: str, mass: float, *shapes: str) -> str:
        moment = 2e-3 * mass
        inertia = (
            f'<inertial><mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}"'
            ' ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        return (
            f'<link name="{name}">{inertia}'
            + "".join(f"<collision>{shape}</collision>" for shape in shapes)
            + "</link>"
        )

    def wheel(name: str, y: float) -> str:
        place = f'<parent link="body"/><child link="{name}"/><origin xyz="-0.03 {y} 0"/><axis xyz="0 1 0"/>'
        tire = '<origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.035" length="0.02"/></geometry>'
        return (
            link(name, 0.05, tire)
            + f'<joint name="{name}" type="continuous">{place}<limit effort="0.5" velocity="12"/></joint>'
        )

    spheres = [
        f'<origin xyz="{x} 0 -0.02"/><geometry><sphere radius="{0.015 + height}"/></geometry>' for x in skids
    ]
    box = '<geometry><box size="0.14 0.1 0.04"/></geometry>'
    return f'<robot name="car">{link("body", 0.5, box, *spheres)}{wheel("left", 0.06)}{wheel("right", -0.06)}</robot>'


CAR = """\
deepbots: 1
name: Car
world: {timestep: 20 ms, substeps: 4, engine: mujoco}
robots:
  car:
    urdf: car.urdf
    sensors: {wheels: {type: joint_velocity, joints: [left, right]}}
    actuators: {left: {type: velocity_motor, joint: left}, right: {type: velocity_motor, joint: right}}
    apply: {left: one * 8 rad/s, right: other * 8 rad/s}
action: {one: -1 .. 1, other: -1 .. 1}
augment: {along: velocity(car).x}
observation: {car.wheels: -8 .. 8 rad/s, along: -0.3 .. 0.3 m/s}
reward: {onward: along / (m/s)}
truncation: {max_steps: 100}
"""


def test_one_pair_of_a_group_is_reported(simulated_findings: Probed) -> None:
    crates = "  crate: {count: 3, shape: box, size: 10 10 10 cm, mass: 1 kg}\n"
    (finding,) = simulated_findings(
        f"objects:\n{crates}reset: {{place: {{crate: {{x: 0.3 m, spacing: 0 0.02 m}}}}}}\n"
    )
    assert finding.code == "DB310"
    assert finding.headline.startswith("`crate#")


def test_a_robot_that_the_engine_cannot_hold_is_a_finding_at_its_name(
    simulated_findings: Probed, tmp_path: Path
) -> None:
    pytest.importorskip("pybullet")
    links = "".join(
        f'<link name="l{number}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
        ' iyz="0"/></inertial></link>'
        for number in range(130)
    )
    joints = "".join(
        f'<joint name="j{number}" type="fixed"><parent link="l{number}"/><child'
        f' link="l{number + 1}"/></joint>'
        for number in range(129)
    )
    (tmp_path / "long.urdf").write_text(f'<robot name="long">{links}{joints}</robot>')
    (finding,) = simulated_findings("world: {engine: pybullet}\nrobots: {snake: {urdf: long.urdf}}\n")
    assert (finding.code, finding.span.text) == ("DB309", "snake")
    assert "127" in finding.headline


def test_doing_nothing_is_the_option_of_zeros_or_the_value_that_is_nearest_to_zero() -> None:
    assert idle_action(api.load("cartpole").program.agent.action) is None
    assert idle_action(api.load("find_and_avoid").program.agent.action) == ([4], [])
    assert idle_action(api.load("cartpole_continuous").program.agent.action) == ([], [0.0])


def test_costly_scenarios_are_given_fewer_steps() -> None:
    usual, costly = (
        simulation_plan(api.load("pit_escape", overrides=overrides).program)
        for overrides in ([], ["world.substeps=100"])
    )
    assert costly.min_random_steps < usual.min_random_steps
    assert max(rollout.steps for rollout in costly.rollouts) < max(
        rollout.steps for rollout in usual.rollouts
    )


def test_a_wall_of_one_piece_goes_by_its_own_name(simulated_findings: Probed) -> None:
    (finding,) = simulated_findings(
        "world: {walls: {barrier: {points: [0 -0.3 m, 0 0.3 m], height: 15 cm}}}\n"
    )
    assert finding.code == "DB310"
    assert finding.headline.startswith("`cart` and `barrier` overlap")
    assert [label.span.text for label in finding.labels] == ["barrier"]


# No false alarms: what comes with deepbots is silent under simulation, preview rules included


CHEAP = ("balancer", "quadrotor")
"""Wheels and thrusters; the others are marked as slow (1 to 7 s of CPU each)."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in CHEAP else pytest.mark.slow)
        for name in shipped.scenario_names()
    ],
)
def test_a_shipped_scenario_is_silent_when_it_is_simulated(name: str) -> None:
    checked = api.load(name)
    result = simulate(checked, preview=True)
    assert result.incomplete is None
    assert all_findings(checked, preview=True, measured=result.findings) == []


@pytest.mark.parametrize(
    "template", [pytest.param(name, marks=() if name == "wheeled" else pytest.mark.slow) for name in Template]
)
def test_a_template_is_silent_when_it_is_simulated(template: str, tmp_path: Path) -> None:
    for name, data in from_template(template, "mine").items():
        (tmp_path / name).write_bytes(data)
    checked = api.load(tmp_path / "mine.yaml")
    assert all_findings(checked, preview=True, measured=simulate(checked, preview=True).findings) == []


NAMES = {"base": "", "stage": "in stage `first`, ", "case": "in case `other`, "}
EACH, TRAINED, EVERY = tuple(NAMES), ("base", "stage"), ("base",)
MISTAKES = {
    "DB312": ("wheel_speed: 500 rad/s", EACH),
    "DB411": ("reward.still: 1 when speed == 0 m/s", EACH),
    "DB507": ("objects.crate: {shape: box, size: 50 50 50 m, pose: {x: 1 m}}", EACH),
    "DB611": ("reset.place: {cart: {x: 0.45 m}}", EACH),
    "DB701": ("reward.near: 1 / abs(x / m)", EACH),
    "DB802": ("termination.failure.fallen: abs(cart.pole_angle) > -fall_angle", EACH),
    "DB806": ("reset.joints: {cart.pole_hinge: 16 deg}", EACH),
    "DB703": ("reward.failed: 5 when fallen", TRAINED),
    "DB805": ("termination.failure.late: time > 5 s", TRAINED),
    "DB801": ("termination.failure.late: step < 0", EVERY),
    "DB704": ("reward.off: 1 when step < 0", EVERY),
}
"""A setting that is a mistake, and the versions in which it is one: no policy trains in a case, and what never
holds in one version may hold in others."""
CARTPOLE_FILE = Path(__file__).parents[1] / "golden" / "lint" / "cartpole.yaml"


def settings_in(where: str, setting: str) -> list[str]:
    """The arguments of `--set` that write a setting into a version of CartPole."""
    key, _, value = setting.partition(": ")
    base = f"{key}={value}" if where == "base" else "summary=a stage and a case"
    stage, case = (
        f"{{{setting}}}" if where == kind else "{wheel_speed: 4 rad/s}" for kind in ("stage", "case")
    )
    stages = f"curriculum=[{{name: first, set: {stage}, until: 10_000 steps}}, {{name: last}}]"
    return ["action={drive: -1 .. 1}", base, stages, f"evaluation.cases={{other: {{set: {case}}}}}"]


@pytest.mark.parametrize("where", NAMES)
@pytest.mark.parametrize("code", MISTAKES)
def test_a_mistake_in_one_version_is_reported_once_with_its_name(code: str, where: str) -> None:
    setting, versions = MISTAKES[code]
    checked = api.load(CARTPOLE_FILE, overrides=settings_in(where, setting))
    headlines = [finding.headline for finding in all_findings(checked, preview=True) if finding.code == code]
    assert [headline.startswith(NAMES[where]) for headline in headlines] == [True] * (where in versions)
    assert where != "base" or not any(headline.startswith("in ") for headline in headlines)


def test_an_idle_test_is_judged_in_its_own_case() -> None:
    changes = [
        "evaluation.cases={wide: {set: {track: 1 m}}}",
        "tests={idle: {driver: random, case: wide, expect: {always: track > 0.5 m}}}",
    ]
    checked = api.load(CARTPOLE_FILE, overrides=changes, tests=True)
    headlines = [finding.headline for finding in all_findings(checked, preview=True)]
    assert headlines == ["in case `wide`, `always` of the test `idle` checks nothing: it is always met"]


@pytest.mark.parametrize("where", NAMES)
def test_an_error_in_the_simulation_of_a_version_names_it(where: str) -> None:
    constant = [
        "parameters.lit=1",
        "augment.shown=lit / 2",
        "observation.shown=0 .. 2",
    ]  # so that all versions are simulated
    changes = [*constant, *settings_in(where, "reward.alive: 1 / (step - 3)")]
    (finding,) = simulate(api.load(CARTPOLE_FILE, overrides=changes), preview=True).findings
    assert (finding.code, finding.headline) == ("DB707", f"{NAMES[where]}`alive` is not finite")

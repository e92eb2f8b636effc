"""What users of other tools write is refused with what to write here instead."""

from __future__ import annotations

import pytest

from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.program.identity import to_json
from deepbots_cli.scenario.actuators import ACTUATORS
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.scenario.synonyms import synonyms, word_for
from deepbots_cli.scenario.world import OBJECTS, TILES
from tests.compile.conftest import shipped_text
from tests.few import every


@pytest.fixture
def head(workshop) -> str:
    (workshop.file.parent / "cartpole.yaml").write_text(shipped_text("cartpole"), encoding="utf-8")
    return "deepbots: 1\nextends: cartpole.yaml\nname: Habits\n"


UNITS = {
    "world: {timestep: 32}": "`32 ms`",
    "world: {timestep: 0.032}": "`0.032 s`",
    "truncation: {max_time: 20}": "`20 s`",
    "reset: {settle: 2}": "`2 s`",
    "messages: {to_robot: {latency: 20}}": "`20 ms`",
    "robots: {cart: {sensors: {pole_angle: {period: 64}}}}": "`64 ms`",
    "robots: {cart: {sensors: {pole_angle: {noise: 1}}}}": "`1 deg` or `1 rad`",
    "robots: {cart: {actuators: {wheels: {max_torque: 3}}}}": "`3 N*m`",
    "robots: {cart: {actuators: {wheels: {delay: 16}}}}": "`16 ms`",
    "reset: {joints: {cart.pole_hinge: 15}}": "`15 deg`",
    "observation: {cart.pole_angle: -20 .. 20}": "`-20 .. 20 deg`",
    "observation: {speed: -0.8 .. 0.8}": "`-0.8 .. 0.8 m/s`",
    "termination: {failure: {fast: speed > 2}}": "`2 m/s`",
    "world: {gravity: 0 0 -9.81}": "`0 0 -9.81 m/s^2`",
}


@pytest.mark.parametrize("line", UNITS)
def test_a_number_without_its_unit_is_shown_with_the_probable_one(workshop, head, line):
    findings = [finding for finding in workshop.lint(f"{head}{line}\n") if finding.code == "DB502"]
    assert [finding.help for finding in findings] == [f"write its unit: {UNITS[line]}"]


@pytest.mark.parametrize("word", ["random", "uniform", "anny"])
def test_a_word_for_a_random_yaw_is_corrected_to_any(workshop, head, word):
    (finding,) = workshop.lint(f"{head}reset: {{place: {{cart: {{z: 0.04 m, yaw: {word}}}}}}}\n")
    assert finding.help.startswith("write the word `any`, or a value")


@pytest.mark.parametrize(
    "word", ["ik", "IK", "inverse_kinematics", "inverse-kinematics", "end_effector", "osc"]
)
def test_a_word_for_inverse_kinematics_is_corrected_to_cartesian(workshop, head, word):
    text = (
        f"{head}robots: {{cart: {{actuators: {{hand: {{type: {word}, link: pole, joints: pole_hinge}}}}}}}}\n"
    )
    (finding,) = (finding for finding in workshop.lint(text) if finding.code == "DB104")
    assert finding.help.startswith("did you mean `cartesian`?")
    assert [edit.text for edit in finding.fix.edits] == ["cartesian"]
    assert not finding.fix.safe


def test_synonyms_name_words_of_the_language_and_are_not_words_themselves():
    words = {*ACTUATORS, *SENSORS, *OBJECTS, *TILES, *ENGINES, "any"}
    assert words.issuperset(synonyms().words)
    for kinds in (tuple(ACTUATORS), tuple(SENSORS), tuple(OBJECTS), tuple(TILES)):
        assert not [kind for kind in kinds if word_for(kind, kinds)]


@pytest.mark.parametrize(
    "line",
    [
        "world: {ground: {COLOR: red}}",
        "world: {arena: {size: 1 1 m, COLOR: red}}",
        "world: {walls: {fence: {points: [0.3 0.3 m, 0.3 0.4 m], height: 10 cm, COLOR: red}}}",
        "world: {lines: {stripe: {points: [0 0 m, 0.3 0 m], width: 2 cm, COLOR: red}}}",
        "robots: {cart: {links: {pole: {COLOR: red}}}}",
        "objects: {ball: {shape: sphere, radius: 5 cm, COLOR: red, pose: {x: 0.3 m, z: 5 cm}}}",
    ],
)
def test_a_british_colour_is_corrected(workshop, head, line):
    (finding,) = (
        finding
        for finding in workshop.lint(f"{head}{line}\n".replace("COLOR", "colour"))
        if finding.code == "DB101"
    )
    assert finding.help == "write `color: red`"
    assert [edit.text for edit in finding.fix.edits] == ["color"]
    assert finding.fix.safe is True
    assert "DB101" not in workshop.codes(f"{head}{line}\n".replace("COLOR", "color"))


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("kuka_iiwa/model.urdf", "kuka_iiwa/model.urdf"),
        ("racecar/racecar.urdf", "racecar/racecar.urdf"),
        ("r2d2", "r2d2.urdf"),
        ("pybullet_data/r2d2.urdf", "r2d2.urdf"),
    ],
)
def test_a_robot_of_pybullet_data_has_a_finding_with_its_reference(workshop, head, written, meant):
    pytest.importorskip("pybullet_data")
    finding = next(
        finding
        for finding in workshop.lint(f"{head}robots: {{cart: {{urdf: {written}}}}}\n")
        if finding.code == "DB204"
    )
    assert finding.help == f"did you mean `package://pybullet_data/{meant}`?"


@pytest.mark.parametrize(
    "written", ["../pybullet/r2d2.urdf", "pybullet_data/../../r2d2.urdf", "no/such.urdf", "x" * 5000]
)
def test_a_file_that_pybullet_data_does_not_have_is_not_suggested(workshop, head, written):
    finding = next(
        finding
        for finding in workshop.lint(f"{head}robots: {{cart: {{urdf: {written}}}}}\n")
        if finding.code == "DB204"
    )
    assert "package://" not in (finding.help or "")


# Wherever a share of something is asked for, `80 %` means `0.8`


SUCCESS = "termination: {success: {there: position(cart).x > 0.3 m}}\n"
LAYOUTS = (
    "reset: {layouts: {left: {cart: {x: -0.1 m, z: 0.04 m}}, right: {cart: {x: 0.1 m, z: 0.04 m}}}, layout: "
)
PLACES = {
    "solved": SUCCESS + "solved: success_rate >= SHARE over 30 episodes",
    "until": SUCCESS
    + "curriculum: [{name: one, until: success_rate >= SHARE over 30 episodes}, {name: two}]",
    "the ground's restitution": "world: {ground: {restitution: SHARE}}",
    "a link's restitution": "robots: {cart: {links: {body: {restitution: SHARE}}}}",
    "an object's restitution": "objects: {ball: {shape: sphere, radius: 5 cm, pose: {x: 1 m}, restitution:"
    " SHARE}}",
    "a drawn share": "objects: {ball: {shape: sphere, radius: 5 cm, pose: {x: 1 m}, restitution: uniform(0"
    " .. SHARE)}}",
    "the reflectance of a line": "world: {lines: {stripe: {points: [0 0 m, 1 0 m], width: 2 cm, reflectance:"
    " SHARE}}}",
    "the lumps of a terrain": "world: {terrain: {type: pit, height: 0.5 m, noise: SHARE}}",
    "the loss of messages": "messages: {to_robot: {loss: SHARE}}",
    "the shares of layouts": LAYOUTS + "{left: SHARE, right: 1 - SHARE}}",
    "a parameter": "parameters: {fall_angle: SHARE * 15 deg}",
    "a condition": "termination: {failure: {lost: cart.pole_angle / rad > SHARE}}",
    "gamma": "train: {gamma: SHARE}",
    "gae_lambda": "train: {gae_lambda: SHARE}",
    "tau": "train: {algorithm: DQN, total_timesteps: 1000, tau: SHARE}",
    "exploration_fraction": "train: {algorithm: DQN, total_timesteps: 1000, exploration_fraction: SHARE}",
    "exploration_initial_eps": "train: {algorithm: DQN, total_timesteps: 1000, exploration_initial_eps:"
    " SHARE}",
    "exploration_final_eps": "train: {algorithm: DQN, total_timesteps: 1000, exploration_final_eps: SHARE}",
}


@pytest.mark.parametrize("place", every(3, PLACES))
def test_a_share_may_be_written_in_percent(workshop, head, place):
    text = f"{head}{PLACES[place]}\n"
    plain, percent, half_of_it = (
        to_json(workshop.compile(text.replace("SHARE", share)).program) for share in ("0.8", "80 %", "0.7")
    )
    assert percent == plain
    assert percent != half_of_it


@pytest.mark.parametrize(
    ("line", "help"),
    [
        ("curriculum: [{name: one, until: success_rate >= 80 over 30 episodes}, {name: two}]", "80 %"),
        ("train: {gamma: 99}", "99 %"),
        ("solved: success_rate >= 80 over 100 episodes", "80 %"),
    ],
)
def test_a_share_in_hundredths_has_a_finding_with_the_percent_sign(workshop, head, line, help):
    finding = next(iter(workshop.lint(f"{head}{SUCCESS}{line}\n")))
    assert finding.code == "DB105"
    assert f"`{help}`" in finding.help


@pytest.mark.parametrize(
    "line", ["train: {gamma: 120 %}", "train: {gamma: -5 %}", "train: {gamma: lots}", "train: {gamma: 1 % 2}"]
)
def test_a_percentage_out_of_bounds_or_none_is_refused(workshop, head, line):
    assert set(workshop.codes(f"{head}{line}\n")) <= {"DB103", "DB105"}
    assert workshop.codes(f"{head}{line}\n")


OF_ISAAC_LAB = {
    "reward: {smooth: {func: mdp.action_rate_l2, weight: -0.01}}": "`jerk: -0.01 * sum(delta(stride, 0)^2)`",
    "reward: {smooth: -0.01 * action_rate_l2}": "`deepbots explain action_rate_l2` shows its line",
    "observation: {policy: {x: -1 .. 1 m, speed: -1 .. 1 m/s}, critic: {tip_speed: -1 .. 1 m/s}}": (
        "list the entries of the policy directly under `observation`"
    ),
    "disturbances: {push: {body: cart, velocity: uniform(-1 -1 0 .. 1 1 0 m/s)}}": (
        "mass * change of velocity / duration"
    ),
    "robots: {cart: {sensors: {pole_angle: {noise: uniform(-0.1 .. 0.1 rad)}}}}": "write `noise: 0.058 rad`",
    "train: {algorithm: PPO, total_timesteps: 1000, num_steps_per_env: 24}": "write `n_steps: 24`",
    "train: {network: {actor_hidden_dims: [64, 64]}}": "write `hidden: [64, 64]`",
    "robots: {cart: {links: {'.*le': {color: red}}}}": "did you mean `*le`?",
    "world: {terrain: {type: tiles, tiles: {up: {type: pyramid_stairs_inv, height: 2 .. 4 cm}}}}": (
        "write `type: stairs, inverted: true`"
    ),
}


@pytest.mark.parametrize(
    ("line", "headline", "help"),
    [
        (
            "train: {algorithm: rsl_rl.PPO, total_timesteps: 1000, num_mini_batches: 4}",
            "the algorithm `rsl_rl.PPO` is gone",
            "write `algorithm: PPO, learning_rate: {kl: 0.01}`",
        ),
        (
            "robots: {cart: {sensors: {gap: {type: radar, link: pole, range: 0 .. 2 m}}}}",
            "the type `radar` is gone",
            "write the value under `augment`: `gap: {value: ground_distance(cart, ball)",
        ),
    ],
)
def test_a_word_that_is_gone_is_one_finding_with_what_to_write_instead(workshop, head, line, headline, help):
    (error,) = (finding for finding in workshop.lint(f"{head}{line}\n") if finding.severity == "error")
    assert (error.code, error.headline) == ("DB104", headline)
    assert help in error.help


@pytest.mark.parametrize("line", OF_ISAAC_LAB)
def test_what_is_written_as_in_isaac_lab_is_one_finding_with_the_line_of_a_scenario(workshop, head, line):
    findings = workshop.lint(f"{head}{line}\n")
    (error,) = (finding for finding in findings if finding.severity == "error" and finding.code != "DB612")
    assert OF_ISAAC_LAB[line] in error.help

"""`deepbots diff`: what two scenarios do not share, by meaning and in the words of the language."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.learning.runs.records import RunRecord
from tests.few import few

SINGLE = [
    ("observation.speed=-1 .. 1 m/s", "policy", "observation.speed"),
    ("agent={frame_stack: 2}", "policy", "agent.frame_stack"),
    ("action.drive.choices.forward=0.5", "policy", "action.drive"),
    ("observation.speed={range: -0.8 .. 0.8 m/s, noise: 0.1 m/s}", "task", "observation.speed.noise"),
    ("augment.x=position(cart).y", "task", "augment.x"),
    ("augment.x={value: position(cart).x, noise: 2 mm}", "task", "augment.x"),
    ("reward.alive=2", "task", "reward.alive"),
    ("truncation.max_steps=300", "task", "truncation.max_steps"),
    ("robots.cart.actuators.wheels.max_torque=5 N*m", "task", "robots.cart.actuators.wheels"),
    ("robots.cart.apply.wheels=2 * drive * wheel_speed", "task", "robots.cart.apply.wheels"),
    ("robots.cart.sensors.pole_angle.noise=1 deg", "task", "robots.cart.sensors.pole_angle"),
    ("robots.cart.emit={pole_angle: 2 * pole_angle}", "task", "robots.cart.emit.pole_angle"),
    ("world.timestep=16 ms", "world", "world.timestep"),
    ("world.gravity=0 0 -1.6 m/s^2", "world", "world.gravity"),
    ("world.arena.size=2 2 m", "world", "world.arena"),
    ("robots.cart.links={pole: {mass: 1 kg}}", "world", "robots.cart.links.pole"),
    ("messages.timing=delayed", "world", "messages.timing"),
    ("messages.to_robot={latency: 40 ms}", "world", "messages.to_robot"),
    ("reset.joints.cart\\.pole_hinge=uniform(-5 .. 5 deg)", "world", "reset.joints.cart.pole_hinge"),
    ("agent={action_repeat: 2}", "world", "agent.action_repeat"),
    ("train.gamma=0.9", "training", "train.gamma"),
    ("train.network.hidden=[32]", "training", "train.network.hidden"),
    ("solved=mean_return >= 100 over 100 episodes", "training", "solved"),
    ("evaluation.episodes=7", "training", "evaluation.episodes"),
    ("evaluation.cases={steep: {set: {fall_angle: 10 deg}}}", "training", "evaluation.cases.steep"),
    ("name=Other", "cosmetic", "name"),
    ("summary=Other words.", "cosmetic", "summary"),
    ("world.arena.color=red", "cosmetic", "look of world.arena"),
]


def differences(deepbots, *words: object) -> tuple[int, dict[tuple[str, str], dict]]:
    ran = deepbots("diff", *words, "--json", code=None)
    assert ran.err == "" or ran.code != 2, ran.err
    report = json.loads(ran.out)
    listed = {(row["group"], row["path"]): row for row in report["differences"]}
    assert report["same_meaning"] is (ran.code == 0)
    assert report["policy_fits"] is not any(group == "policy" for group, _ in listed)
    return ran.code, listed


@pytest.mark.parametrize(
    ("setting", "group", "path"), SINGLE, ids=[setting.partition("=")[0] for setting, _, _ in SINGLE]
)
def test_a_single_setting_is_found_at_its_path_and_in_its_group(deepbots, setting, group, path):
    if "cart\\." in setting:
        (Path("other.yaml")).write_text(
            "deepbots: 1\nextends: cartpole.yaml\nreset: {joints: {cart.pole_hinge: uniform(-5 .. 5 deg)}}\n"
        )
        deepbots("new", "cartpole", "--from", "cartpole", "--json")
        code, rows = differences(deepbots, "cartpole.yaml", "other.yaml")
    else:
        code, rows = differences(deepbots, "cartpole", "cartpole", "--set", setting)
    assert list(rows) == [(group, path)]
    assert code == (0 if group == "cosmetic" else 1)


@pytest.mark.parametrize("name", few(shipped.scenario_names(), ("cartpole", "multi_cartpole", "find_ball")))
def test_a_scenario_has_no_difference_to_itself(deepbots, name):
    ran = deepbots("diff", name, name)
    assert ran.out == f"{name} and {name} have the same meaning\n"


VARIANTS = {
    ("pit_escape", "pit_escape_as_printed"): {
        "task": {"reward.progress"},
        "training": {"solved", "train.total_timesteps"},
    },
    ("find_and_avoid", "find_and_avoid_unmasked"): {
        "task": {"action.change.forbid"},
        "training": {"train.algorithm"},
    },
}


@pytest.mark.parametrize(("one", "other"), VARIANTS)
def test_variants_differ_in_what_they_were_made_for(deepbots, one, other):
    code, rows = differences(deepbots, one, other)
    assert code == 1
    expected = {(group, path) for group, paths in VARIANTS[one, other].items() for path in paths}
    assert {key for key in rows if key[0] != "cosmetic"} == expected
    assert {path for group, path in rows if group == "cosmetic"} == {"name", "summary"}


def test_a_longer_pole_no_longer_fits_and_is_another_world(deepbots):
    _, rows = differences(deepbots, "cartpole", "cartpole_long")
    assert rows["policy", "observation.tip_speed"]["other"] == "-3 .. 3 m/s"
    assert ("world", "robots.cart.links.pole") in rows
    assert not any(group == "task" for group, _ in rows)


@pytest.mark.slow
def test_every_pair_of_shipped_variants_is_the_same_from_both_sides(deepbots):
    pairs = [
        ("find_ball", "find_ball_as_printed"),
        ("cartpole", "cartpole_wireless"),
        ("cartpole", "cartpole_continuous"),
    ]
    for first, second in pairs:
        _, forth = differences(deepbots, first, second)
        _, back = differences(deepbots, second, first)
        assert set(forth) == set(back)
        assert api.compile(first).digest != api.compile(second).digest
        assert any(group != "cosmetic" for group, _ in forth)
        opposite = {"added": "removed", "removed": "added", "changed": "changed"}
        assert all(back[key]["kind"] == opposite[row["kind"]] for key, row in forth.items())


def test_another_order_of_what_the_policy_sees_does_not_fit(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    text = (tmp_path / "cartpole.yaml").read_text(encoding="utf-8")
    line = "  x:               -0.4 .. 0.4 m\n"
    (tmp_path / "turned.yaml").write_text(
        text.replace(line, "").replace("\nreward:", f"{line}\nreward:", 1), encoding="utf-8"
    )
    _, rows = differences(deepbots, "cartpole.yaml", "turned.yaml")
    assert list(rows) == [("policy", "order of what is observed, done and sent")]


REORDERED = {
    "  time:   -0.05\n  found:  10 when found\n": "  found:  10 when found\n  time:   -0.05\n",
    "  path: path_distance(epuck, ball)            # around the box\n  here: position(epuck)\n": (
        "  here: position(epuck)\n  path: path_distance(epuck, ball)\n"
    ),
    "    ball:  {x: 38 cm, y: 38 cm}\n": "    ball:  {y: 38 cm, x: 38 cm}\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("old", REORDERED, ids=["reward", "signals", "coordinates"])
def test_the_order_of_keys_is_not_a_difference_in_the_task(deepbots, tmp_path, old):
    deepbots("new", "find_ball", "--from", "find_ball", "--json")
    text = (tmp_path / "find_ball.yaml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "other.yaml").write_text(text.replace(old, REORDERED[old]), encoding="utf-8")
    code, rows = differences(deepbots, "find_ball.yaml", "other.yaml")
    assert (code, set(rows)) in ((0, {("cosmetic", "order of keys")}), (0, set()))
    assert "not written" not in deepbots("diff", "find_ball.yaml", "other.yaml").out


def test_the_order_in_which_bodies_look_for_a_place_makes_other_starts(deepbots, tmp_path):
    deepbots("new", "find_ball", "--from", "find_ball", "--json")
    text = (tmp_path / "find_ball.yaml").read_text(encoding="utf-8")
    ball, box = "    ball:  {x: 38 cm, y: 38 cm}\n", "    box:   {yaw: 45 deg}\n"
    (tmp_path / "other.yaml").write_text(text.replace(ball + box, box + ball), encoding="utf-8")
    _, rows = differences(deepbots, "find_ball.yaml", "other.yaml")
    assert list(rows) == [("world", "order of reset.place")]
    assert rows["world", "order of reset.place"]["other"] == "box, ball, epuck"


def test_what_is_written_as_the_default_is_shown_on_both_sides(deepbots):
    _, rows = differences(deepbots, "pit_escape", "pit_escape", "--set", "agent.frame_stack=1")
    (row,) = rows.values()
    assert (row["kind"], row["one"], row["other"]) == ("changed", "2", "1")


def test_a_color_and_a_drawn_number_are_shown_as_they_are_written(deepbots):
    _, rows = differences(
        deepbots, "see_ball", "see_ball", "--set", "objects.ball.color=choice(green | orange)"
    )
    (row,) = rows.values()
    assert (row["one"], row["other"]) == ("choice(yellow | orange)", "choice(green | orange)")
    _, rows = differences(
        deepbots, "cartpole", "cartpole", "--set", "robots.cart.links={pole: {mass: uniform(0.1 .. 0.2 kg)}}"
    )
    assert rows["world", "robots.cart.links.pole.mass"]["other"] == "uniform(0.1 .. 0.2 kg)"


def test_a_number_that_differs_in_the_last_digit_means_the_same(deepbots):
    code, rows = differences(
        deepbots, "cartpole", "cartpole", "--set", "robots.cart.links={tip: {mass: 0.020000000000000004 kg}}"
    )
    assert code == 0
    assert {group for group, _ in rows} == {"cosmetic"}


def test_a_number_that_differs_in_the_sixth_digit_is_a_difference(deepbots):
    _, rows = differences(deepbots, "cartpole", "cartpole", "--set", "world.ground={friction: 1.000001}")
    (row,) = rows.values()
    assert row["other"] == "{friction: 1.000001}"


def test_the_group_of_a_difference_is_the_same_from_both_sides(deepbots):
    for pair in (("find_ball", "see_ball"), ("see_ball", "find_ball")):
        _, rows = differences(deepbots, *pair)
        assert ("world", "look of objects.ball") in rows


def test_a_value_on_several_lines_is_shown_without_its_comments(deepbots):
    _, rows = differences(deepbots, "cartpole", "pit_escape")
    metric = rows["task", "signals.metric"]["other"]
    assert metric.startswith("hold(0.5 * reach / radius if reach < radius else 0.5 + 0.5 *")
    assert "#" not in metric


def test_a_default_that_only_one_has_is_shown_with_its_numbers(deepbots):
    _, rows = differences(deepbots, "cartpole", "pit_escape")
    assert rows["world", "world.ground"]["one"] == "kind ground, friction 1, restitution 0"
    assert rows["world", "world.ground"]["other"] == ""


def test_a_link_that_only_one_has_is_named_without_its_inside(deepbots):
    output = deepbots("diff", "cartpole", "pit_escape", code=1).out
    assert "  robots.cart.links.pole\n    - (not written)\n" in output
    assert "  robots.roller.links.ball\n    + " in output
    assert "inertial" not in output


def test_a_changed_number_of_a_link_is_shown(deepbots, tmp_path):
    deepbots("new", "quadrotor", "--from", "quadrotor", "--json")
    (tmp_path / "other").mkdir()
    deepbots("new", "quadrotor", "other", "--from", "quadrotor", "--json")
    robot = tmp_path / "other" / "robots" / "urdf" / "quadrotor.urdf"
    robot.write_text(
        robot.read_text(encoding="utf-8").replace('mass value="', 'mass value="1', 1), encoding="utf-8"
    )
    _, rows = differences(deepbots, "quadrotor.yaml", "other/quadrotor.yaml")
    ((key, row),) = rows.items()
    assert key == ("world", "robots.drone.links.base_link")
    assert row["one"].startswith("inertial.mass 0.0")
    assert row["other"].startswith("inertial.mass 10.0")


def test_colors_count_where_a_camera_sees_them(deepbots):
    _, rows = differences(deepbots, "see_ball", "see_ball", "--set", "objects.ball.color=green")
    assert {group for group, _ in rows} == {"world"}


def test_stages_and_cases_are_compared_by_what_they_change(deepbots, tmp_path):
    head = "deepbots: 1\nextends: cartpole.yaml\ncurriculum:\n"
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    for name, angle in (("one", 25), ("two", 20)):
        stages = (
            f"  - {{name: wide, set: {{fall_angle: {angle} deg}}, until: mean_return >= 150 over 20"
            f" episodes}}\n  - {{name: usual}}\n"
        )
        (tmp_path / f"{name}.yaml").write_text(head + stages)
    _, rows = differences(deepbots, "one.yaml", "two.yaml")
    assert list(rows) == [("training", "curriculum.wide")]
    assert "25 deg" in rows["training", "curriculum.wide"]["one"]


@pytest.mark.slow
def test_a_run_is_compared_with_the_file_it_was_trained_on(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    deepbots(
        "train",
        "cartpole.yaml",
        "--run",
        "run",
        "--set",
        "train.total_timesteps=512",
        "--set",
        "evaluation.episodes=1",
    )
    assert isinstance(RunRecord.read(tmp_path / "run").digest, str)
    _, rows = differences(deepbots, "run", "cartpole.yaml")
    assert set(rows) == {("training", "train.total_timesteps"), ("training", "evaluation.episodes")}
    assert rows["training", "train.total_timesteps"]["one"] == "512"


def test_the_start_of_each_group_of_joints_is_compared(deepbots, tmp_path):
    """Of two entries for one robot, only the last was compared."""
    deepbots("new", "push", "--from", "panda_push", "--json")
    text = (tmp_path / "push.yaml").read_text(encoding="utf-8")
    both = text.replace("joints: {panda.arm: low}", "joints: {panda.arm: low, panda.fingers: 1 cm}")
    assert both != text
    (tmp_path / "both.yaml").write_text(both)
    (tmp_path / "other.yaml").write_text(both.replace("panda_joint2: 12.5 deg", "panda_joint2: 13.5 deg"))
    _, rows = differences(deepbots, "push.yaml", "both.yaml")
    ((key, row),) = rows.items()
    assert key == ("world", "reset.joints.panda.fingers")
    assert row["kind"] == "added"
    assert row["one"] == ""
    assert row["other"] == "1 cm"
    _, rows = differences(deepbots, "both.yaml", "other.yaml")
    ((key, row),) = rows.items()
    assert key == ("world", "reset.joints.panda.arm")
    assert row["through"] == {"the pose low": ["{panda_joint2: 12.5 deg}", "{panda_joint2: 13.5 deg}"]}

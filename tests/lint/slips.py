"""The most frequent slips of a beginner: one change of a scenario that works, or one command line, and what
the message must say.

Each slip names the place (`at`), and in `says` words of the reason and the line to write. `python -m
tests.lint.slips` prints all of them with the messages.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from difflib import unified_diff
from io import StringIO
from pathlib import Path

from deepbots_cli.cli import main
from deepbots_cli.document import shipped

ROBOTS = {"cartpole": "cartpole", "quadruped": "a1"}
LINT = ("lint", "mine.yaml")
RUN = {"runs/mine-0-1/run.json": "{}"}


def original(name: str) -> str:
    """The text of a shipped scenario."""
    return Path(str(shipped.scenario_path(name))).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Slip:
    """A slip and the parts of its message.

    Attributes:
        name: What was done.
        at: The place that the message names: a line and column of the scenario, or empty for a command line.
        says: The reason and the line to write, as parts of the message.
        edits: Pairs of a text of the scenario and what is written instead.
        command: The words after `deepbots`.
        of: The shipped scenario that was copied.
        path: Where the copy lies.
        files: Further files, by their paths, with their text.
        folder: The folder in which the command runs.
        is_copied_by_hand: Whether the scenario was copied without its robot, so that its paths lead nowhere.
    """

    name: str
    at: str
    says: tuple[str, ...]
    edits: tuple[tuple[str, str], ...] = ()
    command: tuple[str, ...] = LINT
    of: str = "cartpole"
    path: str = "mine.yaml"
    files: Mapping[str, str] = field(default_factory=dict)
    folder: str = "."
    is_copied_by_hand: bool = False

    def __str__(self) -> str:
        return self.name

    @property
    def original(self) -> str:
        return (
            original(self.of)
            if self.is_copied_by_hand
            else original(self.of).replace("../robots/", "robots/")
        )

    def text(self) -> str:
        """The scenario with the slip."""
        text = self.original
        for old, new in self.edits:
            assert text.count(old) == 1, f"{self.name}: {old!r} is {text.count(old)} times in {self.of}"
            text = text.replace(old, new)
        return text

    def write(self, project: Path) -> Path:
        """Write the scenario, its robot and the further files into a folder; return the folder of the
        command."""
        if not self.is_copied_by_hand:
            robots = project / "robots" / "urdf"
            robots.mkdir(parents=True)
            shutil.copy(Path(str(shipped.robot_path(ROBOTS[self.of]))), robots)
        for name, text in {self.path: self.text(), **self.files}.items():
            (project / name).parent.mkdir(parents=True, exist_ok=True)
            (project / name).write_text(text, encoding="utf-8")
        (project / self.folder).mkdir(parents=True, exist_ok=True)
        return project / self.folder


def lint(name: str, at: str, says: tuple[str, ...], *edits: tuple[str, str], of: str = "cartpole") -> Slip:
    return Slip(name, at, says, edits, of=of)


SUBSTEPS, STEPS, ALIVE = "  substeps: 4\n", "max_steps: 200", "  alive: 1\n"
JOINTS = "  joints: {cart.pole_hinge"
TRAIN = original("cartpole").partition("\n\ntrain:")[2].partition("\n\ntests:")[0].join(("train:", "\n"))
TRAIN_SET = ("train", "mine.yaml", "--set")


def placed(pose: str) -> tuple[str, str]:
    return JOINTS, f"  place: {{cart: {{{pose}}}}}\n{JOINTS}"


SLIPS = (
    # folders and command lines
    Slip("in_another_folder", "", ("did you mean ../mine.yaml?", "The current folder is"), folder="work"),
    Slip(
        "above_the_folder",
        "",
        ("did you mean project/mine.yaml?", "The current folder is"),
        path="project/mine.yaml",
    ),
    Slip(
        "folder_named_from_inside",
        "",
        ("did you mean mine.yaml?",),
        command=("lint", "hw/mine.yaml"),
        path="hw/mine.yaml",
        folder="hw",
    ),
    Slip("run_without_runs", "", ("did you mean runs/mine-0-1?",), command=("eval", "mine-0-1"), files=RUN),
    Slip(
        "run_from_another_folder",
        "",
        ("did you mean ../runs/mine-0-1?",),
        command=("view", "runs/mine-0-1"),
        files=RUN,
        folder="work",
    ),
    Slip(
        "run_that_is_not_there",
        "",
        ("its runs, the newest first, are runs/mine-0-1",),
        command=("eval", "runs/mine-0-2"),
        files=RUN,
    ),
    Slip(
        "run_before_training",
        "",
        ("it has no runs", "`deepbots train SCENARIO`"),
        command=("eval", "runs/mine-0-2"),
    ),
    Slip("scenario_without_yaml", "", ("did you mean mine.yaml?",), command=("train", "mine")),
    Slip("scenario_misspelt", "", ("did you mean mine.yaml?",), command=("train", "mien.yaml")),
    Slip(
        "eval_before_training",
        "",
        ("is a scenario, and not a run", "`deepbots train mine.yaml`"),
        command=("eval", "mine.yaml"),
    ),
    Slip(
        "robot_file_for_scenario",
        "",
        ("is a robot file", "`deepbots new cartpole --urdf robots/urdf/cartpole.urdf`"),
        command=("train", "robots/urdf/cartpole.urdf"),
    ),
    Slip(
        "seed_that_is_no_number",
        "--seed",
        ("'abc' is not a whole number", "0 or 42"),
        command=("train", "mine.yaml", "--seed", "abc"),
    ),
    Slip(
        "command_misspelt",
        "",
        ("no command 'trian'", "did you mean 'train'?"),
        command=("trian", "mine.yaml"),
    ),
    Slip(
        "set_lr",
        "--set",
        ("unknown key `lr`", "write `--set train.learning_rate=1e-3`"),
        command=(*TRAIN_SET, "train.lr=1e-3"),
    ),
    Slip(
        "set_with_a_colon",
        "--set",
        ("--set train.learning_rate=1e-3",),
        command=(*TRAIN_SET, "train.learning_rate: 1e-3"),
    ),
    Slip(
        "engine_misspelt_on_the_command_line",
        "--engine",
        ("no engine 'bullet'", "did you mean 'pybullet'?"),
        command=("train", "mine.yaml", "--engine", "bullet"),
    ),
    # YAML
    lint(
        "indented_too_little",
        "12:2",
        ("indented by 1", "indented by 2 spaces", "`  substeps: 4`"),
        (SUBSTEPS, " substeps: 4\n"),
    ),
    lint(
        "indented_too_much",
        "12:5",
        ("deeper than `timestep`", "`  substeps: 4`"),
        (SUBSTEPS, "    substeps: 4\n"),
    ),
    lint(
        "first_key_not_indented",
        "11:1",
        ("not indented below `world`", "`  timestep: 32 ms`"),
        ("  timestep: 32 ms", "timestep: 32 ms"),
    ),
    lint("tab", "12:1", ("a tab in the indentation", "`  substeps: 4`"), (SUBSTEPS, "\tsubsteps: 4\n")),
    lint(
        "section_without_colon",
        "47:1",
        ("a line without a key", "`truncation:`"),
        (f"truncation: {{{STEPS}}}", f"truncation\n  {STEPS}"),
    ),
    lint(
        "key_without_colon", "12:3", ("a line without a key", "`substeps: 4`"), (SUBSTEPS, "  substeps 4\n")
    ),
    lint(
        "no_space_after_colon",
        "12:3",
        ("a space after the colon", "`substeps: 4`"),
        (SUBSTEPS, "  substeps:4\n"),
    ),
    lint(
        "no_space_after_colon_in_braces",
        "47:14",
        ("a space after the colon", "`max_steps: 200`"),
        (STEPS, "max_steps:200"),
    ),
    lint(
        "list_for_mapping",
        "41:3",
        ("expected a mapping, found a list", "write `alive: 1`, not `- alive: 1`"),
        (ALIVE, "  - alive: 1\n"),
    ),
    lint(
        "one_key_twice",
        "42:3",
        ("`alive` is given twice", "first defined here"),
        (ALIVE, ALIVE + "  alive: 2\n"),
    ),
    lint("brace_not_closed", "47:13", ("is not closed", "`}`"), (f"{{{STEPS}}}", f"{{{STEPS}")),
    # numbers and units
    lint(
        "angle_for_angular_velocity",
        "22:21",
        ("8 |   wheel_speed", "must be an angular velocity", "`wheel_speed: 60 deg/s`"),
        ("5 rad/s", "60 deg"),
    ),
    lint(
        "speed_for_angular_velocity",
        "22:21",
        (
            "8 |   wheel_speed",
            "must be an angular velocity",
            "`wheel_speed: 5 rad/s`",
            "here 2 cm: `wheels: drive * wheel_speed / 2 cm * rad`",
        ),
        ("5 rad/s", "5 m/s"),
    ),
    lint("seconds_for_milliseconds", "11:13", ("the timestep is 32 s", "`32 ms`"), ("32 ms", "32 s")),
    lint("no_unit", "11:13", ("a number without a unit", "`32 ms`"), ("32 ms", "32")),
    lint("unit_misspelt", "8:18", ("unknown unit `rads`", "`rad`"), ("5 rad/s", "5 rads/s")),
    lint(
        "number_with_exponent_in_quotes",
        "61:18",
        ("expected a number", "`5e-3` without quotes"),
        (" 5e-3", ' "5e-3"'),
    ),
    lint(
        "count_in_quotes",
        "47:25",
        ("expected a whole number", "`200` without quotes"),
        (STEPS, 'max_steps: "200"'),
    ),
    lint("decimal_comma", "61:18", ("decimals need a point", "`0.005`"), (" 5e-3", " 0,005")),
    lint("decimal_comma_before_a_unit", "7:17", ("a comma in a number", "`0.39`"), ("0.39 m", "0,39 m")),
    lint("decimal_comma_in_braces", "50:21", ("a comma inside brackets", "`1.5 cm`"), placed("y: 1,5 cm")),
    lint("steps_with_exponent", "56:20", ("expected a whole number", "`1_000_000`"), ("100_000", "1e6")),
    lint(
        "plain_number_minus_area",
        "41:10",
        ("without a unit", "`alive: 1 - x^2 / m^2`"),
        (ALIVE, "  alive: 1 - x^2\n"),
    ),
    # names and places
    lint(
        "joint_without_robot",
        "50:12",
        ("no joint `pole_hinge`", "`cart.pole_hinge`"),
        ("joints: {cart.pole", "joints: {pole"),
    ),
    lint("pose_at", "50:18", ("unknown key `at`", "`xyz: 0 0 1 m`"), placed("at: 0 0 1 m")),
    lint("pose_pos", "50:18", ("unknown key `pos`", "`xyz: 0 0 1 m`"), placed("pos: 0 0 1 m")),
    lint(
        "pose_position_as_list",
        "50:18",
        ("unknown key `position`", "`xyz: 0 0 1 m`"),
        placed("position: [0, 0, 1]"),
    ),
    lint(
        "pose_orientation",
        "50:18",
        ("unknown key `orientation`", "`rpy: 0 0 90 deg`"),
        placed("orientation: 0 0 90 deg"),
    ),
    lint("rewards", "40:1", ("unknown key `rewards`", "`reward:`"), ("reward:\n", "rewards:\n")),
    lint("obs", "34:1", ("unknown key `obs`", "`observation:`"), ("observation: ", "obs: ")),
    lint(
        "observations",
        "34:1",
        ("unknown key `observations`", "`observation:`"),
        ("observation: ", "observations: "),
    ),
    lint(
        "ending_one_level_up",
        "44:5",
        ("unknown key `fallen`", "add the line `  success:` or `  failure:` above it"),
        ("  failure:\n", ""),
    ),
    lint(
        "success_not_defined",
        "52:9",
        (
            "needs a success",
            "`success: {lasted: time > 6.08 s}`",
            "`solved: mean_return >= 100 over 100 episodes`",
        ),
        ("mean_return >= 195", "success_rate >= 90 %"),
    ),
    lint(
        "solved_without_episodes",
        "52:9",
        ("how many episodes", "`success_rate >= 90 % over 100 episodes`"),
        ("mean_return >= 195 over 100 episodes", "success_rate >= 90 %"),
    ),
    lint(
        "engine_at_the_top_level",
        "3:1",
        ("unknown key `engine`", "remove it here", "write `  engine: mujoco` below `world:` (line 11)"),
        ("name: CartPole\n", "name: CartPole\nengine: mujoco\n"),
    ),
    lint(
        "group_misspelt",
        "27:41",
        ("no group or actuator `dog.leg`", "`dog.legs`"),
        ("each: dog.legs", "each: dog.leg"),
        of="quadruped",
    ),
    lint(
        "group_of_joints_misspelt",
        "19:44",
        ("no joint `leg`", "did you mean `legs`?"),
        ("{type: joint_position, joints: legs", "{type: joint_position, joints: leg"),
        of="quadruped",
    ),
    lint(
        "robot_misspelt", "31:23", ("unknown name `crat`", "`cart`"), ("velocity(cart).x", "velocity(crat).x")
    ),
    lint(
        "sensor_misspelt",
        "37:3",
        ("unknown name `cart.pole_angel`", "`cart.pole_angle`"),
        ("cart.pole_angle: -20", "cart.pole_angel: -20"),
    ),
    lint(
        "sensor_without_robot",
        "37:3",
        ("unknown name `pole_angle`", "`cart.pole_angle`"),
        ("  cart.pole_angle: -20", "  pole_angle: -20"),
    ),
    lint(
        "function_misspelt",
        "31:14",
        ("unknown function `velocty`", "`velocity`"),
        ("velocity(cart).x", "velocty(cart).x"),
    ),
    lint(
        "joint_that_does_not_exist",
        "19:49",
        ("no joint `pole_joint`", "`pole_hinge`"),
        ("joint_position, joint: pole_hinge", "joint_position, joint: pole_joint"),
    ),
    lint(
        "sensor_of_another_tool",
        "19:26",
        ("unknown type `encoder`", "`joint_position`"),
        ("type: joint_position", "type: encoder"),
    ),
    lint(
        "base_fixed_true",
        "18:5",
        ("unknown key `fixed`", "`base: fixed`"),
        ("    sensors:\n", "    fixed: true\n    sensors:\n"),
    ),
    # formulas
    lint(
        "and_as_in_c",
        "45:50",
        ("`&&` in an expression", "write `and`"),
        ("> fall_angle\n", "> fall_angle && x > 0 m\n"),
    ),
    lint(
        "assignment_for_comparison",
        "42:22",
        ("`=` in an expression", "`==`"),
        (ALIVE, ALIVE + "  fast: 1 when drive = 1\n"),
    ),
    lint(
        "bars_for_absolute_value",
        "46:16",
        ("`|` does not mean the absolute value", "`abs(x) > track`"),
        ("abs(x) > track", "|x| > track"),
    ),
    lint(
        "bars_inside_a_formula",
        "46:20",
        ("`|` does not mean the absolute value", "`2 * abs(x) > track`"),
        ("abs(x) > track", "2 * |x| > track"),
    ),
    lint(
        "two_stars_for_power",
        "41:21",
        ("`**` in an expression", "`a ^ b`"),
        (ALIVE, "  alive: 1 - (x / m)**2\n"),
    ),
    lint(
        "question_mark",
        "41:10",
        ("form of another language", "`0 if fallen else 1`"),
        (ALIVE, "  alive: fallen ? 0 : 1\n"),
    ),
    lint(
        "if_as_in_c",
        "41:10",
        ("form of another language", "`0 if fallen else 1`"),
        (ALIVE, "  alive: if (fallen) 0 else 1\n"),
    ),
    lint(
        "if_as_in_python",
        "41:10",
        ("form of another language", "`0 if fallen else 1`"),
        (ALIVE, "  alive: if fallen: 0 else: 1\n"),
    ),
    lint(
        "function_of_a_module",
        "41:10",
        ("`math.cos` is not a function", "`cos(...)`"),
        (ALIVE, "  alive: math.cos(cart.pole_angle)\n"),
    ),
    # files
    lint(
        "robot_file_in_another_folder",
        "17:11",
        ("does not exist", "did you mean robots/urdf/cartpole.urdf?"),
        ("robots/urdf/", "robots/"),
    ),
    Slip(
        "robot_file_outside_of_the_project",
        "17:11",
        (
            "lies outside the project",
            "create the empty file deepbots.toml",
            "add `--allow-path arms` to the command",
            "write `arms/arm.urdf`",
        ),
        (("robots/urdf/cartpole.urdf", "../arms/arm.urdf"),),
        ("lint", "hw/mine.yaml"),
        path="hw/mine.yaml",
        files={"arms/arm.urdf": "<robot/>"},
    ),
    Slip(
        "scenario_copied_elsewhere",
        "17:11",
        ("lies outside the project", "write `cartpole`", "shipped with deepbots"),
        command=("lint", "hw/hw1.yaml"),
        path="hw/hw1.yaml",
        is_copied_by_hand=True,
    ),
    lint(
        "extends_of_a_missing_file",
        "3:10",
        ("`base.yaml` does not exist", "remove this line, or write the path of a scenario that exists"),
        ("name: CartPole\n", "name: CartPole\nextends: base.yaml\n"),
    ),
    Slip(
        "extends_of_another_scenario",
        "3:10",
        ("`base.yaml` does not exist", "(first.yaml)"),
        (("name: CartPole\n", "name: CartPole\nextends: base.yaml\n"),),
        files={"first.yaml": "deepbots: 1\n"},
    ),
    lint(
        "package_of_ros",
        "17:11",
        ("no package `cartpole_description`", "`robots/urdf/cartpole.urdf`"),
        ("urdf: robots", "urdf: package://cartpole_description"),
    ),
    # training
    Slip(
        "train_is_a_word",
        "54:8",
        ("expected a mapping", "`{algorithm: PPO, total_timesteps: 100_000}`"),
        ((TRAIN, "train: PPO\n"),),
    ),
    lint(
        "algorithm_in_lower_case",
        "55:14",
        ("unknown algorithm `ppo`", "`PPO`"),
        ("algorithm: PPO", "algorithm: ppo"),
    ),
    lint(
        "algorithm_for_other_actions",
        "55:14",
        (
            "SAC supports only continuous actions",
            "write `algorithm: PPO`, which uses `n_epochs`",
            "`drive: -1 .. 1`",
            "remove this line to keep `algorithm: SAC`",
        ),
        ("algorithm: PPO", "algorithm: SAC"),
    ),
    lint(
        "steps",
        "56:3",
        ("unknown key `steps`", "`total_timesteps: 1_000_000`"),
        ("total_timesteps: 100_000", "steps: 1e6"),
    ),
    lint(
        "episodes",
        "56:3",
        ("unknown key `episodes`", "`total_timesteps: 100_000`", "steps of a training"),
        ("total_timesteps: 100_000", "episodes: 1000"),
    ),
    lint("lr", "61:3", ("unknown key `lr`", "`learning_rate: 5e-3`"), ("learning_rate", "lr")),
    lint(
        "engine_that_does_not_exist",
        "13:11",
        ("unknown word `bullet`", "`pybullet`"),
        (SUBSTEPS, SUBSTEPS + "  engine: bullet\n"),
    ),
)


def show(slip: Slip, folder: Path) -> str:
    """A slip as text: what was changed, the command, and what it prints."""
    changes = unified_diff(slip.original.splitlines(), slip.text().splitlines(), lineterm="", n=1)
    lines = [f"    {line}" for line in changes if not line.startswith(("---", "+++", "@@"))]
    lines += [f"    (also there: {name})" for name in slip.files]
    lines += [f"    (the scenario is {slip.path})"] if slip.path != "mine.yaml" else []
    start = f"cd {slip.folder} && " if slip.folder != "." else ""
    with chdir(slip.write(folder)), redirect_stdout(StringIO()) as out, redirect_stderr(out):
        code = main(list(slip.command))
    said = out.getvalue().rstrip().replace(str(folder.resolve()), "/home/ann/project")
    lines += [f"$ {start}deepbots {' '.join(slip.command)}", said, f"(exit status {code})", ""]
    return "\n".join([f"=== {slip.name}", *lines])


if __name__ == "__main__":
    wanted = sys.argv[1:]
    for chosen in SLIPS:
        if not wanted or any(word in chosen.name for word in wanted):
            with tempfile.TemporaryDirectory() as temporary:
                print(show(chosen, Path(temporary)))

"""The most frequent slips of a beginner: one change of a scenario that works, or one command line, and what the message must say.

`write` makes the folder that a slip needs, as `deepbots new mine --from ...` would.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from deepbots_cli.document import shipped

ROBOTS = {"cartpole": "cartpole.urdf", "quadruped": "a1.urdf"}


@dataclass(frozen=True)
class Slip:
    """A slip and the parts of its message.

    Attributes:
        name: What was done.
        edits: Pairs of a text of the scenario and what is written instead.
        says: What the message contains: the place, the reason, and the line to write.
        command: The words after `deepbots`.
        of: The shipped scenario that `mine.yaml` is a copy of.
        files: Further files, by their paths, with their text.
        at: The folder in which the command runs.
    """

    name: str
    edits: tuple[tuple[str, str], ...]
    says: tuple[str, ...]
    command: tuple[str, ...] = ("lint", "mine.yaml")
    of: str = "cartpole"
    files: Mapping[str, str] = field(default_factory=dict)
    at: str = "."

    def __str__(self) -> str:
        return self.name

    def text(self) -> str:
        """The scenario with the slip."""
        text = original(self.of)
        for old, new in self.edits:
            assert text.count(old) == 1, f"{self.name}: {old!r} is {text.count(old)} times in {self.of}"
            text = text.replace(old, new)
        return text

    def write(self, folder: Path) -> Path:
        """Write the scenario as mine.yaml, its robot and the further files into a folder; return the folder of the command."""
        robots = folder / "robots" / "urdf"
        robots.mkdir(parents=True)
        shutil.copy(Path(str(shipped.robot_path(ROBOTS[self.of].removesuffix(".urdf")))), robots)
        (folder / "mine.yaml").write_text(self.text(), encoding="utf-8")
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        (folder / self.at).mkdir(parents=True, exist_ok=True)
        return folder / self.at


def original(name: str) -> str:
    """The text of a shipped scenario, as `deepbots new` copies it."""
    return Path(str(shipped.scenario_path(name))).read_text(encoding="utf-8").replace("../robots/", "robots/")


LINT = ("lint", "mine.yaml")
SLIPS = (
    # folders and command lines
    Slip("wrong_folder", (), (), at="work"),
    Slip("run_without_runs", (), (), ("eval", "mine-0-1"), files={"runs/mine-0-1/run.json": "{}"}),
    Slip("run_from_within_folder", (), (), ("view", "runs/mine-0-1"), files={"runs/mine-0-1/run.json": "{}"}, at="work"),
    Slip("train_without_yaml", (), (), ("train", "mine")),
    Slip("eval_before_training", (), (), ("eval", "mine.yaml")),
    Slip("seed_is_no_number", (), (), ("train", "mine.yaml", "--seed", "abc")),
    Slip("set_misspelt", (), (), ("train", "mine.yaml", "--set", "train.lr=1e-3")),
    Slip("set_with_colon", (), (), ("train", "mine.yaml", "--set", "train.learning_rate: 1e-3")),
    Slip("engine_misspelt", (), (), ("train", "mine.yaml", "--engine", "bullet")),
    Slip("command_misspelt", (), (), ("trian", "mine.yaml")),
    Slip("urdf_given_to_train", (), (), ("train", "robots/urdf/cartpole.urdf")),
    # YAML
    Slip("indented_less", (("  substeps: 4\n", " substeps: 4\n"),), ()),
    Slip("indented_more", (("  substeps: 4\n", "    substeps: 4\n"),), ()),
    Slip("not_indented", (("  timestep: 32 ms\n", "timestep: 32 ms\n"),), ()),
    Slip("tab", (("  substeps: 4\n", "\tsubsteps: 4\n"),), ()),
    Slip("colon_missing", (("truncation: {max_steps: 200}", "truncation\n  max_steps: 200"),), ()),
    Slip("colon_missing_value", (("  substeps: 4\n", "  substeps 4\n"),), ()),
    Slip("colon_without_space", (("  substeps: 4\n", "  substeps:4\n"),), ()),
    Slip("colon_without_space_in_braces", (("{max_steps: 200}", "{max_steps:200}"),), ()),
    Slip("list_for_mapping", (("reward:\n  alive: 1\n", "reward:\n  - alive: 1\n"),), ()),
    Slip("two_keys_of_one_name", (("  alive: 1\n", "  alive: 1\n  alive: 2\n"),), ()),
    Slip("brace_not_closed", (("{max_steps: 200}", "{max_steps: 200"),), ()),
    Slip("if_with_colon", (("  alive: 1\n", "  alive: if fallen: 0 else: 1\n"),), ()),
    # units and numbers
    Slip("angle_for_speed", (("wheel_speed: 5 rad/s", "wheel_speed: 60 deg"),), ()),
    Slip("speed_of_wheel_in_m_per_s", (("wheel_speed: 5 rad/s", "wheel_speed: 5 m/s"),), ()),
    Slip("seconds_for_milliseconds", (("timestep: 32 ms", "timestep: 32 s"),), ()),
    Slip("no_unit", (("timestep: 32 ms", "timestep: 0.032"),), ()),
    Slip("exponent_in_quotes", (("learning_rate: 5e-3", 'learning_rate: "5e-3"'),), ()),
    Slip("decimal_comma_number", (("learning_rate: 5e-3", "learning_rate: 0,005"),), ()),
    Slip("decimal_comma_unit", (("track:       0.39 m", "track:       0,39 m"),), ()),
    Slip("decimal_comma_in_braces", (("  joints: {cart.pole_hinge", "  place: {cart: {y: 1,5 cm}}\n  joints: {cart.pole_hinge"),), ()),
    Slip("unit_without_space", (("timestep: 32 ms", "timestep: 32ms"),), ()),
    Slip("unit_unknown", (("wheel_speed: 5 rad/s", "wheel_speed: 5 rads/s"),), ()),
    Slip("number_in_quotes", (("max_steps: 200", 'max_steps: "200"'),), ()),
    Slip("steps_as_float", (("total_timesteps: 100_000", "total_timesteps: 1e6"),), ()),
    Slip("percent_without_over", (("solved: mean_return >= 195 over 100 episodes", "solved: success_rate >= 90 %"),), ()),
    # names
    Slip("joint_without_robot", (("joints: {cart.pole_hinge:", "joints: {pole_hinge:"),), ()),
    Slip("pose_at", (("  joints: {cart.pole_hinge", "  place: {cart: {at: 0 0 1 m}}\n  joints: {cart.pole_hinge"),), ()),
    Slip("pose_pos", (("  joints: {cart.pole_hinge", "  place: {cart: {pos: 0 0 1 m}}\n  joints: {cart.pole_hinge"),), ()),
    Slip("pose_position", (("  joints: {cart.pole_hinge", "  place: {cart: {position: [0, 0, 1]}}\n  joints: {cart.pole_hinge"),), ()),
    Slip("pose_orientation", (("  joints: {cart.pole_hinge", "  place: {cart: {orientation: 0 0 90 deg}}\n  joints: {cart.pole_hinge"),), ()),
    Slip("rewards", (("reward:\n  alive", "rewards:\n  alive"),), ()),
    Slip("obs", (("observation:   ", "obs:   "),), ()),
    Slip("observations", (("observation:   ", "observations:   "),), ()),
    Slip("actions", (("action:\n", "actions:\n"),), ()),
    Slip("leg_for_legs", (("each: dog.legs", "each: dog.leg"),), (), of="quadruped"),
    Slip("robot_misspelt", (("velocity(cart).x", "velocity(crat).x"),), ()),
    Slip("sensor_misspelt", (("  cart.pole_angle: -20", "  cart.pole_angel: -20"),), ()),
    Slip("sensor_without_robot", (("  cart.pole_angle: -20", "  pole_angle: -20"),), ()),
    Slip("function_misspelt", (("velocity(cart).x", "velocty(cart).x"),), ()),
    Slip("name_of_gym", (("truncation: {max_steps: 200}", "truncation: {max_episode_steps: 200}"),), ()),
    Slip("failure_one_level_up", (("termination:\n  failure:\n    fallen:    abs", "termination:\n    fallen:    abs"), ("    off_track: abs(x)", "    off_track: abs(x)")), ()),
    Slip("success_missing", (("solved: mean_return >= 195 over 100", "solved: success_rate >= 90 % over 100"),), ()),
    Slip("sensor_type_wrong", (("type: joint_position, joint: pole_hinge", "type: encoder, joint: pole_hinge"),), ()),
    Slip("joint_unknown", (("joint_position, joint: pole_hinge", "joint_position, joint: pole_joint"),), ()),
    Slip("gamma_under_ppo", (("  gamma: 0.98\n", "  discount: 0.98\n"),), ()),
    Slip("lr", (("  learning_rate: 5e-3\n", "  lr: 5e-3\n"),), ()),
    Slip("episodes", (("total_timesteps: 100_000", "episodes: 1000"),), ()),
    # formulas
    Slip("and_as_in_c", (("abs(cart.pole_angle) > fall_angle", "abs(cart.pole_angle) > fall_angle && x > 0 m"),), ()),
    Slip("or_as_in_c", (("abs(cart.pole_angle) > fall_angle", "abs(cart.pole_angle) > fall_angle || x > 0 m"),), ()),
    Slip("equals_sign", (("  alive: 1\n", "  alive: 1\n  fast: 1 when drive = 1\n"),), ()),
    Slip("bars_for_abs", (("    off_track: abs(x) > track", "    off_track: |x| > track"),), ()),
    Slip("bars_for_abs_inside", (("    off_track: abs(x) > track", "    off_track: x > track or |x| > track"),), ()),
    Slip("caret_with_unit", (("  alive: 1\n", "  alive: 1 - x^2\n"),), ()),
    Slip("double_star", (("  alive: 1\n", "  alive: 1 - (x / m)**2\n"),), ()),
    Slip("question_mark", (("  alive: 1\n", "  alive: fallen ? 0 : 1\n"),), ()),
    Slip("if_in_c", (("  alive: 1\n", "  alive: if (fallen) 0 else 1\n"),), ()),
    Slip("if_as_in_c_braces", (("  alive: 1\n", "  alive: if (fallen) { 0 } else { 1 }\n"),), ()),
    Slip("math_sin", (("  alive: 1\n", "  alive: math.cos(cart.pole_angle)\n"),), ()),
    Slip("np_abs", (("abs(cart.pole_angle) > fall_angle", "np.abs(cart.pole_angle) > fall_angle"),), ()),
    # files
    Slip("urdf_wrong", (("urdf: robots/urdf/cartpole.urdf", "urdf: robots/cartpole.urdf"),), ()),
    Slip("urdf_outside", (("urdf: robots/urdf/cartpole.urdf", "urdf: ../../robots/urdf/cartpole.urdf"),), (), ("lint", "hw/mine.yaml")),
    Slip("copied_elsewhere", (), (), ("lint", "hw.yaml"), files={"hw.yaml": "@cartpole"}),
    Slip("extends_missing", (("name: CartPole\n", "name: CartPole\nextends: base.yaml\n"),), ()),
    Slip("package_missing", (("urdf: robots/urdf/cartpole.urdf", "urdf: package://cartpole_description/urdf/cartpole.urdf"),), ()),
    Slip("package_of_pybullet", (("urdf: robots/urdf/cartpole.urdf", "urdf: pybullet_data/cartpole.urdf"),), ()),
    # kinds of training
    Slip("train_is_a_word", (("train:\n  algorithm: PPO\n", "train: PPO\nextra:\n"),), ()),
    Slip("algorithm_lower_case", (("algorithm: PPO", "algorithm: ppo"),), ()),
    Slip("algorithm_unfit", (("algorithm: PPO", "algorithm: SAC"),), ()),
    Slip("steps_for_timesteps", (("total_timesteps: 100_000", "steps: 1e6"),), ()),
    Slip("engine_unknown", (("  substeps: 4\n", "  substeps: 4\n  engine: bullet\n"),), ()),
    Slip("engine_at_top_level", (("name: CartPole\n", "name: CartPole\nengine: mujoco\n"),), ()),
)

"""A plug-in that is installed is known to every part of deepbots, without a change in it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from deepbots_cli.cli import main

ROOT = Path(__file__).parents[2]
PACKAGE = Path(__file__).with_name("package")


def installed(folder: Path, groups: dict[str, dict[str, str]], name: str = "acme") -> None:
    """Write what pip writes beside an installed package."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [
        line
        for group, entries in groups.items()
        for line in (f"[{group}]", *(f"{key} = {value}" for key, value in entries.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder in which the metadata of the package is installed; not to be changed."""
    folder = tmp_path_factory.mktemp("site")
    installed(folder, tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"])
    return folder


def python(folder, *arguments):
    """Runs Python in the folder, with the package and its metadata on the path."""
    path = os.pathsep.join(map(str, (folder, PACKAGE, ROOT)))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=folder, env=environment, check=False
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def deepbots(folder, *arguments):
    return python(folder, "-m", "deepbots_cli", *arguments)


ONE_AFTER_ANOTHER = """
import contextlib, io, json, sys
from deepbots_cli.cli import main
for line in sys.argv[1:]:
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(json.loads(line))
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""


@pytest.fixture(scope="module")
def answers(site):
    """The exit code, stdout and stderr of each command line of this module that changes nothing, all from one
    process."""
    lines = [
        *(("lint", name) for name in ("acme_spin", "acme_throttle")),
        ("inspect", "acme_spin"),
        ("scenarios", "--json"),
        *(lint("acme_spin", change) for change, _, _ in MISTAKES),
        *(lint("acme_throttle", change) for change, _, _ in ACTUATOR_MISTAKES),
        *(("explain", word) for word in ("ACME1", *WORDS)),
        IGNORED,
    ]
    done = python(site, "-c", ONE_AFTER_ANOTHER, *map(json.dumps, lines))
    return dict(zip(lines, map(json.loads, done.stdout.splitlines()), strict=True))


def lint(name, change):
    return ("lint", name, "--preview", "--set", change, "--format", "json")


@pytest.mark.parametrize("name", ["acme_spin", "acme_throttle"])
def test_a_scenario_of_a_plugin_is_found_by_name_and_has_no_findings(answers, name):
    assert answers["lint", name] == [0, f"{name}: no findings\n", ""]


def test_a_scenario_of_a_plugin_is_inspected_and_listed(answers):
    assert "AcmeSpin" in answers["inspect", "acme_spin"][1]
    listed = json.loads(answers["scenarios", "--json"][1])
    assert "acme_spin" in [row["name"] for row in listed["scenarios"]]


def test_lint_of_a_plugin_imports_no_simulator(site):
    script = (
        "import sys; from deepbots_cli.api import lint; lint('acme_spin'); print({'numpy', 'pybullet',"
        " 'torch'} & sys.modules.keys())"
    )
    assert python(site, "-c", script).stdout == "set()\n"


MISTAKES = [
    ("robots.spinner.sensors.pulses.spacing=5 kg", "DB503", "`spacing`"),
    ("robots.spinner.sensors.pulses.spacing=-1 deg", "DB105", "`spacing`"),
    ("robots.spinner.sensors.pulses.direction=bth", "DB104", "unknown word `bth`"),
    ("robots.spinner.sensors.pulses.spacng=1 deg", "DB101", "spacng"),
    ("messages.format=pipes", "DB104", "unknown word `pipes`"),
    ("truncation.max_steps=5", "ACME1", "episodes of 5 steps"),
    (
        "evaluation={cases: {a: {set: {truncation.max_steps: 5}}}}",
        "ACME1",
        "in case `a`, episodes of 5 steps",
    ),
    ("train.algorithm=ChoicePPO", "DB612", "`ChoicePPO` supports only discrete actions"),
]
ACTUATOR_MISTAKES = [
    ("robots.spinner.actuators.axle.stall_torque=5 kg", "DB503", "`stall_torque`"),
    ("robots.spinner.actuators.axle.idle_speed=0 rad/s", "DB105", "`idle_speed`"),
    ("robots.spinner.actuators.axle.stall=5 N*m", "DB101", "stall"),
    ("robots.spinner.actuators.axle.type=throtle", "DB104", "unknown type `throtle`"),
    ("robots.spinner.actuators.axle.joint=axel", "DB302", "axel"),
    ("robots.spinner.actuators.axle.max_torque=2 N*m", "DB304", "a limit of"),
    ("robots.spinner.apply.axle=voltage * 5 N", "DB503", "the target of `axle`"),
    ("action.voltage=-100 .. 100", "DB312", "`axle` receives commands of"),
]


@pytest.mark.parametrize(("change", "code", "headline"), MISTAKES)
def test_mistakes_in_what_a_plugin_adds_are_found_at_their_place(answers, change, code, headline):
    findings = json.loads(answers[lint("acme_spin", change)][1])["findings"]
    assert any(finding["code"] == code and headline in json.dumps(finding) for finding in findings)


@pytest.mark.parametrize(("change", "code", "headline"), ACTUATOR_MISTAKES)
def test_mistakes_in_an_actuator_of_a_plugin_are_found_at_their_place(answers, change, code, headline):
    findings = json.loads(answers[lint("acme_throttle", change)][1])["findings"]
    assert any(finding["code"] == code and headline in json.dumps(finding) for finding in findings)


IGNORED = ("lint", "acme_spin", "--set", "truncation.max_steps=5", "--ignore", "ACME1")


def test_a_finding_of_a_plugin_is_explained_and_can_be_ignored(answers):
    assert "Most of them is the reset." in answers["explain", "ACME1"][1]
    assert answers[IGNORED][1].startswith("acme_spin: no findings")


def test_the_schema_has_the_kinds_and_their_parameters(site):
    schema = json.loads(
        python(
            site, "-c", "from deepbots_cli.scenario.json_schema import schema_text; print(schema_text())"
        ).stdout
    )
    tachometer = schema["$defs"]["acme.sensors.Tachometer"]
    assert "The way between two pulses." in tachometer["properties"]["spacing"]["description"]
    assert tachometer["properties"]["direction"]["enum"] == ["both", "forward"]
    throttle = schema["$defs"]["acme.actuators.Throttle"]
    assert "without a load" in throttle["properties"]["idle_speed"]["description"]
    assert {"joint", "joints", "max_torque", "strength", "delay", "time_constant"} < set(
        throttle["properties"]
    )
    text = json.dumps(schema)
    assert "A DC motor whose torque falls" in text
    assert "Counts the pulses of a disc on a joint" in text
    assert '"piped"' in text
    assert "acme.algorithms.GentlePPO" in schema["$defs"]


WORDS = {
    "tachometer": "Counts the pulses of a disc on a joint",
    "spacing": "The way between two pulses.",
    "throttle": "A DC motor whose torque falls with its speed",
    "idle_speed": "Speed at full voltage without a load.",
    "halved": "Half of x.",
    "GentlePPO": "PPO that makes three passes",
}


@pytest.mark.parametrize(("word", "text"), WORDS.items())
def test_explain_explains_the_words_of_plugins(answers, word, text):
    assert text in answers["explain", word][1]


def test_editors_are_offered_kinds_and_parameters(site):
    script = """
from deepbots_cli.lsp.hover import describe_key
from deepbots_cli.scenario.documentation import section_description
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.base import shape_at
data = {"robots": {"r": {"sensors": {"s": {"type": "tachometer"}}, "actuators": {"a": {"type": "throttle"}}}}}
for section, name, kind, key in (("sensors", "s", "tachometer", "spacing"), ("actuators", "a", "throttle", "stall_torque")):
    path = ("robots", "r", section, name)
    kinds = shape_at(Scenario, data, path, choose=False)
    print(kind in kinds.names, section_description(kinds.models[kind]))
    print(describe_key(shape_at(Scenario, data, path), key))
"""
    output = python(site, "-c", script).stdout
    assert output.startswith("True Counts the pulses")
    assert "True A DC motor whose torque falls" in output
    assert "**stall_torque**: a torque or a force" in output
    assert "**spacing**: an angle or a length" in output
    assert "**Default:** `1 deg`" in output


def test_an_environment_runs_with_sensor_format_function_and_engine(site):
    script = """
import json
import deepbots_cli
env = deepbots_cli.make("acme_spin", engine="counting")
env.reset(seed=0)
for _ in range(50):
    seen = env.step([1.0])[0]
print(json.dumps([float(seen[0]), type(env.engine).__name__]))
"""
    done = python(site, "-c", script)
    observation, engine = json.loads(done.stdout)
    # 10 rad/s, halved, in pulses of half a degree: 5 / 0.00873 = 573 of 1000.
    assert observation == pytest.approx(0.573, abs=0.01), done.stderr
    assert engine == "Counting"


THROTTLED = """
import json
import sys
import deepbots_cli
from deepbots_cli import api
assert "self.drive_axle = self.actuator('axle')" in api.compile("acme_throttle").code.replace('"', "'")
for sets in json.loads(sys.argv[1]):
    env = deepbots_cli.make("acme_throttle", overrides=sets)
    env.reset(seed=0)
    print(json.dumps([float(env.step([0.5])[0][0]) * 20.0 for _ in range(60)]))
"""
DRIVES = [("1", "0 ms"), ("uniform(0.4 .. 0.5)", "0 ms"), ("1", "100 ms")]
"""The strength and the delay of an actuator."""


@pytest.fixture(scope="module")
def driven(site):
    """The speeds of the wheel in rad/s, step by step, for each of `DRIVES`; all from one process."""
    place = "robots.spinner.actuators.axle"
    overrides = [[f"{place}.strength={strength}", f"{place}.delay={delay}"] for strength, delay in DRIVES]
    done = python(site, "-c", THROTTLED, json.dumps(overrides))
    return dict(zip(DRIVES, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize(("strength", "delay"), DRIVES)
def test_an_actuator_of_a_plugin_drives_with_strength_and_delay(driven, strength, delay):
    speeds = driven[strength, delay]
    # The wheel follows the law: inertia * dw/dt = strength * stall * (share - w / idle), so with w = share *
    # idle in the end, and a time constant of inertia * idle / (strength * stall) = 0.001 * 10.47 / 0.2 = 52
    # ms at full strength.
    late = 5 if delay != "0 ms" else 0
    assert all(abs(speed) < 1e-9 for speed in speeds[:late])
    assert speeds[-1] == pytest.approx(0.5 * 10.472, rel=0.02)
    share = speeds[late + 2] / (0.5 * 10.472)  # after 60 ms
    assert 0.5 < share < 0.8 if strength == "1" else 0.25 < share < 0.5


@pytest.mark.slow
def test_the_algorithm_of_a_plugin_trains_with_its_default_and_one_without_tensors_is_refused(site):
    script = """
from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import train
from deepbots_cli.learning.sb3 import algorithms, defaults
program = api.compile("acme_spin").program
print({entry.name: entry.value for entry in program.agent.training.hyperparameters}, algorithms.check(program.agent.training))
print([entry.value for entry in defaults.effective_hyperparameters(program, 1000) if entry.name == "n_epochs"])
try:
    train(api.compile("acme_spin", overrides=["train.algorithm=NoTensors"]), run="refused")
except UsageError as error:
    print(error)
"""
    first, second, refusal = python(site, "-c", script).stdout.splitlines()
    assert (first, second) == ("{'n_epochs': 3} None", "[3]")
    assert refusal.startswith(
        "NoTensors (acme.training:Elsewhere) does not keep its networks as PPO of Stable-Baselines3 does"
    )
    assert not (site / "refused").exists()


def test_a_run_names_the_package_that_its_scenario_needs(site, tmp_path, capsys):
    brief = ("--timesteps", "64", "--set", "evaluation={episodes: 2}")
    deepbots(site, "train", "acme_spin", *brief, "--run", str(tmp_path / "run"))
    assert json.loads((tmp_path / "run" / "run.json").read_text())["plugins"] == {"acme": "1.0"}
    assert main(["eval", str(tmp_path / "run")]) == 2  # here, the package is not installed
    assert "its training used acme 1.0, so install that" in capsys.readouterr().err


KILLED = """
import os, signal, sys
from acme.cem import CrossEntropyMethod
from deepbots_cli.cli import main
from deepbots_cli.learning import checkpoints
checkpoints.INTERVAL_S = checkpoints.MIN_INTERVAL_PER_COST = 0
class Killed(CrossEntropyMethod):
    def update(self):
        super().update()
        if self.steps >= 1_500:
            os.kill(os.getpid(), signal.SIGKILL)
sys.modules["acme.cem"].CrossEntropyMethod = Killed
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_learner_of_a_plugin_is_trained_evaluated_killed_and_resumed_by_the_same_commands(site):
    pytest.importorskip("stable_baselines3")
    from deepbots_cli.learning.runs.episodes import read_log

    task = site / "cem.yaml"
    train = (
        "train: {algorithm: CrossEntropy, total_timesteps: 2_500, environments: 4}\nevaluation:"
        " {episodes: 10}\n"
    )
    shipped = (
        (ROOT / "scenarios" / "cartpole.yaml").read_text().replace("../robots/urdf/cartpole.urdf", "cartpole")
    )
    shipped = shipped.replace("world:\n", "world:\n  engine: mujoco\n", 1)  # steps it four times as fast
    task.write_text(shipped[: shipped.index("train:\n")] + train)
    assert (
        python(
            site, "-c", KILLED, "train", "cem.yaml", "--run", "parts", "--full", "--logger", "csv"
        ).returncode
        == -9
    )
    lines = [
        ("resume", "parts"),
        ("train", "cem.yaml", "--run", "whole", "--full", "--logger", "csv"),
        *(("eval", name, "--last", "--json") for name in ("whole", "parts")),
        ("train", "cem.yaml", "--run", "refused", "--set", "train.normalize=reward"),
        ("train", "cem.yaml", "--run", "refused", "--shards", "2"),
        ("train", "cem.yaml", "--run", "refused", "--callback", "impatient"),
    ]
    done = python(site, "-c", ONE_AFTER_ANOTHER, *map(json.dumps, lines))
    resumed, whole, *evaluated, normalizing, sharded, calling = map(json.loads, done.stdout.splitlines())
    assert [resumed[0], whole[0]] == [0, 0], (resumed, whole)
    results = [json.loads((site / name / "run.json").read_text())["result"] for name in ("whole", "parts")]
    assert [result["steps"] for result in results] == [2_560, 2_560]
    assert results[1]["inexact"] == []
    assert results[0]["weights_digest"] == results[1]["weights_digest"]
    logs = [[row | {"t": ""} for row in read_log(site / name / "monitor.csv")] for name in ("whole", "parts")]
    assert logs[0] == logs[1]
    scalars = [
        [
            line
            for line in (site / name / "logs" / "scalars.csv").read_text().splitlines()
            if ",time/" not in line
        ]
        for name in ("whole", "parts")
    ]
    assert scalars[0] == scalars[1]
    assert any("cem/best_return" in line for line in scalars[0])
    returns = [json.loads(out)["mean_return"] for _, out, _ in evaluated]
    assert returns[0] == returns[1] > 40  # random actions come to about 20
    assert "CrossEntropy does not normalize rewards" in normalizing[2]
    assert "CrossEntropy does not support shards; leave out `shards` under `train`" in sharded[2]
    assert (
        "callbacks work only with the built-in algorithms; leave out --callback to train with CrossEntropy"
        in calling[2]
    )
    assert not (site / "refused").exists()


BROKEN = [
    ("deepbots.sensors", "pulse = no_such_module:Pulse", "No module named 'no_such_module'"),
    (
        "deepbots.sensors",
        "pulse = json:loads",
        "is not a subclass of JointSensor, LinkSensor or ContactSensor",
    ),
    ("deepbots.sensors", "pulse = acme.sensors:Tachometer", 'needs the field `type: Literal["pulse"]`'),
    ("deepbots.sensors", "gyro = deepbots_cli.scenario.sensors:Gyro", "the name 'gyro' is taken"),
    ("deepbots.actuators", "jet = json:loads", "is not a subclass of JointActuator"),
    (
        "deepbots.actuators",
        "jet = deepbots_cli.scenario.actuators:TorqueMotor",
        'needs the field `type: Literal["jet"]`',
    ),
    ("deepbots.formats", "pipe = json:loads", "is not a MessageFormat"),
    ("deepbots.rules", "pipe = json:loads", "TypeError"),
    ("deepbots.algorithms", "Mine = json:loads", "is derived from none of PPO"),
    ("deepbots.scenarios", "pipe = no_such_module", "there is no package no_such_module"),
]
UNKNOWN = (
    "robots.cart.sensors.pole_angle.type=pulze",
    "robots.cart.actuators.wheels.type=jett",
    "messages.format=pipes",
    "train.algorithm=Own",
)


@pytest.fixture(scope="module")
def warnings(tmp_path_factory):
    """The lines about plug-ins that are not available, where all broken ones are installed; rules run where
    nothing else is wrong."""
    lines = []
    for rules in (False, True):
        folder = tmp_path_factory.mktemp("broken")
        for number, (group, entry, _) in enumerate(BROKEN):
            if (group == "deepbots.rules") is rules:
                key, _, value = entry.partition(" = ")
                installed(folder, {group: {key: value}}, f"acme{number}")
        done = deepbots(
            folder,
            "lint",
            "cartpole",
            *(word for change in UNKNOWN if not rules for word in ("--set", change)),
        )
        assert done.returncode == (0 if rules else 1)
        lines += [line for line in done.stderr.splitlines() if "are not available" in line]
    return lines


@pytest.mark.slow
def test_each_broken_plugin_has_one_warning(warnings):
    assert len(warnings) == len(BROKEN)


@pytest.mark.parametrize(("group", "entry", "reason"), BROKEN)
def test_a_broken_plugin_is_left_out_with_one_warning(warnings, group, entry, reason):
    key, _, value = entry.partition(" = ")
    start = f"warning: the {group.partition('.')[2]} '{key}' ({value}) are not available: "
    (warning,) = [line for line in warnings if line.startswith(start)]
    assert reason in warning


BROKEN_AT_RUN_TIME = """
import deepbots_cli
from deepbots_cli.plugins import import_attribute

for run in (lambda: deepbots_cli.make("cartpole", engine="odd"), lambda: import_attribute("acme:piped")):
    try:
        run()
    except Exception as error:
        print(error)
"""


def test_a_broken_engine_or_function_of_a_plugin_is_an_error_of_one_line(tmp_path):
    installed(tmp_path, {"deepbots.engines": {"odd": "no_such_module:Odd"}})
    tmp_path.joinpath("acme.py").touch()
    assert python(tmp_path, "-c", BROKEN_AT_RUN_TIME).stdout == (
        "the engines 'odd' (no_such_module:Odd) are not available: ModuleNotFoundError: No module"
        " named 'no_such_module'\n"
        f"a plug-in names 'acme:piped', but {tmp_path / 'acme.py'} has no 'piped'\n"
    )


@pytest.fixture(scope="module")
def added(tmp_path_factory):
    """A folder with a package of scenarios and robots alone."""
    folder = tmp_path_factory.mktemp("added")
    for place, files in {"scenarios": ("first", "cart.v2"), "robots/urdf": ("own_cart",)}.items():
        (folder / "carts" / place).mkdir(parents=True)
        shipped = (
            next((ROOT / place).glob("cartpole.*")).read_text().replace("cartpole.urdf", "own_cart.urdf")
        )
        for name in files:
            suffix = ".yaml" if place == "scenarios" else ".urdf"
            (folder / "carts" / place / f"{name}{suffix}").write_text(shipped)
    (folder / "carts" / "scenarios" / "latin.yaml").write_bytes(b"extends: cartpole\nsummary: Caf\xe9.\n")
    installed(folder, {"deepbots.scenarios": {"carts": "carts"}}, "carts")
    return folder


def test_a_scenario_of_a_plugin_that_is_not_utf_8_does_not_hide_the_others(added):
    done = deepbots(added, "explain", "cartpole")
    assert (done.returncode, "cartpole: a shipped scenario" in done.stdout) == (0, True)
    copied = deepbots(added, "new", "mine", "--from", "latin")
    assert (copied.returncode, "latin.yaml:2:13: the file is not UTF-8 text" in copied.stderr) == (2, True)


def test_each_name_in_the_list_of_scenarios_is_the_name_of_one(added):
    listed = deepbots(added, "scenarios", "--json").stdout
    assert "cart.v2" in [row["name"] for row in json.loads(listed)["scenarios"]]
    assert deepbots(added, "lint", "cart.v2").stdout == "cart.v2: no findings\n"


def test_a_copy_of_a_scenario_of_a_plugin_comes_with_its_robot(added, tmp_path):
    assert deepbots(added, "new", "mine", tmp_path, "--from", "first").returncode == 0
    assert (tmp_path / "robots" / "urdf" / "own_cart.urdf").is_file()
    assert main(["lint", str(tmp_path / "mine.yaml")]) == 0  # here, the package is not installed


def test_a_part_of_a_scenario_of_a_plugin_is_copied_by_its_command(added, tmp_path):
    (tmp_path / "part.yaml").write_text("deepbots: 1\ninclude: ../scenarios/first.yaml\n")
    assert (
        "copies a shipped scenario with all its files"
        in deepbots(added, "lint", tmp_path / "part.yaml").stdout
    )


HOVER = """
from pathlib import Path
from lsprotocol.types import Position
from deepbots_cli.lsp.hover import hover
from deepbots_cli.lsp.workspace import Document, Workspace
text = "deepbots: 1  # deepbots: ignore[ACME1]"
workspace = Workspace()
workspace.put(Document("file:///a.yaml", 1, text, Path("a.yaml")))
print(hover(workspace.view("file:///a.yaml", Position(0, text.index("ACME1")))).contents.value)
"""


def test_the_hover_of_the_code_of_a_rule_is_its_page(site):
    pytest.importorskip("lsprotocol")
    assert "**ACME1** short-episodes" in python(site, "-c", HOVER).stdout

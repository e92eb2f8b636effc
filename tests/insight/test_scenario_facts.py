"""What a diagnosis says of the scenario of a run: findings of lint, conditions that are missed, what changed since
a run that was solved, the command that trains it again, and the changes that a phrase asks for.
"""

from __future__ import annotations

import html
import json
import shutil
from contextlib import closing
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.insight.report import Report
from deepbots_cli.insight.scenario_facts import ScenarioFacts, linted_scenario, training_command
from deepbots_cli.insight.stages import common_miss
from deepbots_cli.insight.statements import quantity_text
from deepbots_cli.insight.suggestions import Suggestion, suggestions
from deepbots_cli.insight.trace import Trace, TraceRecorder, instrument_program
from deepbots_cli.insight.training import read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.records import write_record
from deepbots_cli.learning.runs.run import Run
from tests.insight.logs import (
    SHUTTLE,
    causes_of,
    outcomes,
    returns_of,
    statement_of,
    train_shuttle,
    with_logs,
)

"""Being at the mark pays in every step, and the success, which ends the episode, asks for staying there."""


def _played(run: Run, actions: list[float], mark: float) -> Trace:
    """An episode of the carriage with these actions."""
    watch = instrument_program(run.program, include_observation=True)
    with closing(TraceRecorder(api.build(watch.program, engine="mujoco"), watch)) as world:
        world.reset(seed=4, options={"mark": mark})
        for action in actions:
            if any(world.step(np.array([action], np.float32))[2:4]):
                break
        return world.trace("an episode")


# The reward against the success


SLOW = (
    "termination.success={parked: abs(gap) < near and abs(joint_velocity(shuttle.slide)) < 2 mm/s and"
    " step > 5}"
)


def test_the_condition_that_all_failed_episodes_miss_is_in_the_verdict_over_the_run(tmp_path):
    """`speed < 0.2 m/s` in 1 of 84 moments was only in `diagnose --episode failed`, and the advice for the
    run was to continue."""
    run = Run.open(train_shuttle(tmp_path, SLOW))
    drives = [0.8] * 12 + [1, -1] * 24  # to the mark, and never slow there
    failed = [_played(run, drives, mark) for mark in (0.2, 0.21, 0.22, 0.23)]
    assert {trace.outcome for trace in failed} == {"time limit"}
    missed = common_miss(failed)
    assert missed is not None
    assert (missed.condition.text, missed.episodes, missed.of) == (
        "abs(joint_velocity(shuttle.slide)) < 2 mm/s",
        4,
        4,
    )
    good = outcomes(400, 0.5, 0.5)
    training = with_logs(run.path, returns_of(good, 0), np.full(400, 60), success=good)
    statement = statement_of(replace(training, failed=failed), "missed_condition")
    assert f"in {missed.true} of {missed.moments} moments; the nearest value is" in statement.text
    assert "and the threshold 2 mm/s" in statement.text
    assert statement.advice.startswith("Reward what brings")
    assert "`abs(gap) < near` is true in" in statement.text


# Lint as a cause


@pytest.mark.slow
def test_lint_as_a_cause_says_that_falling_early_pays_and_names_the_file_of_the_user(tmp_path, monkeypatch):
    """It read "Lint reports 1 warning", and its command named the copy in the run, which a student then
    edited."""
    monkeypatch.chdir(tmp_path)
    text = api.compile("cartpole", overrides=["reward.alive=-1"]).resolved
    own = tmp_path / "mine.yaml"
    own.write_text(
        text.replace("inputs/robots", str(Path(api.compile("cartpole").source).parents[1] / "robots"))
    )
    monkeypatch.chdir(tmp_path)
    run = train(api.compile("mine.yaml"), total_timesteps=64, seed=2, run=Path("run")).run
    noise = np.random.default_rng(0).normal(0, 3, 200)
    lint = statement_of(with_logs(run, -30 + noise, 30 - noise), "lint_warns")
    assert lint.text.startswith("Failing early pays: continuing an episode costs at least ")
    assert "Lint reports" not in lint.text
    assert lint.command == f"deepbots lint {own}"
    assert main(lint.command.split()[1:]) == 0
    own.write_text(own.read_text() + "# changed\n")
    copy = statement_of(with_logs(run, -30 + noise, 30 - noise), "lint_warns")
    assert copy.command == "deepbots lint run/inputs/mine.yaml"
    assert f"It is the copy that the training read: {own} was changed since then." in copy.advice


@pytest.mark.slow
def test_a_folder_is_allowed_only_where_the_copy_reads_beyond_its_own(short, tmp_path):
    """`--allow-path climb1/inputs` was advised where it was not needed."""
    run = Run.open(short)
    assert linted_scenario(run).arguments == "cartpole"
    moved = replace(run, record=run.record.model_copy(update={"source": "gone.yaml"}))
    arguments = linted_scenario(moved).arguments
    assert (
        arguments == f"{short}/inputs/scenarios/cartpole.yaml --allow-path {short}/inputs"
    )  # it names ../robots
    own = Run.open(train(SHUTTLE, total_timesteps=64, run=tmp_path / "run").run)
    gone = replace(own, record=own.record.model_copy(update={"source": "gone.yaml"}))
    assert linted_scenario(gone).arguments == f"{tmp_path}/run/inputs/shuttle.yaml"


def test_a_report_has_the_causes_of_an_unsolved_training(carriage, tmp_path):
    run = Path(shutil.copytree(carriage, tmp_path / "run"))
    assert main(["eval", str(run), "--episodes", "9"]) == 0
    report = Report.read(run)
    report.find_causes()
    assert "too_few_steps" in [each.cause for each in report.causes]
    page = report.html()
    assert "Why it is not solved" in page
    assert report.causes[0].text.split(".")[0] in page


@pytest.mark.slow
def test_the_line_of_a_finding_in_a_report_is_that_of_the_listing_below(tmp_path):
    hit = "termination.failure={hit: abs(shuttle.place) > 0.49 m}"
    warned = train_shuttle(tmp_path, "reward.time=-2", hit)
    assert main(["eval", str(warned), "--episodes", "9"]) == 0
    page = Report.read(warned).html()
    linted = linted_scenario(Run.open(warned))
    own = [finding.span for finding in linted.findings if finding.span.source is linted.text]
    assert own
    for span in own:
        line = span.start_position.line
        shown = html.escape(span.source.line(line)).replace("&#x27;", "&#39;")
        assert f'<span class="marked"><b>{line}</b>{shown}</span>' in page


# The observation


def test_a_parameter_in_the_observation_is_not_a_sensor_that_detects_nothing(tmp_path):
    """`vx` always 0.5 m/s."""
    run = train_shuttle(tmp_path, "augment.wish=speed", "observation.wish=0 .. 1 m/s")
    training = read_training(Run.open(run))
    run_probes(training)
    # 0.5 m/s is the middle of the range.
    assert {float(trace.observations[0, -1]) for trace in training.random} == {0.0}
    assert "sensor_without_reading" not in causes_of(training)


@pytest.mark.parametrize(
    "successes", ["{far: abs(x) > 0.3 m, hit: collided(cart)}", "{hit: collided(cart), far: abs(x) > 0.3 m}"]
)
def test_terms_towards_any_of_the_successes_count(successes):
    rewards = ["reward={near: abs(x) / m, bump: 1 when collided(cart)}"]
    compiled = api.compile("cartpole", overrides=[*rewards, f"termination.success={successes}"])
    facts = ScenarioFacts(compiled.program, compiled.units)
    assert set(facts.terms_towards_success) == {"near", "bump"}


def test_a_value_is_shown_in_the_unit_of_the_file():
    sets = ["observation.x=-40 .. 40 cm", "parameters.fall_angle=0.2 rad"]
    compiled = api.compile("cartpole", overrides=sets)
    facts = ScenarioFacts(compiled.program, compiled.units)
    numbers = {number.full_name: number for number in compiled.program.agent.numbers}
    assert (
        facts.range_text(numbers["x"], 0.25),
        facts.range_text(numbers["cart.pole_angle"], np.pi / 6),
    ) == ("25 cm", "30 deg")
    assert facts.units.of("rad", "abs(cart.pole_angle)", "fall_angle") == UNITS["rad"]
    assert (quantity_text(0.003, facts.units.of("m/s", "3 mm/s")), facts.units.of("m", "no unit").text) == (
        "3 mm/s",
        "m",
    )


# What changed since a solved run


SHORT = (
    SHUTTLE.read_text("utf-8")
    .replace("environments: 16", "environments: 2")
    .replace("n_steps: 64", "n_steps: 32")
)
TEXT = f"""{SHORT}
solved: success_rate >= 50 % over 20 episodes
"""
EASY = TEXT.replace("near:  4 cm", "near:  5 m")
HARD = TEXT.replace("near:  4 cm", "near:  0.1 mm").replace("  time: ", "  bonus: 0.001\n  time: ")


def _trained(folder: Path, name: str, text: str, *options: str) -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(SHUTTLE.with_name("shuttle.urdf"), folder)
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    run = folder / "runs" / name
    options = ("--timesteps", "128", *options)
    assert main(["train", str(folder / "mine.yaml"), "--run", str(run), "--quiet", *options]) == 0
    return run


def _causes(run: Path, capsys) -> list[dict]:
    capsys.readouterr()
    assert main(["diagnose", str(run), "--only-logs", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["runs"][0]["causes"]


@pytest.fixture(scope="module")
def easy(tmp_path_factory) -> Path:
    """A project with a run that solved its scenario; not to be changed."""
    return _trained(tmp_path_factory.mktemp("easy"), "solved", EASY).parents[1]


@pytest.fixture
def solved(easy, tmp_path) -> Path:
    shutil.copytree(easy, tmp_path, dirs_exist_ok=True)
    return tmp_path / "runs" / "solved"


def test_what_changed_since_a_solved_run_is_named_with_its_places(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", HARD)
    shown = capsys.readouterr().out
    causes = _causes(run, capsys)
    (cause,) = (cause for cause in causes if cause["cause"] == "changed_since_solved")
    # The earlier run needed no more steps, so the length of the training is not a cause.
    assert "too_few_steps" not in {other["cause"] for other in causes}
    lines = HARD.splitlines()
    places = [f"mine.yaml:{lines.index(line) + 1}" for line in ("  bonus: 0.001", "  near:  0.1 mm")]
    assert cause["text"] == (
        f"Changed since runs/solved, which was solved: reward.bonus (none) -> 0.001 ({places[0]})"
        f" and near 5 m -> 0.1 mm ({places[1]})."
    )
    assert cause["text"] in " ".join(shown.split())
    assert "most likely cause: Changed" not in shown
    assert cause["command"] == f"deepbots diff {Path('runs/solved')} {Path('runs/missed')}"
    assert all(change["is_written"] for change in cause["evidence"]["changes"])

    # The fact comes first, unless a cause is certain.
    before = [each["evidence"]["likelihood"] for each in _causes(run, capsys)]
    assert before == sorted(before, reverse=True)

    # After the file has changed, the places are those of the copy in the run.
    (tmp_path / "mine.yaml").write_text(f"# a comment\n{HARD}", encoding="utf-8")
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert f"(runs/missed/inputs/{places[1]})" in cause["text"]


def test_a_single_change_is_not_called_one_of_several(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", TEXT.replace("near:  4 cm", "near:  0.1 mm"))
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["advice"].startswith("Set it back and train again")


def test_a_training_that_is_shorter_than_a_solved_one_comes_before_other_changes(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "longer", EASY, "--timesteps", "512", "--full")
    run = _trained(tmp_path, "missed", HARD, "--set", "train.total_timesteps=512")
    causes = _causes(run, capsys)
    assert [cause["cause"] for cause in causes][:2] == ["too_few_steps", "changed_since_solved"]
    assert causes[0]["text"].startswith(
        f"The training is shorter than {Path('runs/longer')}, which made 512 steps and was solved"
    )


@pytest.mark.slow
def test_the_nearest_of_the_solved_runs_is_compared(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "newer", EASY.replace("  time: ", "  other: 0.002\n  time: "))
    run = _trained(tmp_path, "missed", HARD)
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["evidence"]["earlier"] == str(Path("runs/solved"))


def test_a_solved_run_of_another_name_or_folder_is_not_compared(solved, tmp_path, capsys):
    renamed = _trained(tmp_path, "renamed", HARD.replace("name: Shuttle", "name: Other"))
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(renamed, capsys)]
    elsewhere = _trained(tmp_path / "elsewhere", "hard", HARD)
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(elsewhere, capsys)]


@pytest.fixture
def short_copy(short: Path, tmp_path: Path) -> Path:
    return shutil.copytree(short, tmp_path / "short")


def command_of(folder: Path, *words: str) -> list[str]:
    """Return the command for a run that this command line has trained."""
    run = Run.open(folder)
    write_record(folder, run.record.model_copy(update={"command": ("deepbots", "train", "cartpole", *words)}))
    return training_command(Run.open(folder), ["train.gamma=0.9"])


def test_the_command_that_trains_again_has_the_options_of_the_run_and_further_values(
    short_copy: Path,
) -> None:
    words = command_of(short_copy, "--set", "train.gamma=0.5", "--set=train.n_steps=64", "--run", "runs/mine")
    assert (words[:3], words[words.index("--seed") + 1]) == (["deepbots", "train", "cartpole"], "2")
    settings = [words[index + 1] for index, word in enumerate(words) if word == "--set"]
    assert settings == ["train.n_steps=64", "train.gamma=0.9"]
    assert "--run" not in words
    assert "--allow-code" in command_of(short_copy, "--allow-code")
    shards = command_of(short_copy, "--shards", "auto")
    assert shards[shards.index("--shards") + 1] == "1"
    for option in ("--initialize-from", "--keep-checkpoints", "--callback", "--logger", "--allow-path"):
        for options in ([option, "value"], [f"{option}=value"]):
            command = command_of(short_copy, *options)
            assert command[command.index(option) + 1] == "value"


_SCALE = "robots.cart.links.pole.scale"
_MASS = "robots.cart.links.pole.mass"


def _suggestions(phrase: str, *overrides: str) -> list[Suggestion]:
    return suggestions(api.load("cartpole", overrides=overrides), phrase)


def _override(path: str, value: str) -> str:
    section, _, place = path.partition(".links.")
    link, _, key = place.partition(".")
    return f"{section}.links={{{link}: {{{key}: {value}}}}}" if key else f"{path}={value}"


PARTS = {
    "make the pole longer": (_SCALE, "1 1 1.5"),
    "make the pole 2 times as long": (_SCALE, "1 1 2"),
    "pole 0.75x": (_SCALE, "1 1 0.75"),
    "half the pole": (_SCALE, "1 1 0.5"),
    "a pole that is half as heavy": (_MASS, "urdf * 0.5"),
    "make the pole 2 times lighter": (_MASS, "urdf * 0.5"),
    "a pole 4x shorter": (_SCALE, "1 1 0.25"),
    "a smaller and shorter pole": (_SCALE, "1 1 0.666667"),
    "make the pole heavier": (_MASS, "urdf * 1.5"),
    "make the cart faster": ("parameters.wheel_speed", "7.5 rad/s"),
    "go twice as fast": ("parameters.wheel_speed", "10 rad/s"),
    "a larger fall angle": ("parameters.fall_angle", "22.5 deg"),
    "make the pole 2 m long": (_SCALE, "1 1 2"),
    "pole length 150 cm": (_SCALE, "1 1 1.5"),
    "a pole of 0.5 kg": (_MASS, "0.5 kg"),
    "how do I make the training longer": ("train.total_timesteps", "150_000"),
    "make the training half as long, shorter": ("train.total_timesteps", "50_000"),
    "make the training 3 times shorter": ("train.total_timesteps", "33_333"),
    "make the pole 1,000 g": (_MASS, "1 kg"),
    "make the wheels twice as slow": ("parameters.wheel_speed", "2.5 rad/s"),
}
WRITTEN = [
    ("make the pole longer", _SCALE, "1 1 1.5", "1 1 2.25"),
    ("make the pole 2 m long", _SCALE, "1 1 1.5", "1 1 2"),
    ("make the pole shorter", _SCALE, "1 1 1.5", "1 1 1"),
    ("make the pole longer", _SCALE, "1 1 stretch", "1 1 stretch"),
    ("make the pole longer", _SCALE, "1 1 uniform(1 .. 2)", "1 1 uniform(1 .. 2)"),
    ("a larger extra", "parameters.extra", "-1e-3 m", "-0.0015 m"),
    ("a larger extra", "parameters.extra", "2 m/s^2", "3 m/s^2"),
    ("a larger extra", "parameters.extra", "50 %", "75 %"),
    ("a larger extra", "parameters.extra", "1_000 ms", "1_500 ms"),
    ("a larger extra", "parameters.extra", "0.000_5 m", "0.00075 m"),
]
"""Phrases about a written value: a drawn one and a formula stay."""
UNCLEAR = """
why does the pole fall
reset the pole
pole
make the pole 20 cm longer
make the pole 100 g heavier
make the pole 0,5 kg
make the pole 0.5 longer
make the pole a third longer
make the pole 2 and a half times longer
make the pole 2 m wide
make the pole longer and heavier
make the pole lighter and the cart faster
more friction of the pole
make the pole hinge 2 times stiffer
the pole no longer falls
"""
NO_CHANGE = ("fall_angle", "what is a policy", "how does it learn faster", "", "a larger drawn")


@pytest.mark.parametrize("phrase", PARTS)
def test_a_phrase_names_a_part_or_a_parameter_and_how_much_it_changes(phrase: str) -> None:
    (suggestion,) = _suggestions(phrase)
    assert (suggestion.path, suggestion.value) == PARTS[phrase]
    assert not api.load("cartpole", overrides=[_override(*PARTS[phrase])]).findings.errors


@pytest.mark.parametrize(("phrase", "path", "written", "value"), WRITTEN)
def test_a_phrase_changes_the_written_value(phrase: str, path: str, written: str, value: str) -> None:
    override = _override(path, written) if path == _SCALE else f"parameters={{extra: {written}}}"
    (suggestion,) = _suggestions(phrase, override)
    assert suggestion.value == value
    assert path != _SCALE or f"The file has `scale: {written}`." in suggestion.text


@pytest.mark.parametrize("phrase", [*UNCLEAR.strip().splitlines(), *NO_CHANGE])
def test_a_phrase_without_a_clear_change_has_what_it_is_about(phrase: str) -> None:
    named = _suggestions(phrase, "parameters.drawn=uniform(0.3 .. 0.4 m)")
    assert not any(suggestion.value for suggestion in named)
    assert bool(named) == (phrase not in NO_CHANGE)
    about = "`pole` is a link of the robot `cart`: box 0.02 0.02 1 m, 0.2 kg"
    assert all(suggestion.text.startswith(about) for suggestion in named[:1])


def _mass_and_sizes(checked, name):
    link = next(iter(checked.robots.values())).model.link(name)
    return np.hstack([link.inertial.mass, *astuple(link.visuals[0].shape)])


@settings(max_examples=40)
@given(
    st.sampled_from([("cartpole", "body"), ("quadruped", "FR_toe"), ("balancer", "left_wheel")]),
    st.sampled_from(
        [
            ("longer", "long", "shorter", "short", (1, 1)),
            ("heavier", "heavy", "lighter", "light", (1, 0)),
            ("bigger", "big", "smaller", "small", (3, 1)),
        ]
    ),
    st.sampled_from([("", 1.5), ("2 times ", 2), ("three times ", 3), ("twice as ", 2), ("half as ", 0.5)]),
    st.booleans(),
)
def test_a_value_that_is_offered_compiles_with_the_direction_and_amount_of_the_phrase(
    part, words, amount, grows
):
    word = words[2 * (not grows) + amount[0].endswith("as ")]
    before = api.load(part[0])
    for suggestion in suggestions(before, f"make the {part[1]} {amount[0]}{word}"):
        if suggestion.value:
            after = api.load(part[0], overrides=[_override(suggestion.path, suggestion.value)])
            old, new = (_mass_and_sizes(checked, part[1]) for checked in (before, after))
            ratios = (new / old)[[0, 1 + np.argmax(old[1:])]]  # of the mass, and of the longest side
            expected = (amount[1] if grows else 1 / amount[1]) ** np.array(words[4], float)
            assert not after.findings.errors
            assert ratios == pytest.approx(expected, rel=1e-4)

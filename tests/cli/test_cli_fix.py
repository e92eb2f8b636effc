"""Commands that change or compare files.

* `deepbots lint --fix`: the files that it writes, those that it leaves alone, and its output.
* `deepbots fmt`: files and folders, differences, and files that it refuses.
* `deepbots diff`: what two scenarios do not share, by meaning and in the words of the language.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.learning.runs.run import RunRecord
from tests.files import written
from tests.named import with_defaults

CARTPOLE = with_defaults(
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)


def faulty(*changes: tuple[str, str]) -> str:
    text = CARTPOLE
    for right, wrong in changes:
        assert text.count(right) == 1, right
        text = text.replace(right, wrong)
    return text


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "a.yaml"

    def write(text: str | bytes):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


SAFE = {
    "a key": ("  timestep:", "  timestop:"),
    "a word": ("type: velocity_motor", "type: velocity_moter"),
    "a unit": ("32 ms", "32 milliseconds"),
    "a length without its unit": ("0.04 m}", "0.04}"),
    "case": ("algorithm: PPO", "algorithm: ppo"),
    "a section": ("observation: ", "obsevation: "),
    "a hexadecimal number": ("substeps: 4", "substeps: 0x4"),
    "an underscore too many": ("100_000", "1000_00"),
    "signs of another language": ("abs(x) > track", "abs(x)>track&&not (abs(x) < 0.1 m)"),
    "a value cut by a comma": ("0.04 m}", "max(0.04 m, 0.01 m)}"),
    "a pattern without quotes": ("[wheel_*]", "[*_left]"),
}
UNSAFE = {
    "a joint": ("pole_hinge}", "pole_hnge}"),
    "a name in an expression": ("abs(x) > track", "abs(x) > trak"),
    "a message field": ("abs(cart.pole_angle)", "abs(cart.pole_angel)"),
    "an actuator": ("apply: {wheels:", "apply: {wheel:"),
}


@pytest.mark.parametrize("change", SAFE.values(), ids=SAFE.keys())
def test_a_slip_in_a_word_of_the_language_is_put_right(deepbots, scenario, change):
    path = scenario(faulty(change))
    ran = deepbots("lint", "a.yaml", "--fix")
    assert ran.out == "a.yaml: no findings\n"
    assert "1 fixed in 1 file" in ran.err
    assert path.read_text().count("\n") == CARTPOLE.count("\n")


@pytest.mark.parametrize("change", UNSAFE.values(), ids=UNSAFE.keys())
def test_a_misspelled_name_is_put_right_only_where_guesses_are_allowed(deepbots, scenario, change):
    path = scenario(faulty(change))
    deepbots("lint", "a.yaml", "--fix", code=1)
    assert path.read_text() == faulty(change)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert path.read_text() == CARTPOLE


SUMMARY = "summary: Keep a free pole upright by driving a four-wheeled cart back and forth."
BOX = "objects: {box: {shape: box, size: 1 1 1 cm, pose: {x: 0.3 m}, fixed: %s}}\nrobots:"
STOP = ("  substeps: 4", "  substeps: 4\n  timestop: 30 ms")  # there is a `timestep` already
IGNORED = ("  alive: 1\n", "  alive: 1  # deepbots: ignore[DB603]\n")
UNUSED = (
    "  tip_speed: velocity(cart.tip).x\n",
    "  tip_speed: velocity(cart.tip).x\n  more:      speed  # never seen\n",
)
IN_QUOTES = ("abs(x) > track", '"abs(x) > %s"')
FOLDED = ("fallen:    abs(cart.pole_angle) > fall_angle", "fallen: >\n      abs(cart.%s)\n      > fall_angle")


def filled(change: tuple[str, str], word: str) -> tuple[str, str]:
    return change[0], change[1] % word


def test_all_fixes_of_a_round_are_applied(deepbots, scenario):
    """Each of 14 fixes inserts above and removes below."""
    numbers = range(14)
    path = scenario(
        "deepbots: 1\nextends: cartpole\nname: Many\nsignals:\n"
        + "".join(f"  s{i}: position(cart).x / m + {i}\n" for i in numbers)
        + "observation:\n"
        + "".join(f"  s{i}: -30 .. 30\n" for i in numbers)
    )
    assert "14 fixed in 1 file" in deepbots("lint", path, "--fix", "--unsafe-fixes").err


# The changes of a right file, further options, the changes that are left, and the exit code.
FIXED = {
    "a decimal comma": (
        [("alive: 1", "alive: 0,5 when x > 0 m")],
        "--unsafe-fixes",
        [("alive: 1", "alive: 0.5 when x > 0 m")],
        0,
    ),
    "a component": (
        [("alive: 1", "alive: 1 when previous_action.forwrd")],
        "--unsafe-fixes",
        [("alive: 1", "alive: 1 when previous_action.forward")],
        0,
    ),
    "a fix that only moves the mistake": (
        [move := ("cart: {z: 0.04 m}", "cart: {z: 1,5 cm}")],
        "",
        [move],
        1,
    ),
    "a key of another program": (
        [key := ("  algorithm: PPO", "  algorithm: PPO\n  policy: MlpPolicy")],
        "",
        [key],
        1,
    ),
    "a misspelled sensor": (
        [("    apply: {", "    emit: [pole_angl]\n    apply: {")],
        "--unsafe-fixes",
        [("    apply: {", "    emit: [pole_angle]\n    apply: {")],
        0,
    ),
    "a word that older YAML takes for a truth value": (
        [(SUMMARY, "summary: no")],
        "",
        [(SUMMARY, 'summary: "no"')],
        0,
    ),
    "a number in unusual groups": (
        [(SUMMARY, "summary: 10_00")],
        "--fail-on warning",
        [(SUMMARY, 'summary: "10_00"')],
        0,
    ),
    "a number with a zero before it, beside an error": (
        [("n_steps: 64", "n_steps: 0_64"), ("15 deg", "15 kg")],
        "",
        [("15 deg", "15 kg")],
        1,
    ),
    "a suppression of nothing": ([IGNORED], "--fail-on warning", [], 0),
    "a suppression of nothing on its line": (
        [("  alive: 1\n", "  alive: 1\n  # deepbots: ignore[DB603, DB703]\n")],
        "--fail-on warning",
        [],
        0,
    ),
    "the reason beside a suppression": (
        [("  alive: 1\n", "  alive: 1  # deepbots: ignore[DB603] paid in every step\n")],
        "",
        [("  alive: 1\n", "  alive: 1  # paid in every step\n")],
        0,
    ),
    "a suppression beside errors": ([IGNORED, ("15 deg", "15 kg")], "", [IGNORED, ("15 deg", "15 kg")], 1),
    "what looks like a suppression inside a text": (
        [text := ("summary: Keep a free pole upright", 'summary: "Keep # deepbots: ignore[DB603]"\n#')],
        "--unsafe-fixes",
        [text],
        0,
    ),
    "a name written with an escape": (
        [escape := ("abs(x) > track", '"abs(x) > tr\\x61k"')],
        "--unsafe-fixes",
        [escape],
        1,
    ),
    "a definition that nothing uses, without guesses": ([UNUSED], "", [UNUSED], 0),
    "a definition that nothing uses": ([UNUSED], "--unsafe-fixes", [], 0),
    "a word where a truth value belongs": (
        [("\nrobots:", "\n" + BOX % "yes")],
        "",
        [("\nrobots:", "\n" + BOX % "true")],
        0,
    ),
    "words in quotes and in folded text": (
        [filled(IN_QUOTES, "trak"), filled(FOLDED, "pole_angel")],
        "--unsafe-fixes",
        [filled(IN_QUOTES, "track"), filled(FOLDED, "pole_angle")],
        0,
    ),
    "a fix that brings a new error": ([STOP], "--unsafe-fixes", [STOP], 1),
    "a harmful fix beside others": (
        [STOP, ("algorithm: PPO", "algorithm: PPo"), ("15 deg", "15 degrees")],
        "",
        [STOP],
        1,
    ),
    "a fix that uncovers the next": (
        [("  timestep: 32 ms", "  timestop: 32 milliseconds")],
        "",
        [],
        0,
    ),
    "a sign with no value before it": (
        [("abs(x) > track", "2 * || x > track")],
        "",
        [("abs(x) > track", "2 * || x > track")],
        1,
    ),
}


@pytest.mark.parametrize(("changes", "words", "left", "code"), FIXED.values(), ids=FIXED)
def test_a_file_is_fixed(deepbots, scenario, changes, words, left, code):
    path = scenario(faulty(*changes))
    deepbots("lint", "a.yaml", "--fix", *words.split(), code=code)
    assert path.read_text() == faulty(*left)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("  lean: tilt(cart) # so\n  rest: time\n", "  rest: time\n"),
        ("  lean: |\n    2 *\n    tilt(cart)\n  rest: time\n", "  rest: time\n"),
        ("  lean: tilt(cart)\n", None),
        ("    lean: tilt(cart)\n    rest: time\n", "    rest: time\n"),
    ],
)
def test_the_line_of_an_observed_signal_moves_to_augment(deepbots, scenario, before, after):
    text = CARTPOLE.replace("  alive: 1\n", "  alive: 1 - 0 * rest / s\n" if after else "  alive: 1\n")
    text = text.replace("  cart.pole_angle: -20", "  lean: 0 .. 1 rad\n  cart.pole_angle: -20")
    path = scenario(text.replace("\nreward:\n", f"\nsignals:\n{before}\nreward:\n"))
    deepbots("lint", "a.yaml", code=1)
    assert deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes").out == "a.yaml: no findings\n"
    line = before.removesuffix(after or "")
    moved = text.replace(
        "velocity(cart.tip).x\n", f"velocity(cart.tip).x\n{'  ' + line.lstrip() if after else line}"
    )
    assert path.read_text() == (
        moved.replace("\nreward:\n", f"\nsignals:\n{after}\nreward:\n")
        if after
        else moved.replace("\nreward:\n", "\n\nreward:\n")
    )


def test_line_ends_and_a_byte_order_mark_stay(deepbots, scenario):
    def as_bytes(text):
        return b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()

    path = scenario(as_bytes(faulty(("  timestep:", "  timestop:"), ("world:", "world: # the arena"))))
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_bytes() == as_bytes(faulty(("world:", "world: # the arena")))


def test_a_mistake_hidden_by_a_misspelling_is_reported_after_its_fix(deepbots, scenario):
    other_use = ("alive: 1", "alive: 1 - abs(x) / track")  # so the definition of `track` is probably right
    path = scenario(
        faulty(other_use, ("abs(x) > track", "abs(speed) > trak"), ("  timestep: 32 ms", "  timestop: 32 kg"))
    )
    ran = deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", code=1)
    assert path.read_text() == faulty(other_use, ("abs(x) > track", "abs(speed) > track"), ("32 ms", "32 kg"))
    assert "DB503[dimension-mismatch]: a speed (m/s) is combined with `track`, a length (m)" in ran.out


def test_a_mistake_in_a_case_alone_leaves_the_scenario_as_it_is(deepbots, scenario):
    values = "{parameters: {fall_angle: 10 deg, wheel_speed: 5 rad/s, trakc: 1 m}}"
    text = f"{CARTPOLE}\nevaluation: {{cases: {{other: {{set: {values}}}}}}}\n"
    path = scenario(text)
    assert "unknown name `track`" in deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", code=1).out
    assert path.read_text() == text


GUESSES = [
    ("reward: {alive: abs(x) < track}", "reward: {alive: 1 when abs(x) < track}"),
    (
        "reset: {joints: {cart.pole_hinge: uniform(-90 .. 2.50 deg)}}",
        "reset: {joints: {cart.pole_hinge: uniform(-74.48 .. 2.50 deg)}}",
    ),
    (
        "robots: {cart: {actuators: {wheels: {max_torque: 20 N*m}}}}",
        "robots: {cart: {actuators: {wheels: {max_torque: 10 N*m}}}}",
    ),
    (
        "robots: {cart: {actuators: {wheels: {max_velocity: 1_200 rpm}}}}",
        "robots: {cart: {actuators: {wheels: {max_velocity: 95.49 rpm}}}}",
    ),
]
GUESSES += [
    (
        f"augment: {{left: abs(x - 30 cm)}}\n{goal}\nreward: {{alive: 0, nearer: {wrong}}}",
        f"augment: {{left: abs(x - 30 cm)}}\n{goal}\nreward: {{alive: 0, nearer: {right}}}",
    )
    for goal in ["termination: {success: {there: left < 5 cm}}\nobservation: {left: 0 .. 0.8 m}"]
    for wrong, right in [
        ("10 * delta(left) / m", "-10 * delta(left) / m"),
        ("left / m - 1", "1 - left / m"),
        ("(left - 1 m) / m", "-(left - 1 m) / m"),
        ("left / m - 1 when not fallen", "1 - left / m when not fallen"),
        ("left / m + 1", "-(left / m + 1)"),
        ("-5 when there", "5 when there"),
    ]
]


def test_a_guess_is_made_although_an_ending_holds_at_once(deepbots, scenario, tmp_path):
    scenario(CARTPOLE)
    upon = written(
        tmp_path / "b.yaml", "deepbots: 1\nextends: a.yaml\nreset: {joints: {cart.pole_hinge: 90 deg}}\n"
    )
    assert "DB806" in deepbots("lint", "b.yaml", "--fix", "--unsafe-fixes", code=1).out
    assert upon.read_text().endswith("{cart.pole_hinge: 74.48 deg}}\n")


GUESSES += [
    ("observation: {cart.pole_angle: -0.23 .. 0.23 rad}", "observation: {cart.pole_angle: -18 .. 18 deg}"),
    (
        "observation: {cart.pole_angle: 100 .. 120 deg}",
        "observation: {cart.pole_angle: -88.81 .. 88.81 deg}",
    ),
    ("world: {gravity: 0 0 9.81 m/s^2}", "world: {gravity: 0 0 -9.81 m/s^2}"),
    (
        "evaluation: {cases: {steep: {set: {fall_angel: 12 deg}}}}",
        "evaluation: {cases: {steep: {set: {fall_angle: 12 deg}}}}",
    ),
]


@pytest.mark.parametrize(("wrong", "right"), GUESSES)
def test_a_guess_keeps_what_was_written_and_makes_it_whole(deepbots, scenario, tmp_path, wrong, right):
    scenario(CARTPOLE)
    upon = written(tmp_path / "b.yaml", f"deepbots: 1\nextends: a.yaml\n{wrong}  # why\n")
    deepbots("lint", "b.yaml", "--fix", code=None)
    assert wrong in upon.read_text()
    deepbots("lint", "b.yaml", "--fix", "--unsafe-fixes")
    assert upon.read_text() == f"deepbots: 1\nextends: a.yaml\n{right}  # why\n"


def test_a_file_whose_name_is_as_long_as_names_can_be_is_fixed(deepbots, scenario, tmp_path):
    long = scenario(faulty(("  timestep:", "  timestop:"))).rename(tmp_path / f"{'n' * 250}.yaml")
    deepbots("lint", long, "--fix")
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".yaml"] == [long.name]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write into every file")
def test_a_file_that_is_read_only_stays_as_it_is_though_its_folder_could_be_changed(deepbots, scenario):
    path = scenario(faulty(("  timestep:", "  timestop:")))
    before = path.read_bytes()
    path.chmod(0o444)
    ran = deepbots("lint", path, "--fix")
    assert (ran.code, path.read_bytes()) == (2, before)
    assert "cannot be written: permission denied" in ran.err


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such names")
@pytest.mark.parametrize("name", ["::stop-commands::x.yaml", "a\n::error::x.yaml", "##[add-mask]x.yaml"])
def test_no_name_of_a_file_is_a_command_to_the_log_of_a_workflow(deepbots, scenario, tmp_path, name):
    scenario(faulty(("  timestep:", "  timestop:"))).rename(tmp_path / name)
    for words in (
        "lint .",
        "lint . --format concise",
        "lint . --diff",
        "lint . --fix",
        "lint .",
        "fmt .",
        "fmt . --check",
    ):
        ran = deepbots(*words.split(), code=None)
        assert "\n::" not in f"\n{ran.out}\n{ran.err}"
        assert "--diff" in words or "##[" not in ran.out + ran.err


@pytest.mark.skipif(shutil.which("patch") is None, reason="there is no `patch` here")
def test_the_difference_of_a_file_with_an_unusual_name_is_a_patch_without_control_characters(
    deepbots, scenario, tmp_path
):
    path = scenario(faulty(("  timestep:", "  timestop:"))).rename(tmp_path / 'a\x1b[31m"\\é.yaml')
    ran = deepbots("lint", path, "--diff", code=1)
    assert ran.out.replace("\n", "").isprintable()
    subprocess.run(["patch", "-p0"], cwd=tmp_path, input=ran.out, text=True, check=True, capture_output=True)
    deepbots("lint", path)


UNTIDY = "deepbots:   1\nworld:\n    timestep: 32 ms   # a tick\n"
TIDY = "deepbots: 1\nworld:\n  timestep: 32 ms   # a tick\n"


def test_a_file_is_put_into_the_canonical_layout(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbf" + UNTIDY.replace("\n", "\r\n").encode())
    deepbots("fmt", "a.yaml")
    assert (tmp_path / "a.yaml").read_bytes() == b"\xef\xbb\xbf" + TIDY.replace("\n", "\r\n").encode()
    deepbots("fmt", "a.yaml", "--check")


@pytest.mark.parametrize("verb", [("fmt", "--diff"), ("lint", "--diff", "--unsafe-fixes")], ids=" ".join)
@pytest.mark.parametrize("name", ["a.yaml", "my \u00e4 file.yaml"])
@pytest.mark.parametrize("tail", ["\r\n", ""], ids=["ended", "open"])
def test_a_difference_in_a_pipe_is_a_patch_whatever_the_line_ends(deepbots, tmp_path, verb, name, tail):
    before = f"\ufeffdeepbots: 1\r\nreward:  {{}}\r\nworld: {{timestop: 32 ms}}{tail}".encode()
    (tmp_path / name).write_bytes(before)
    (tmp_path / "change.patch").write_text(deepbots(*verb, name, code=None).out, encoding="utf-8", newline="")
    assert deepbots(
        *(word if word != "--diff" else "--fix" for word in verb if verb[0] == "lint" or word != "--diff"),
        name,
        code=None,
    ).err
    after = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(before)
    subprocess.run(["git", "apply", "-p0", "change.patch"], cwd=tmp_path, check=True)
    assert (tmp_path / name).read_bytes() == after != before


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
    assert (list(rows), code) == ([(group, path)], 0 if group == "cosmetic" else 1)


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

"""`deepbots lint --fix`: the files that it writes, those that it leaves alone, and its output."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess

import pytest

from deepbots_cli.document import shipped
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


@pytest.mark.parametrize(
    ("written", "mended"),
    [
        ("0,5 when x > 0 m", "0.5 when x > 0 m"),
        ("1 when previous_action.forwrd", "1 when previous_action.forward"),
    ],
)
def test_a_decimal_comma_and_a_component_are_guessed_within_what_stands_around_them(
    deepbots, scenario, written, mended
):
    path = scenario(faulty(("alive: 1", f"alive: {written}")))
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert f"alive: {mended}\n" in path.read_text()


@pytest.mark.parametrize(
    "change",
    [
        ("cart: {z: 0.04 m}", "cart: {z: 1,5 cm}"),
        ("  algorithm: PPO", "  algorithm: PPO\n  policy: MlpPolicy"),
    ],
)
def test_a_fix_that_only_moves_the_mistake_is_not_offered(deepbots, scenario, change):
    path = scenario(text := faulty(change))
    deepbots("lint", "a.yaml", "--fix", code=1)
    assert path.read_text() == text


@pytest.mark.parametrize("change", UNSAFE.values(), ids=UNSAFE.keys())
def test_a_misspelled_name_is_put_right_only_where_guesses_are_allowed(deepbots, scenario, change):
    path = scenario(faulty(change))
    deepbots("lint", "a.yaml", "--fix", code=1)
    assert path.read_text() == faulty(change)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert path.read_text() == CARTPOLE


def test_a_misspelled_sensor_is_put_right(deepbots, scenario):
    path = scenario(CARTPOLE.replace("    apply: {", "    emit: [pole_angl]\n    apply: {"))
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert "    emit: [pole_angle]\n" in path.read_text()


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


@pytest.mark.parametrize(
    "comment", ["  # deepbots: ignore[DB603]\n", "\n  # deepbots: ignore[DB603, DB703]\n"]
)
def test_a_suppression_of_nothing_is_taken_out(deepbots, scenario, comment):
    path = scenario(CARTPOLE.replace("  alive: 1\n", f"  alive: 1{comment}"))
    deepbots("lint", "a.yaml", "--fix", "--fail-on", "warning")
    assert path.read_text() == CARTPOLE


def test_the_reason_beside_a_suppression_of_nothing_stays(deepbots, scenario):
    path = scenario(
        CARTPOLE.replace("  alive: 1\n", "  alive: 1  # deepbots: ignore[DB603] paid in every step\n")
    )
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_text() == CARTPOLE.replace("  alive: 1\n", "  alive: 1  # paid in every step\n")


def test_what_looks_like_a_suppression_inside_a_text_is_left_alone(deepbots, scenario):
    text = CARTPOLE.replace(
        "summary: Keep a free pole upright", 'summary: "Keep # deepbots: ignore[DB603]"\n#'
    )
    path = scenario(text)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert path.read_text() == text


def test_suppressions_stay_as_long_as_there_are_errors(deepbots, scenario):
    text = faulty(("  alive: 1\n", "  alive: 1  # deepbots: ignore[DB603]\n"), ("15 deg", "15 kg"))
    path = scenario(text)
    deepbots("lint", "a.yaml", "--fix", code=1)
    assert path.read_text() == text


def test_a_definition_that_nothing_uses_goes_with_its_line_where_guesses_are_allowed(deepbots, scenario):
    text = CARTPOLE.replace(
        "  tip_speed: velocity(cart.tip).x\n",
        "  tip_speed: velocity(cart.tip).x\n  more:      speed  # never seen\n",
    )
    path = scenario(text)
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_text() == text
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert path.read_text() == CARTPOLE


def test_a_word_that_older_yaml_takes_for_a_truth_value_stays_a_text(deepbots, scenario):
    path = scenario(
        CARTPOLE.replace(
            "summary: Keep a free pole upright by driving a four-wheeled cart back and forth.", "summary: no"
        )
    )
    deepbots("lint", "a.yaml", "--fix")
    assert 'summary: "no"\n' in path.read_text()


def test_a_word_where_a_truth_value_belongs_becomes_one(deepbots, scenario):
    box = "objects: {box: {shape: box, size: 1 1 1 cm, pose: {x: 0.3 m}, fixed: %s}}\n"
    path = scenario(CARTPOLE + box % "yes")
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_text() == CARTPOLE + box % "true"


def test_a_word_inside_quotes_and_folded_text_is_put_right_in_its_place(deepbots, scenario):
    text = CARTPOLE.replace("abs(x) > track", '"abs(x) > trak"').replace(
        "fallen:    abs(cart.pole_angle) > fall_angle",
        "fallen: >\n      abs(cart.pole_angel)\n      > fall_angle",
    )
    path = scenario(text)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes")
    assert path.read_text() == text.replace("trak", "track").replace("pole_angel", "pole_angle")


def test_a_name_written_with_an_escape_is_left_alone(deepbots, scenario):
    text = CARTPOLE.replace("abs(x) > track", '"abs(x) > tr\\x61k"')
    path = scenario(text)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", code=1)
    assert path.read_text() == text


def test_line_ends_and_a_byte_order_mark_stay(deepbots, scenario):
    def as_bytes(text):
        return b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()

    path = scenario(as_bytes(faulty(("  timestep:", "  timestop:"), ("world:", "world: # the arena"))))
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_bytes() == as_bytes(faulty(("world:", "world: # the arena")))


def test_a_fix_that_brings_a_new_error_is_not_made(deepbots, scenario):
    text = faulty(("  substeps: 4", "  substeps: 4\n  timestop: 30 ms"))  # there is a `timestep` already
    path = scenario(text)
    ran = deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", code=1)
    assert path.read_text() == text
    assert "fixed" not in ran.err


def test_a_harmful_fix_does_not_keep_others_from_being_made(deepbots, scenario):
    path = scenario(
        faulty(
            ("  substeps: 4", "  substeps: 4\n  timestop: 30 ms"),
            ("algorithm: PPO", "algorithm: PPo"),
            ("15 deg", "15 degrees"),
        )
    )
    deepbots("lint", "a.yaml", "--fix", code=1)
    assert path.read_text() == faulty(("  substeps: 4", "  substeps: 4\n  timestop: 30 ms"))


def test_a_fix_may_uncover_the_next(deepbots, scenario):
    path = scenario(faulty(("  timestep: 32 ms", "  timestop: 32 milliseconds")))
    deepbots("lint", "a.yaml", "--fix")
    assert path.read_text() == CARTPOLE


def test_a_mistake_hidden_by_a_misspelling_is_reported_after_its_fix(deepbots, scenario):
    other_use = ("alive: 1", "alive: 1 - abs(x) / track")  # so the definition of `track` is probably right
    path = scenario(
        faulty(other_use, ("abs(x) > track", "abs(speed) > trak"), ("  timestep: 32 ms", "  timestop: 32 kg"))
    )
    ran = deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", code=1)
    assert path.read_text() == faulty(other_use, ("abs(x) > track", "abs(speed) > track"), ("32 ms", "32 kg"))
    assert "DB503[dimension-mismatch]: a speed (m/s) is combined with `track`, a length (m)" in ran.out


def test_a_number_in_unusual_groups_stays_a_text(deepbots, scenario):
    path = scenario(
        CARTPOLE.replace(
            "summary: Keep a free pole upright by driving a four-wheeled cart back and forth.",
            "summary: 10_00",
        )
    )
    deepbots("lint", "a.yaml", "--fix", "--fail-on", "warning")
    assert 'summary: "10_00"\n' in path.read_text()


GUESSES = [
    ("reward: {alive: abs(x) < track}", "reward: {alive: 1 when abs(x) < track}"),
]


GUESSES += [
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
    upon = tmp_path / "b.yaml"
    upon.write_text("deepbots: 1\nextends: a.yaml\nreset: {joints: {cart.pole_hinge: 90 deg}}\n")
    assert "DB806" in deepbots("lint", "b.yaml", "--fix", "--unsafe-fixes", code=1).out
    assert upon.read_text().endswith("{cart.pole_hinge: 74.48 deg}}\n")


@pytest.mark.parametrize(("wrong", "right"), GUESSES)
def test_a_guess_keeps_what_was_written_and_makes_it_whole(deepbots, scenario, tmp_path, wrong, right):
    scenario(CARTPOLE)
    upon = tmp_path / "b.yaml"
    upon.write_text(f"deepbots: 1\nextends: a.yaml\n{wrong}  # why\n")
    deepbots("lint", "b.yaml", "--fix", code=None)
    assert wrong in upon.read_text()
    deepbots("lint", "b.yaml", "--fix", "--unsafe-fixes")
    assert upon.read_text() == f"deepbots: 1\nextends: a.yaml\n{right}  # why\n"


def test_diff_shows_the_change_and_writes_nothing(deepbots, scenario):
    text = faulty(("  timestep:", "  timestop:"))
    path = scenario(text)
    ran = deepbots("lint", "a.yaml", "--diff", code=1)
    assert "-  timestop: 32 ms\n+  timestep: 32 ms\n" in ran.out
    assert path.read_text() == text


def test_diff_of_a_file_without_findings_is_empty(deepbots, scenario):
    scenario(CARTPOLE)
    ran = deepbots("lint", "a.yaml", "--diff")
    assert ran.out == ""
    assert ran.err == ""


def test_an_included_file_of_the_project_is_fixed_and_one_outside_is_not(deepbots, tmp_path):
    outside, project = tmp_path / "outside", tmp_path / "project"
    outside.mkdir()
    project.mkdir()
    (outside / "train.yaml").write_text("algorithm: PPO\ntotal_timestops: 1000\n")
    (project / "world.yaml").write_text("timestop: 32 ms  # a tick\n")
    head, _, _ = CARTPOLE.partition("train:")
    text = (
        head.replace("  timestep: 32 ms\n", "  include: world.yaml\n")
        + "train: {include: ../outside/train.yaml}\n"
    )
    (project / "a.yaml").write_text(text)
    deepbots("lint", "project/a.yaml", "--allow-path", "outside", "--fix", "--unsafe-fixes", code=1)
    assert (project / "world.yaml").read_text() == "timestep: 32 ms  # a tick\n"
    assert (outside / "train.yaml").read_text() == "algorithm: PPO\ntotal_timestops: 1000\n"


def test_a_fix_in_a_shared_file_that_harms_another_scenario_is_not_made(deepbots, tmp_path):
    (tmp_path / "part.yaml").write_text("far: abs(x) > trak\n")
    for name, parameter in (("a", "track"), ("b", "trak")):
        text = CARTPOLE.replace("  track:       0.39", f"  {parameter}:       0.39")
        text = text.replace("    off_track: abs(x) > track\n", "    include: part.yaml\n")
        (tmp_path / f"{name}.yaml").write_text(text)
    deepbots("lint", "a.yaml", "b.yaml", "--fix", "--unsafe-fixes", code=1)
    assert (tmp_path / "part.yaml").read_text() == "far: abs(x) > trak\n"


def test_permissions_stay_and_no_other_file_is_left_behind(deepbots, scenario, tmp_path):
    path = scenario(faulty(("  timestep:", "  timestop:")))
    path.chmod(0o640)
    deepbots("lint", "a.yaml", "--fix")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert os.listdir(tmp_path) == ["a.yaml"]


def test_fixing_goes_through_a_symbolic_link(deepbots, scenario, tmp_path):
    path = scenario(faulty(("  timestep:", "  timestop:")))
    (tmp_path / "link.yaml").symlink_to(path)
    deepbots("lint", "link.yaml", "--fix")
    assert (tmp_path / "link.yaml").is_symlink()
    assert path.read_text() == CARTPOLE


@pytest.mark.parametrize("words", [("--unsafe-fixes",), ("--fix", "--set", "fall_angle=10deg")])
def test_options_that_do_not_go_together_are_refused(deepbots, scenario, words):
    scenario(CARTPOLE)
    ran = deepbots("lint", "a.yaml", *words, code=2)
    assert ran.err.startswith("error: --")


def test_lint_says_how_many_findings_can_be_fixed(deepbots, scenario):
    scenario(faulty(("  timestep:", "  timestop:"), ("pole_hinge}", "pole_hnge}")))
    assert deepbots("lint", "a.yaml", code=1).err == "1 can be fixed by --fix, 1 more by --unsafe-fixes\n"


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        (
            "observation: {cart.pole_angle: -0.23 .. 0.23 rad}",
            "observation: {cart.pole_angle: -18 .. 18 deg}",
        ),
        (
            "observation: {cart.pole_angle: 80 .. 100 deg}",
            "observation: {cart.pole_angle: -74.48 .. 74.48 deg}",
        ),
        ("world: {gravity: 0 0 9.81 m/s^2}", "world: {gravity: 0 0 -9.81 m/s^2}"),
        (
            "evaluation: {cases: {steep: {set: {fall_angel: 12 deg}}}}",
            "evaluation: {cases: {steep: {set: {fall_angle: 12 deg}}}}",
        ),
    ],
)
def test_a_figure_that_the_help_names_is_a_guess_that_may_be_taken(
    deepbots, scenario, tmp_path, wrong, right
):
    scenario(CARTPOLE)
    upon = tmp_path / "b.yaml"
    upon.write_text(f"deepbots: 1\nextends: a.yaml\n{wrong}\n")
    deepbots("lint", "b.yaml", "--fix", code=None)
    assert wrong in upon.read_text()
    deepbots("lint", "b.yaml", "--fix", "--unsafe-fixes", "--fail-on", "warning")
    assert upon.read_text() == f"deepbots: 1\nextends: a.yaml\n{right}\n"


def test_a_difference_takes_no_format_because_it_contains_no_findings(deepbots, scenario):
    scenario(CARTPOLE)
    for option in (["--json"], ["--format", "sarif"]):
        ran = deepbots("lint", "a.yaml", "--diff", *option, code=2)
        assert "--diff cannot be combined with --format or --json" in ran.err


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


def test_a_diff_that_has_only_guesses_names_the_options_that_show_them(deepbots, scenario):
    scenario(faulty(next(iter(UNSAFE.values()))))
    assert deepbots("lint", "a.yaml", code=1).err.endswith(
        "show with --diff --unsafe-fixes, apply with --fix --unsafe-fixes\n"
    )
    ran = deepbots("lint", "a.yaml", "--diff", code=1)
    assert ran.out == ""
    assert ran.err.startswith("there are no changes; 1 unsafe fix available")
    assert "+++ a.yaml" in deepbots("lint", "a.yaml", "--diff", "--unsafe-fixes", code=1).out


def test_a_mistake_of_set_has_no_fix_in_the_file(deepbots, scenario):
    scenario(CARTPOLE)
    ran = deepbots("lint", "a.yaml", "--set", "fall_angl=5 deg", code=1)
    assert "did you mean `fall_angle`?" in ran.out
    assert "--fix" not in ran.err


def test_a_term_that_pays_more_than_the_success_is_lowered_until_the_finding_is_gone(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text(
        "deepbots: 1\nextends: cartpole\nname: Copy\nagent: {action_repeat: 2}\n"
        "augment: {left: abs(x - 30 cm)}\nobservation: {left: 0 .. 0.8 m}\n"
        "reward: {alive: 0, near: 0.5 * exp(-left / 10 cm), prize: 10 when there}\n"
        "termination: {success: {there: left < 1 mm}}\n"
    )
    found = deepbots("lint", str(tmp_path / "a.yaml")).out
    assert "lower `near`, line 7, to `0.05 * (0.5 * exp(-left / 10 cm))` or less" in found
    deepbots("lint", str(tmp_path / "a.yaml"), "--fix", "--unsafe-fixes", "--select", "DB708")
    assert "near: 0.05 * (0.5 *" in (tmp_path / "a.yaml").read_text()
    assert "DB708" not in deepbots("lint", str(tmp_path / "a.yaml")).out

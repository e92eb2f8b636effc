"""Rewards that a cycle of states exploits are found in the text, whatever the term looks like; rewards that
sum to zero are not."""

from __future__ import annotations

import shutil
from pathlib import Path
from textwrap import dedent

import pytest

from deepbots_cli import api
from deepbots_cli.analysis import Analysis, possible_returns
from deepbots_cli.analysis.speeds import base_speed, highest_return

HERE = Path(__file__).parent

EXPLOITED = {
    "paid in each step while the success has to be held": """
        signals: {inside: apart < 5 cm, slow: "norm(velocity(epuck)) < 2 cm/s"}
        reward: {there: 0, closer: -10 * delta(apart) / m, parked: 10 when parked, time: -0.05}
        remove: [termination.success.arrived]
        augment: {parked: inside and slow}
        termination: {success: {done: duration(parked) > 0.5 s}}
    """,
    "paid while a counter runs up to the success": """
        augment: {held: "accumulate(0.1 s if apart < 5 cm else -2 s, 0 .. 3 s, 0 s)"}
        observation: {held: 0 .. 3 s}
        reward: {there: 0, closer: -10 * delta(apart) / m, stay: 1 if apart < 5 cm else 0}
        termination: {success: {arrived: held > 1 s}}
    """,
    "paid by how long the success is held": """
        augment: {held: "duration(apart < 5 cm)"}
        observation: {held: 0 .. 10 s}
        reward: {there: 5 when arrived, stay: "2 * min(held / (1 s), 1)"}
        termination: {success: {arrived: held > 2 s}}
    """,
    "paid in the region that has to be held, written with frames": """
        reward: {there: 5 when arrived, stay: "1 when norm(position(epuck) - position(post)) < 10 cm and abs(angle) < 20 deg"}
        termination: {success: {arrived: duration(apart < 10 cm and abs(angle) < 20 deg) > 1 s}}
    """,
    "paid in each step near the goal": """
        reward: {near: exp(-apart / (20 cm))}
    """,
    "paid in each step in a band around the goal": """
        reward: {band: 0.5 when apart > 20 cm and apart < 30 cm}
    """,
    "paid in each step by a conditional expression": """
        reward: {band: 0.5 if apart < 30 cm else -0.1}
    """,
    "paid in each step near one of two goals": """
        objects: {mark: {shape: cylinder, radius: 1 cm, height: 5 cm, solid: false, fixed: true, pose: {x: -0.4 m}}}
        augment: {other: "ground_distance(epuck, mark)"}
        reward: {there: 5 when arrived or back, near: "0.4 * exp(-min(apart, other) / (20 cm))"}
        termination: {success: {back: other < 5 cm}}
    """,
    "a bonus at each rising edge": """
        signals: {inside: apart < 25 cm}
        reward: {entered: 5 when rising_edge(inside)}
    """,
    "a bonus where the distance crosses a limit": """
        reward: {entered: 3 when apart < 25 cm and previous(apart) >= 25 cm, closer: -10 * delta(apart) / m}
    """,
    "a bonus for the rise of a number": """
        signals: {inside: 1 if apart < 25 cm else 0}
        reward: {entered: "4 * max(delta(inside), 0)"}
    """,
    "a bonus for each visit that a counter counts": """
        signals: {visits: "accumulate(1 if rising_edge(apart < 25 cm) else 0, 0 .. 1000, 0)"}
        reward: {entered: 4 * delta(visits)}
    """,
    "a bonus for staying a while": """
        signals: {stay: duration(apart < 25 cm)}
        reward: {entered: 4 when stay > 0.3 s and previous(stay) <= 0.3 s}
    """,
    "a bonus at each visit of a place that is not the goal": """
        objects: {mark: {shape: cylinder, radius: 1 cm, height: 5 cm, solid: false, fixed: true, pose: {x: -0.4 m}}}
        reward: {entered: "3 when rising_edge(ground_distance(epuck, mark) < 15 cm)", closer: -10 * delta(apart) / m}
    """,
    "progress without the way back by max": """
        truncation: {max_steps: 200}
        reward: {nearer: "50 * max(0 m, -delta(apart)) / m"}
    """,
    "progress by its absolute value": """
        truncation: {max_steps: 200}
        reward: {nearer: "50 * abs(delta(apart)) / m"}
    """,
    "progress by a condition": """
        truncation: {max_steps: 200}
        reward: {nearer: -50 * delta(apart) / m when delta(apart) < 0 m}
    """,
    "progress by a conditional expression": """
        truncation: {max_steps: 200}
        signals: {gain: previous(apart) - apart}
        reward: {nearer: 50 * gain / m if gain > 0 m else 0}
    """,
    "progress without the way back by clamp, written with frames": """
        truncation: {max_steps: 200}
        signals: {way: norm(position(epuck).xy - position(post).xy)}
        reward: {nearer: "50 * clamp(-delta(way), 0 .. 1 m) / m", time: -0.01}
    """,
    "a reward for each step towards the goal": """
        reward: {nearer: 1 when delta(apart) < 0 m}
    """,
    "a reward for being there": """
        reward: {alive: 0.2, there: 10 when arrived}
    """,
    "a reward for being there beside progress": """
        reward: {alive: 0.3, closer: -10 * delta(apart) / m, there: 10 when arrived}
    """,
    "a reward for standing still": """
        reward: {calm: "0.3 when norm(velocity(epuck)) < 1 cm/s", there: 10 when arrived}
    """,
    "a bonus at each visit of a region of two bounds": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
        reward: {there: 5 when arrived, doorbell: "4 when rising_edge(on_mat)", time: -0.01}
    """,
    "a bonus at each visit of a region that a counter counts": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          rings: "accumulate(1 if rising_edge(on_mat) else 0, 0 .. 500, 0)"
        reward: {there: 5 when arrived, doorbell: "4 * delta(rings)", time: -0.01}
    """,
    "pay for the time that passes": """
        reward: {service: 4 * delta(time) / s}
    """,
    "pay for the time that passes, written as a difference": """
        reward: {service: 4 * (time - previous(time)) / s}
    """,
}
"""Each upon `course.yaml`: the reward of a success, `there`, is 5."""

SOUND = {
    "progress": """
        reward: {closer: -10 * delta(apart) / m, time: -0.02}
    """,
    "progress beyond the best": """
        reward: {closer: -10 * delta(running_min(apart)) / m}
    """,
    "progress that is clamped on both sides": """
        reward: {closer: "-10 * clamp(delta(apart), -5 cm .. 5 cm) / m"}
    """,
    "the change of a potential": """
        signals: {pot: exp(-apart / (20 cm))}
        reward: {closer: 5 * (pot - previous(pot))}
    """,
    "a bonus that is paid once": """
        signals: {seen: "running_max(1 if apart < 25 cm else 0)"}
        reward: {first: 3 * delta(seen), there: 5 when arrived}
    """,
    "a bonus that leaving takes back": """
        signals: {inside: 1 if apart < 25 cm else 0}
        reward: {entered: 4 * delta(inside)}
    """,
    "a cost of being far": """
        reward: {near: exp(-apart / (20 cm)) - 1}
    """,
    "a cost until the success that has to be held": """
        reward: {there: 20 when arrived, out: -0.1 when apart > 5 cm}
        termination: {success: {arrived: duration(apart < 5 cm) > 1 s}}
    """,
    "a bonus too small to count": """
        signals: {inside: apart < 25 cm}
        reward: {there: 20 when arrived, entered: 0.01 when rising_edge(inside)}
    """,
    "a little pay while the success has to be held": """
        reward: {there: 20 when arrived, stay: 0.1 when apart < 5 cm, closer: -10 * delta(apart) / m}
        termination: {success: {arrived: duration(apart < 5 cm) > 1 s}}
    """,
    "a bonus for the first visit of a region, by the change of its memory": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          rung: running_max(1 if on_mat else 0)
        reward: {there: 5 when arrived, doorbell: "4 * delta(rung)", time: -0.01}
    """,
    "a bonus for the first visit of a region, at the edge of its memory": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          rung: running_max(1 if on_mat else 0)
        reward: {there: 5 when arrived, doorbell: "4 when rising_edge(rung > 0.5)", time: -0.01}
    """,
    "a bonus for the first visit of a region, at the edge of an integral": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          rung: running_max(1 if on_mat else 0)
        reward: {there: 5 when arrived, doorbell: "4 when rising_edge(integral(rung) > 0 s)", time: -0.01}
    """,
    "a bonus for the first visit of a region, by a comparison with the step before": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          rung: running_max(1 if on_mat else 0)
        reward: {there: 5 when arrived, doorbell: "4 if rung > 0.5 and previous(rung, 0) < 0.5 else 0", time: -0.01}
    """,
    "a bonus after five seconds in a region": """
        augment: {place: position(epuck).xy}
        observation: {place: -1.5 .. 1.5 m}
        signals:
          on_mat: abs(place.x - 10 cm) < 12 cm and abs(place.y) < 30 cm
          stayed: "integral(1 if on_mat else 0)"
        reward: {there: 5 when arrived, doorbell: "4 when rising_edge(stayed > 5 s)", time: -0.01}
    """,
    "pay for the time in a region up to a limit": """
        signals: {stayed: "min(integral(1 if apart < 25 cm else 0), 3 s)"}
        reward: {stay: 1 * delta(stayed) / s}
    """,
    "a bonus for the first three visits": """
        signals: {visits: "accumulate(1 if rising_edge(apart < 25 cm) else 0, 0 .. 3, 0)"}
        reward: {entered: 1 * delta(visits)}
    """,
    "progress against a signal of the step before": """
        truncation: {max_steps: 350}
        signals: {before: previous(apart)}
        reward: {closer: 30 * (before - apart) / m}
    """,
    "progress against the step before, each with its factor": """
        truncation: {max_steps: 350}
        signals: {before: previous(apart)}
        reward: {closer: 30 * before / m - 30 * apart / m}
    """,
    "the change of a potential of the step before": """
        signals: {before: previous(apart)}
        reward: {closer: 5 * (exp(-apart / (20 cm)) - exp(-before / (20 cm)))}
    """,
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for file in (HERE / "course.yaml", HERE.parents[1] / "robots" / "urdf" / "epuck.urdf"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, text: str) -> Path:
    file = folder / "planted.yaml"
    file.write_text(f"deepbots: 1\nextends: course.yaml\nname: Planted\n{dedent(text)}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("name", EXPLOITED)
def test_a_reward_that_pays_more_for_avoiding_the_success_is_found_before_training(
    name: str, folder: Path
) -> None:
    findings = api.lint(write(folder, EXPLOITED[name]))
    assert len(findings) == 1, findings
    assert findings[0].code in ("DB708", "DB716")


@pytest.mark.parametrize("name", SOUND)
def test_a_reward_that_sums_to_nothing_over_a_cycle_is_silent(name: str, folder: Path) -> None:
    assert api.lint(write(folder, SOUND[name])) == []


def test_the_finding_names_the_term_that_pays_and_the_cycle(folder: Path) -> None:
    (finding,) = api.lint(write(folder, EXPLOITED["a bonus where the distance crosses a limit"]))
    assert finding.code == "DB716"
    assert finding.span.text == "3 when apart < 25 cm and previous(apart) >= 25 cm"
    assert finding.notes == ("the cycle: `apart` is 0.2475 m for 1 step, then 0.2525 m for 1 step",)


def test_a_term_that_pays_while_the_success_is_held_is_interrupted_just_in_time(folder: Path) -> None:
    """`parked` paid 10 in each step of a parked car, and the success came only after some time."""
    (finding,) = api.lint(write(folder, EXPLOITED["paid in each step while the success has to be held"]))
    assert finding.code == "DB716"
    assert finding.span.text == "10 when parked"
    assert "for 5 steps, then" in finding.notes[0]


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("a bonus at each visit of a region of two bounds", "1.99"),
        ("a bonus at each visit of a region that a counter counts", "1.99"),
        ("pay for the time that passes", "0.4"),
        ("pay for the time that passes, written as a difference", "0.4"),
    ],
)
def test_the_pay_of_a_step_that_a_finding_names_can_be_reached(name: str, rate: str, folder: Path) -> None:
    """A bonus of 4 at each entry was said to pay 9.99 per step, where a visit takes two; 4 per second, 80 per
    step of 40 ms."""
    (finding,) = api.lint(write(folder, EXPLOITED[name]))
    assert f"earns up to {rate} per step" in finding.headline
    assert " stays " not in finding.notes[0] or "time" in name


# Limits of speed

FORWARD = """
truncation: {max_steps: 200}
reward: {there: 0, forward: velocity(epuck).x / (m/s)}
solved: mean_return >= 60 over 100 episodes
train: {algorithm: PPO, total_timesteps: 1000}
"""


@pytest.mark.parametrize(
    ("term", "highest"),
    [
        ("velocity(epuck).x / (m/s)", 200 * 0.1256),
        ("norm(velocity(epuck)) / (m/s)", 200 * 0.1256),
        ("100 * (position(epuck).x - previous(position(epuck).x)) / m", 100 * 20 * 0.1256),
        ("-100 * delta(ground_distance(epuck, post)) / m", 100 * 0.4),
        ("20 * max(0 m, -delta(ground_distance(epuck, post))) / m", 20 * 20 * 0.1256),
    ],
)
def test_a_required_return_beyond_the_limits_of_speed_is_out_of_reach(
    term: str, highest: float, folder: Path
) -> None:
    """200 steps of 0.1 s, and wheels that drive at 6.28 rad/s times 2 cm: 10 % above that the bound allows
    for tilting."""
    text = FORWARD.replace("velocity(epuck).x / (m/s)", f'"{term}"')
    program = api.compile(write(folder, text)).program
    bound = highest_return(Analysis(program))
    assert highest <= bound <= 1.101 * highest + 0.1
    (out,) = [
        finding
        for finding in api.lint(write(folder, text.replace(">= 60", f">= {1.01 * bound:.4f}")))
        if finding.code == "DB810"
    ]
    assert "limits of speed" in out.headline
    within = api.lint(write(folder, text.replace(">= 60", f">= {0.99 * bound:.4f}")))
    assert "DB810" not in {finding.code for finding in within}


@pytest.mark.parametrize(
    "change",
    [
        "disturbances: {push: {body: epuck, force: 1 0 0 N, at: 1 s, duration: 1 s}}",
        'world: {terrain: {type: formula, heights: "1 cm * sin(x / m * 900 deg)", size: 20 20 m}}',
        "reset: {place: {epuck: {velocity: 3 0 0 m/s}}}",
        "world: {gravity: 1 0 -9.81 m/s^2}",
    ],
)
def test_what_else_may_move_a_robot_leaves_its_return_without_bound(change: str, folder: Path) -> None:
    findings = api.lint(write(folder, FORWARD + change))
    assert "DB810" not in {finding.code for finding in findings}
    assert not any(finding.severity == "error" for finding in findings), findings


def test_statistics_take_no_bound_that_a_fall_may_exceed(folder: Path) -> None:
    program = api.compile(write(folder, FORWARD)).program
    assert possible_returns(program)[1] == float("inf")


@pytest.mark.parametrize("name", ["cartpole", "balancer", "quadrotor", "panda_reach"])
def test_robots_that_balance_fly_or_stand_fixed_have_no_limit_from_wheels(name: str) -> None:
    program = api.compile(name).program
    assert all(base_speed(Analysis(program), body.name) == float("inf") for body in program.world.robots)

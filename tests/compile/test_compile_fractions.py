"""Wherever a share of something is asked for, `80 %` means `0.8`."""

from __future__ import annotations

import pytest

from deepbots_cli.program.identity import to_json
from tests.compile.conftest import shipped_text

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


@pytest.fixture
def head(workshop) -> str:
    (workshop.file.parent / "cartpole.yaml").write_text(shipped_text("cartpole"), encoding="utf-8")
    return "deepbots: 1\nextends: cartpole.yaml\nname: Shares\n"


@pytest.mark.parametrize("place", PLACES)
def test_a_share_may_be_written_in_percent(workshop, head, place):
    text = f"{head}{PLACES[place]}\n"
    plain, percent = (workshop.compile(text.replace("SHARE", share)).program for share in ("0.8", "80 %"))
    assert to_json(percent) == to_json(plain)
    assert "0.8" in to_json(plain) or "0.2" in to_json(plain)


@pytest.mark.parametrize(
    ("line", "help"),
    [
        ("curriculum: [{name: one, until: success_rate >= 80 over 30 episodes}, {name: two}]", "80 %"),
        ("train: {gamma: 99}", "99 %"),
        ("solved: success_rate >= 80 over 100 episodes", "80 %"),
    ],
)
def test_a_share_in_hundredths_without_its_sign_is_told_the_sign(workshop, head, line, help):
    finding = next(found for found in workshop.lint(f"{head}{SUCCESS}{line}\n"))
    assert (finding.code, f"`{help}`" in finding.help) == ("DB105", True)


@pytest.mark.parametrize(
    "line", ["train: {gamma: 120 %}", "train: {gamma: -5 %}", "train: {gamma: lots}", "train: {gamma: 1 % 2}"]
)
def test_a_percentage_out_of_bounds_or_none_is_refused(workshop, head, line):
    assert set(workshop.codes(f"{head}{line}\n")) <= {"DB103", "DB105"}
    assert workshop.codes(f"{head}{line}\n")

"""The versions of a scenario that lint judges: itself, and with the settings of each stage and each case."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.lint import all_findings, simulate

pytestmark = pytest.mark.usefixtures("simulated_here")

NAMES = {"base": "", "stage": "in stage `first`, ", "case": "in case `other`, "}
EACH, TRAINED, EVERY = tuple(NAMES), ("base", "stage"), ("base",)
MISTAKES = {
    "DB312": ("wheel_speed: 500 rad/s", EACH),
    "DB411": ("reward.still: 1 when speed == 0 m/s", EACH),
    "DB507": ("objects.crate: {shape: box, size: 50 50 50 m, pose: {x: 1 m}}", EACH),
    "DB611": ("reset.place: {cart: {x: 0.45 m}}", EACH),
    "DB701": ("reward.near: 1 / abs(x / m)", EACH),
    "DB802": ("termination.failure.fallen: abs(cart.pole_angle) > -fall_angle", EACH),
    "DB806": ("reset.joints: {cart.pole_hinge: 16 deg}", EACH),
    "DB703": ("reward.failed: 5 when fallen", TRAINED),
    "DB805": ("termination.failure.late: time > 5 s", TRAINED),
    "DB801": ("termination.failure.late: step < 0", EVERY),
    "DB704": ("reward.off: 1 when step < 0", EVERY),
}
"""A setting that is a mistake, and the versions in which it is one: no policy trains in a case, and what never
holds in one version may hold in others."""
CARTPOLE = Path(__file__).parents[1] / "golden" / "lint" / "cartpole.yaml"


def settings_in(where: str, setting: str) -> list[str]:
    """The arguments of `--set` that write a setting into a version of CartPole."""
    key, _, value = setting.partition(": ")
    base = f"{key}={value}" if where == "base" else "summary=a stage and a case"
    stage, case = (
        f"{{{setting}}}" if where == kind else "{wheel_speed: 4 rad/s}" for kind in ("stage", "case")
    )
    stages = f"curriculum=[{{name: first, set: {stage}, until: 10_000 steps}}, {{name: last}}]"
    return ["action={drive: -1 .. 1}", base, stages, f"evaluation.cases={{other: {{set: {case}}}}}"]


@pytest.mark.parametrize("where", NAMES)
@pytest.mark.parametrize("code", MISTAKES)
def test_a_mistake_in_one_version_is_reported_once_with_its_name(code: str, where: str) -> None:
    setting, versions = MISTAKES[code]
    checked = api.load(CARTPOLE, overrides=settings_in(where, setting))
    headlines = [finding.headline for finding in all_findings(checked, preview=True) if finding.code == code]
    assert [headline.startswith(NAMES[where]) for headline in headlines] == [True] * (where in versions)
    assert where != "base" or not any(headline.startswith("in ") for headline in headlines)


def test_an_idle_test_is_judged_in_its_own_case() -> None:
    changes = [
        "evaluation.cases={wide: {set: {track: 1 m}}}",
        "tests={idle: {driver: random, case: wide, expect: {always: track > 0.5 m}}}",
    ]
    checked = api.load(CARTPOLE, overrides=changes, tests=True)
    headlines = [finding.headline for finding in all_findings(checked, preview=True)]
    assert headlines == ["in case `wide`, `always` of the test `idle` checks nothing: it is always met"]


@pytest.mark.parametrize("where", NAMES)
def test_an_error_in_the_simulation_of_a_version_names_it(where: str) -> None:
    constant = [
        "parameters.lit=1",
        "augment.shown=lit / 2",
        "observation.shown=0 .. 2",
    ]  # so that all versions are simulated
    changes = [*constant, *settings_in(where, "reward.alive: 1 / (step - 3)")]
    (finding,) = simulate(api.load(CARTPOLE, overrides=changes), preview=True).findings
    assert (finding.code, finding.headline) == ("DB707", f"{NAMES[where]}`alive` is not finite")

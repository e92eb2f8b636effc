"""Explanations of episodes: ending, time and margin are those of the recorded state, computed here without
deepbots' expressions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

pytest.importorskip("mcap")
from shapely.geometry import LinearRing, Point

from deepbots_cli.cli import main
from deepbots_cli.insight.episode import explain, explanation_json
from deepbots_cli.insight.trace import Trace, trace_recorded
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.frames import WorldFrame
from deepbots_cli.view.players import closing_player
from deepbots_cli.view.replay import ReplayPlayer

Frames = list[WorldFrame]


def _up(frame: WorldFrame, body: str, link: str) -> float:
    x, y, _, _ = frame.links[body, link][1]
    return math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y))))


def _cartpole(frames: Frames) -> dict[str, float]:
    last = frames[-1]
    (angle,) = last.messages["cart/from_robot"].values
    return {
        "fallen": abs(angle) - math.radians(15),
        "off_track": abs(last.links["cart", "body"][0][0]) - 0.39,
    }


def _balancer(frames: Frames) -> dict[str, float]:
    return {"fallen": _up(frames[-1], "bot", "body") - math.radians(35)}


def _quadrotor(frames: Frames) -> dict[str, float]:
    place = frames[-1].links["drone", "base_link"][0]
    away = math.dist(place, (0, 0, 1)) - 1.5
    return {
        "lost": away,
        "flipped": _up(frames[-1], "drone", "base_link") - math.radians(100),
        "crashed": math.nan,
    }


_TRACK = LinearRing([(-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (0, 0.1), (-0.6, 0.4)])


def _line_follower(frames: Frames) -> dict[str, float]:
    beyond = [_TRACK.distance(Point(frame.links["rover", "base_link"][0][:2])) > 0.04 for frame in frames[1:]]
    held = next((n for n, is_beyond in enumerate(reversed(beyond)) if not is_beyond), len(beyond))
    return {"lost": held * 0.032 - 1.0}


CASES: dict[str, tuple[str, Callable[[Frames], dict[str, float]], float]] = {
    "cartpole": ("random", _cartpole, 0.0),
    "balancer": ("random", _balancer, 0.0),
    "quadrotor": (
        "random",
        _quadrotor,
        0.01,
    ),  # an episode may end after the first of the two timesteps of a step
    "line_follower": ("random", _line_follower, 0.0),
}


def _check(scenario: str, path: Path, count: int) -> None:
    driver, independent, slack = CASES[scenario]
    with closing_player(Showing(scenario), driver) as world:
        recordings.record(world, path, 11, range(count))
    opened = Showing(str(path)).open()
    failed = 0
    with closing(ReplayPlayer(opened)) as replayed:
        for trace, recorded in zip(
            trace_recorded(opened, opened.recording.episodes), opened.recording.episodes, strict=True
        ):
            frames = [replayed.begin(0, recorded.number)] if recorded.number else [replayed.begin(0, 0)]
            frames += [replayed.seek(place) for place in range(1, replayed.length)]
            last = frames[-1]
            data = explanation_json(trace, explain(trace))
            assert (data["ended_by"], data["steps"]) == (last.ended_by, last.step)
            assert last.time - slack - 1e-9 <= data["time"] <= last.time + 1e-9
            assert data["return"] == pytest.approx(
                last.agents[next(iter(last.agents))].episode_return, abs=1e-9
            )
            assert data["moment"] is None or data["moment"]["time"] < data["time"]
            if last.truncated:
                assert data["outcome"] == "time limit"
                assert data["end"]["margin"] == pytest.approx(0.0, abs=1e-9)
                continue
            failed += 1
            assert data["outcome"] == "failure"
            expected = independent(frames)[last.ended_by]
            if math.isnan(
                expected
            ):  # a fact has no margin; a rotor reaches 6 cm, and may have left the ground again in the same step
                assert data["end"]["holds"]
                assert "margin" not in data["end"]
                assert last.forces or last.links["drone", "base_link"][0][2] < 0.06
            else:
                assert data["end"]["margin"] == pytest.approx(expected, abs=1e-6)
                assert expected > -1e-9
                assert data["end"]["value"] - data["end"]["bound"] == pytest.approx(
                    data["end"]["margin"], abs=1e-12
                )
    assert failed == count


@pytest.mark.slow
@pytest.mark.parametrize("scenario", CASES)
def test_ending_time_and_margin_are_those_of_the_recorded_state(scenario, tmp_path):
    _check(scenario, tmp_path / "few.mcap", 3)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", CASES)
def test_they_are_in_fifty_failed_episodes(scenario, tmp_path):
    _check(scenario, tmp_path / "many.mcap", 50)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "cartpole.mcap"
    with closing_player(Showing("cartpole"), "random") as world:
        recordings.record(world, path, 3, [0, 1])
    return path


def _traced(path: Path, number: int = 0) -> Trace:
    opened = Showing(str(path)).open()
    return next(trace_recorded(opened, [opened.recording.episode(number)]))


def test_every_sentence_has_a_number(recording):
    statements = explain(_traced(recording, 1))
    assert {"ending", "margin", "terms", "choices"} <= {each.cause for each in statements}
    assert all(any(sign.isdigit() for sign in each.text) for each in statements)


def test_endings_with_and_or_and_not(tmp_path):
    """Of a condition with several comparisons, the one that has just become true is named, with `not` taken
    into its sign."""
    ending = "not (abs(x) <= track) or (abs(cart.pole_angle) > fall_angle and step >= 3)"
    with closing_player(
        Showing("cartpole", overrides=[f"termination.failure={{over: {ending}}}"]), "random"
    ) as world:
        recordings.record(world, tmp_path / "one.mcap", 3, [0])
    trace = _traced(tmp_path / "one.mcap")
    end = explanation_json(trace, explain(trace))["end"]
    assert end["condition"] == "abs(cart.pole_angle) > fall_angle"
    assert end["bound"] == pytest.approx(math.radians(15))
    assert end["margin"] > 0


@pytest.mark.parametrize("length", [0.3, 0.9])
def test_a_recording_that_is_cut_is_refused_in_a_sentence(recording, tmp_path, length, capsys):
    data = recording.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * length)])
    assert main(["diagnose", str(cut)]) == 2
    assert "cut short or damaged" in capsys.readouterr().err


def test_an_episode_that_is_another_one_here_is_refused(recording):
    """As if another version had recorded it: the same file, read as if its observations were others."""
    opened = Showing(str(recording)).open()
    first, second = opened.recording.episodes
    swapped = type(first)(first.number, first.seed, [first.steps[0], *second.steps[1:]])
    with pytest.raises(Exception, match="differs from its recording at step 1"):
        list(trace_recorded(opened, [swapped]))


def test_an_argument_that_is_not_an_episode_is_refused_in_a_sentence(recording, tmp_path, capsys):
    for shown, words in [
        (str(tmp_path), "is not a run"),
        ("nothing.mcap", "no file, folder or shipped scenario"),
        ("nothing.json", "is missing"),
    ]:
        assert main(["diagnose", shown]) in (1, 2)
        assert words in capsys.readouterr().err
    assert main(["diagnose", str(recording), "--episode", "9"]) == 2
    assert "contains no episode 9; it contains 0 to 1" in capsys.readouterr().err


def test_json_has_the_same_statements(recording, capsys):
    assert main(["diagnose", str(recording), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [each["text"] for each in data["statements"]] == [
        each.text for each in explain(_traced(recording))
    ]
    assert data["end"]["margin"] > 0


@pytest.mark.parametrize(
    ("success", "needed", "value"),
    [
        (
            "time > 0.1 s and abs(cart.pole_angle) < 0.001 deg",
            "abs(cart.pole_angle) < 0.001 deg",
            "deg",
        ),  # time held in the end
        ("abs(x) < 1 m and time > 60 s", "time > 60 s", "s"),
        ("time > 0.1 s and (x > 1 m or tip_speed > 99 m/s)", "x > 1 m", "m"),
    ],
)
def test_the_condition_that_a_missed_success_lacks_is_named_and_not_one_that_held(
    tmp_path, success, needed, value
):
    with closing_player(
        Showing("cartpole", overrides=[f"termination.success={{kept: {success}}}"]), "random"
    ) as world:
        recordings.record(world, tmp_path / "one.mcap", 3, [0])
    trace = _traced(tmp_path / "one.mcap")
    assert trace.outcome == "failure"
    (statement,) = [each for each in explain(trace) if each.cause == "nearest"]
    assert f"'kept' requires {needed}; " in statement.text
    assert not statement.evidence["holds"]
    assert statement.evidence["margin"] < 0
    assert f" {value}, at " in statement.text


def test_a_missed_duration_is_explained_by_the_comparisons_inside_it(tmp_path):
    sets = [
        "signals={rest: duration(abs(x) < 1 mm and abs(speed) < 0.001 mm/s)}",
        "termination.success={rested: rest > 0.3 s}",
    ]
    with closing_player(Showing("cartpole", overrides=sets), "random") as world:
        recordings.record(world, tmp_path / "one.mcap", 3, [0])
    trace = _traced(tmp_path / "one.mcap")
    (statement,) = [each for each in explain(trace) if each.cause == "conditions"]
    near, slow = statement.evidence["conditions"]
    assert near["condition"] == "abs(x) < 1 mm"
    assert near["bound"] == pytest.approx(1e-3)
    assert near["step"] == 0
    assert (slow["condition"], slow["bound"]) == ("abs(speed) < 0.001 mm/s", pytest.approx(1e-6))
    assert near["steps"] > 0
    assert "`abs(x) < 1 mm` was true in" in statement.text
    assert " at 0.00 s, threshold 0.001 m" in statement.text


def test_the_time_in_which_a_cost_arose_is_named(tmp_path):
    sets = ["reward={alive: 0.01, late: -1 when step > 5 and step < 9}"]
    with closing_player(Showing("cartpole", overrides=sets), "random") as world:
        recordings.record(world, tmp_path / "one.mcap", 3, [0])
    trace = _traced(tmp_path / "one.mcap")
    (statement,) = [each for each in explain(trace) if each.cause == "concentrated_rewards"]
    begin, end = statement.evidence["spans"]["late"]
    assert end - begin == pytest.approx(3 * trace.program.period)
    assert f"late from {begin:.2f} s to {end:.2f} s" in statement.text

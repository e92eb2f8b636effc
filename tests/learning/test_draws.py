"""Which drawn values have an effect on episodes, and which only seem to."""

from __future__ import annotations

import numpy as np
import pytest

from deepbots_cli import compile
from deepbots_cli.learning.runs.draws import DrawnEffects, draw_labels, drawn_effects
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.learning.runs.evaluations import DrawLabel
from deepbots_cli.rollout import Episode

RISE = {"rise": DrawLabel(is_parameter=True)}


def _labels(name: str) -> dict[str, DrawLabel]:
    compiled = compile(name)
    return draw_labels(compiled.program, compiled.units)


def _logit(rate: float) -> float:
    return float(np.log(rate / (1 - rate)))


def _evaluation(seed: int, low: float, high: float, episodes: int = 500, draws: int = 60) -> DrawnEffects:
    """An evaluation in which the first of the draws, `rise`, has an effect.

    The success rate is `low` at the lower quartile of `rise` and `high` at the upper one.
    """
    generator = np.random.default_rng(seed)
    drawn = generator.random((episodes, draws))
    trend = _logit(low) + (_logit(high) - _logit(low)) * (drawn[:, 0] - 0.25) / 0.5
    succeeds = generator.random(episodes) < 1 / (1 + np.exp(-trend))
    names = ["rise", *(f"robots.dog.links.link_{number}.mass" for number in range(draws - 1))]
    done = [
        Episode(
            float(success),
            10,
            bool(success),
            None,
            seed=number,
            drawn=dict(zip(names, row.tolist(), strict=True)),
        )
        for number, (success, row) in enumerate(zip(succeeds, drawn, strict=True))
    ]
    return drawn_effects(done, RISE)


def _named(effects: DrawnEffects) -> list[str]:
    return [value.name for value in effects.effective]


def _from(values: list[float | str], successes: list[bool], name: str = "value") -> DrawnEffects:
    return drawn_effects(
        [
            Episode(0.0, 1, success, None, drawn={name: value})
            for value, success in zip(values, successes, strict=True)
        ]
    )


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ([*range(1, 9)] * 4, [(1, 2), (3, 4), (5, 6), (7, 8)]),
        ([*range(1, 8)] * 4, [(1, 1), (2, 3), (4, 5), (6, 7)]),
        ([0] * 28 + [*range(1, 9)], [(0, 0), (1, 8)]),
    ],
)
def test_equal_values_are_in_one_quarter(values: list[float | str], parts: list[tuple[int, int]]) -> None:
    (value,) = _from(values, [number % 2 == 0 for number in range(len(values))]).values.values()
    assert [(part.low, part.high) for part in value.parts] == parts


def test_each_word_is_a_part_of_its_own() -> None:
    words = ["apple", "box", "can", "disc", "egg", "fork", "glass", "hook"]
    (value,) = _from([*words] * 4, [number % 2 == 0 for number in range(32)]).values.values()
    assert [(part.low, part.high) for part in value.parts] == [(word, word) for word in words]


def test_without_a_drawn_value_nothing_is_concluded() -> None:
    assert drawn_effects([Episode(1.0, 1, True, None)] * 9).conclusion == "no drawn value varies"


def test_noise_of_sixty_draws_names_none() -> None:
    effects = _evaluation(seed=3, low=0.8, high=0.8)
    assert _named(effects) == []
    assert "none of the 60 drawn values has an effect on success" in effects.conclusion


def test_the_parameter_that_matters_comes_first_among_sixty_draws() -> None:
    assert _named(_evaluation(seed=3, low=0.95, high=0.75)) == ["rise"]


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.98, 0.95, 0.8, 0.5])
def test_at_most_three_of_thirty_evaluations_without_an_effect_name_a_draw(rate: float) -> None:
    assert sum(bool(_named(_evaluation(seed, rate, rate))) for seed in range(100, 130)) <= 3


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high"), [(0.95, 0.75), (0.9, 0.7), (0.6, 0.4)])
def test_twenty_points_between_the_quartiles_come_first_in_27_of_30_evaluations(
    low: float, high: float
) -> None:
    first = [_named(_evaluation(seed, low, high))[:1] for seed in range(200, 230)]
    assert first.count(["rise"]) >= 27


def test_an_evaluation_without_an_effect_says_which_one_it_would_have_found() -> None:
    few = _evaluation(3, 0.8, 0.8, episodes=200, draws=5)
    many = _evaluation(3, 0.8, 0.8, episodes=1_000, draws=5)
    assert few.detectable is not None
    assert many.detectable is not None
    assert few.detectable == pytest.approx(np.sqrt(5) * many.detectable, rel=0.15)
    assert f"a difference of {100 * few.detectable:.0f} percentage points" in few.conclusion
    assert "too few to find one" in _evaluation(3, 0.8, 0.8, episodes=8, draws=5).conclusion


def test_parameters_of_the_scenario_come_before_other_values_with_an_effect() -> None:
    done = [
        Episode(
            0.0,
            1,
            number >= 50,
            None,
            drawn={"robots.dog.links.trunk.mass": number, "rise": number + 40 * (number % 2)},
        )
        for number in range(100)
    ]
    assert _named(drawn_effects(done, RISE)) == ["rise", "robots.dog.links.trunk.mass"]
    assert _named(drawn_effects(done)) == ["robots.dog.links.trunk.mass", "rise"]


def test_a_value_that_is_best_in_its_middle_has_no_trend() -> None:
    values = [number / 400 for number in range(400)]
    assert _named(_from(values, [0.25 <= value < 0.75 for value in values])) == []


def test_a_rare_option_and_a_rare_failure_that_meet_once_are_not_an_effect() -> None:
    # One of 5 starts of 500 that drew 1 fails, and 9 others: by chance, this happens in 9.7 % of evaluations.
    values = [1.0] * 5 + [0.0] * 495
    effect = _from(values, [number not in (0, *range(100, 109)) for number in range(500)]).values["value"]
    assert effect.chance == pytest.approx(0.097, abs=0.002)


def test_words_have_an_effect_without_an_order() -> None:
    words: list[float | str] = ["cube", "ball", "plank"] * 40
    assert _named(_from(words, [word == "ball" for word in words])) == ["value"]
    assert _named(_from(words, [number % 2 == 0 for number in range(120)])) == []


def test_the_return_counts_where_all_episodes_succeed() -> None:
    done = [Episode(float(number), 1, True, None, drawn={"near": number / 50}) for number in range(50)]
    effects = drawn_effects(done)
    assert effects.outcome == "return"
    assert _named(effects) == ["near"]


def test_episodes_with_one_outcome_are_not_called_too_few() -> None:
    effects = drawn_effects(
        [Episode(200.0, 1, True, None, drawn={"near": number / 50}) for number in range(50)]
    )
    assert (
        effects.conclusion
        == "the drawn value does not have an effect on the return (all episodes have the same one)"
    )


def test_episodes_of_several_policies_from_one_start_count_once() -> None:
    done = [
        Episode(0.0, 1, start % 3 == 0, None, seed=start, drawn={"near": float(start)}) for start in range(12)
    ]
    assert drawn_effects(done * 5).starts == 12
    assert drawn_effects(done * 5).values["near"].chance == drawn_effects(done).values["near"].chance


def test_the_parts_of_a_value_count_every_episode_once() -> None:
    done = [
        Episode(0.0, 1, k >= 50, None, seed=k, drawn={"mass": k / 100, "which": "ab"[k % 2]})
        for k in range(100)
    ]
    values = drawn_effects(done).values
    assert list(values) == ["mass", "which"]
    assert [(part.low, part.high, part.episodes, part.success_rate) for part in values["mass"].parts] == [
        (0.0, 0.24, 25, 0.0),
        (0.25, 0.49, 25, 0.0),
        (0.5, 0.74, 25, 1.0),
        (0.75, 0.99, 25, 1.0),
    ]
    options = [(part.low, part.high, part.episodes, part.successes) for part in values["which"].parts]
    assert options == [("a", "a", 50, 25), ("b", "b", 50, 25)]
    assert values["mass"].parts[0].success_interval == Summary.of_episodes(done[:25]).success_interval


def test_single_copies_of_a_group_are_left_out_of_the_drawn_values() -> None:
    drawn = (
        "reset.layouts.scattered.crate#2.x",
        "objects.crate#1.one_of",
        "cart#1.reset.place.cart.x",
        "robots.dog.force#1.x",
    )
    done = [
        Episode(float(k), 1, k >= 50, None, seed=k, drawn=dict.fromkeys(drawn, k / 100)) for k in range(100)
    ]
    assert sorted(drawn_effects(done).values) == ["cart#1.reset.place.cart.x", "robots.dog.force#1.x"]


def test_a_draw_that_is_not_a_number_in_a_damaged_log_is_left_out() -> None:
    done = [
        Episode(0.0, 1, k >= 5, None, drawn={"mixed": ["a", 1.0][k % 2], "nan": float("nan"), "x": float(k)})
        for k in range(10)
    ]
    assert list(drawn_effects(done).values) == ["x"]


def test_values_have_the_units_of_the_scenario_and_a_drawn_factor_is_called_one() -> None:
    labels = _labels("quadruped")
    assert labels["robots.dog.links.trunk.mass"].unit.text == "(factor)"
    hinge = _labels("cartpole")["reset.joints.cart.pole_hinge"]
    assert hinge.unit.text == "deg"
    assert hinge.is_parameter is False
    assert _labels("panda_push")["mark.x"].is_parameter
    done = [Episode(0.0, 1, k >= 5, None, drawn={"hinge": np.radians(k)}) for k in range(5)]
    part = drawn_effects(done, {"hinge": hinge}).values["hinge"].parts[3]
    assert hinge.range_text(part) == "3 deg"

"""The search spaces of `tune`: how they are written, and which values are refused."""

from __future__ import annotations

from deepbots_cli import api
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.scenario.search import SearchSpace


def searched(search: str) -> CheckedScenario:
    return api.load("cartpole", overrides=[f"tune.search={{{search}}}"], tests=True)


def spaces(search: str) -> dict[str, SearchSpace]:
    checked = searched(search)
    assert list(checked.findings) == []
    return dict(checked.search)


def headlines(search: str) -> list[str]:
    return [f"{found.code} {found.headline}" for found in searched(search).findings]


def test_a_range_has_units_and_a_logarithm():
    found = spaces("fall_angle: 10..20deg, track: 30 cm .. 0.39 m, train.learning_rate: 1e-4..1e-2:log")
    assert found["fall_angle"] == SearchSpace(low=10, high=20, unit="deg")
    assert found["track"] == SearchSpace(low=0.3, high=0.39, unit="m")
    assert found["train.learning_rate"] == SearchSpace(low=1e-4, high=1e-2, log=True)


def test_a_key_of_whole_numbers_gets_whole_numbers_and_any_other_key_fractions():
    found = spaces("train.n_epochs: 5 .. 20, train.ent_coef: 0 .. 1")
    assert [space.whole for space in found.values()] == [True, False]
    assert [space.text(value) for space, value in zip(found.values(), (7.0, 0.12345), strict=True)] == [
        "7",
        "0.123",
    ]


def test_choices_are_written_with_bars_or_as_a_list():
    found = spaces(
        "train.network.activation: tanh | relu, train.network.hidden: [[10, 10], [64, 64]], train.gamma:"
        " [0.9, 0.99]"
    )
    assert [space.choices for space in found.values()] == [
        ("tanh", "relu"),
        ("[10, 10]", "[64, 64]"),
        ("0.9", "0.99"),
    ]


def test_a_value_is_rounded_and_stays_in_its_range():
    space = SearchSpace(low=0.99996, high=0.99998, unit="m")
    assert [space.text(value) for value in (0.99996, 0.999973456, 0.99998)] == [
        "0.99996 m",
        "0.99997346 m",
        "0.99998 m",
    ]
    assert SearchSpace(low=1e-5, high=1e-2, log=True).text(0.000123456) == "0.0001235"


def test_a_text_of_the_scenario_is_a_value_of_the_space_or_none():
    assert SearchSpace(low=10, high=20, unit="deg").value_of("15 deg") == 15
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("39 cm") == 0.39
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("0.7 m") is None
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("uniform(0.1 .. 0.2 m)") is None
    assert SearchSpace(choices=("tanh", "relu")).value_of("relu") == "relu"


def test_what_cannot_be_searched_is_said_at_its_place():
    assert headlines("train.lerning_rate: 1e-4 .. 1e-2") == ["DB101 unknown key `lerning_rate` in `train`"]
    assert headlines("fall_angl: 1 .. 2 deg") == ["DB201 there is no parameter `fall_angl`"]
    assert headlines("train.gamma: 0.9 .. 1.2") == ["DB105 `1.2` is above the largest allowed value"]
    assert headlines("train.n_epochs: 5.5 .. 20") == ["DB103 expected a whole number, found the number `5.5`"]
    assert headlines("track: 0.2 .. 0.4") == ["DB503 a length (m) is combined with a plain number"]
    assert headlines("train.network.activation: tanh | relux") == ["DB104 unknown word `relux`"]
    assert headlines("track: 0.2 m .. 0.3 m, parameters.track: 0.2 .. 0.4 m") == [
        "DB202 `parameters.track` is already searched"
    ]
    assert headlines("solved: a | b") == ["DB407 a search cannot change `solved`"]
    assert headlines("train.total_timesteps: 10 .. 20") == [
        "DB407 a search cannot change `train.total_timesteps`"
    ]
    assert headlines("train.ent_coef: 0 .. 1 :log") == ["DB105 `0 .. 1 :log` has no logarithm at its low end"]
    assert headlines("train.gamma: 0.99 .. 0.9") == ["DB105 the range `0.99 .. 0.9` is empty"]
    assert headlines("train.batch_size: 64") == ["DB103 expected a range or choices, found the number `64`"]
    assert headlines("observation.x: -1 .. 1 m | -2 .. 2 m") == [
        "DB613 `observation.x: -1 .. 1 m` changes the interface of the policy"
    ]


def test_a_run_keeps_the_scenario_without_the_search():
    compiled = api.compile(searched("fall_angle: 10 .. 20 deg"))
    assert "tune" not in compiled.resolved
    assert compiled.digest == api.compile("cartpole").digest

"""Groups and layouts: copies come and go, and stand where the layout of the episode puts them."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

GROUPED = Path(__file__).with_name("grouped.yaml")
NAMES = ("turned", "crates", "things", "nearest", "room", "some", "every")


def in_units(observation: Any) -> dict[str, float]:
    """The observation in the units of the scenario."""
    scale = {"crates": 5.0, "things": 5.0, "nearest": 5.0, "room": 5.0}
    return {
        name: (value + 1.0) * scale[name] if name in scale else value
        for name, value in zip(NAMES, observation.tolist(), strict=True)
    }


def place(environment: Supervisor, body: str) -> tuple[float, float, float]:
    return environment.engine.pose(body)()[0]


def test_reductions_go_over_the_copies_that_are_there(make: Make) -> None:
    environment = make(GROUPED, "reset.layout=scattered")
    observation, _ = environment.reset(seed=0)
    counts = Counter()
    for _ in range(60):
        observation, _ = environment.reset()
        there = in_units(observation)
        number = round(there["crates"])
        cart = place(environment, "cart")
        away = [math.dist(cart, place(environment, f"crate#{index + 1}")) for index in range(number)]
        assert there["nearest"] == pytest.approx(min(away, default=9.0), abs=1e-5)
        assert there["some"] == bool(number)
        assert there["every"] == (not number)
        assert round(there["things"]) == 2
        counts[number] += 1
    assert set(counts) == {0, 1, 2, 3, 4}


def test_absent_copies_touch_nothing_and_are_not_a_gap(make: Make) -> None:
    environment = make(GROUPED, "reset.layout=row", "parameters.crates=2")
    observation, _ = environment.reset(seed=0)
    assert in_units(observation)["things"] == pytest.approx(0.0, abs=1e-6)
    assert environment.engine.clearance(("cart", None), ("thing#1", None))() == math.inf
    assert [place(environment, f"crate#{number}")[:2] for number in (1, 2)] == [
        pytest.approx((0.1, -0.5)),
        pytest.approx((0.3, -0.5)),
    ]


@pytest.mark.slow
def test_layouts_are_drawn_in_their_shares(make: Make) -> None:
    environment = make(GROUPED)
    environment.reset(seed=1)
    drawn: Counter[str] = Counter()
    draw = environment.bodies.layout

    def counted(*arguments: Any) -> str:
        drawn[name := draw(*arguments)] += 1
        return name

    environment.bodies.layout = counted
    for _ in range(2000):
        environment._begin()
    total = drawn.total()
    for name, share in {"scattered": 0.5, "row": 0.2, "drawn": 0.3}.items():
        assert abs(drawn[name] - share * total) < 4 * math.sqrt(share * (1 - share) * total)


def test_a_map_puts_each_letter_on_its_cell_and_draws_which_where_there_are_more(
    make: Make,
) -> None:
    environment = make(GROUPED, "reset.layout=drawn", "parameters.crates=2")
    environment.reset(seed=0)
    cells = {(-0.8, 0.8), (0.4, 0.0), (0.8, 0.0), (0.4, -0.4), (0.4, -0.8)}
    used = set()
    for _ in range(40):
        environment.reset()
        assert place(environment, "cart") == pytest.approx((-0.4, -0.8, 0.0), abs=1e-9)
        assert place(environment, "flag") == pytest.approx((0.0, 0.8, 0.1), abs=1e-9)
        crates = [
            tuple(round(at, 6) for at in place(environment, f"crate#{number}")[:2]) for number in (1, 2)
        ]
        assert crates[0] != crates[1]
        used.update(crates)
        walls = {
            tuple(round(at, 6) + 0.0 for at in place(environment, f"drawn wall#{number}")[:2])
            for number in (1, 2, 3)
        }
        assert walls == {(-0.8, 0.4), (-0.8, 0.0), (-0.4, 0.0)}
    assert used == cells


def test_walls_of_a_map_are_there_only_in_its_layout(make: Make) -> None:
    environment = make(GROUPED)
    gap = environment.engine.clearance(("cart", None), ("drawn wall#1", None))
    environment.reset(seed=0)
    finite = []
    for _ in range(30):
        environment.reset()
        finite.append((math.isfinite(gap()), environment.bodies.present["drawn wall"]))
    assert set(finite) == {(True, 3), (False, 0)}


def test_every_copy_draws_its_own_mass_and_kind(make: Make) -> None:
    environment = make(GROUPED, "reset.layout=scattered", "parameters.crates=4")
    masses: list[tuple[float, ...]] = []
    set_parameter = environment.engine.set_parameter
    drawn_masses: list[float] = []
    environment.engine.set_parameter = lambda parameter, owner, mass: (
        drawn_masses.append(mass),
        set_parameter(parameter, owner, mass),
    )
    kinds: Counter[str] = Counter()
    environment.reset(seed=0)
    for _ in range(50):
        drawn_masses.clear()
        environment.reset()
        masses.append(tuple(drawn_masses[-4:]))
        kinds.update(variant.name for variant in environment.bodies.forms.chosen.values())
    figures = np.array(masses)
    assert len({*figures.ravel().tolist()}) == figures.size
    assert np.abs(np.corrcoef(figures.T) - np.eye(4)).max() < 0.5
    assert 0.1 <= figures.min() < figures.max() <= 0.4
    assert 30 < kinds["ball"] < 70


def test_the_same_seed_gives_the_same_episodes_whatever_was_before(make: Make) -> None:
    def episodes(environment: Supervisor) -> list[bytes]:
        observations = [environment.reset(seed=9)[0].tobytes()]
        for _ in range(6):
            observations.append(environment.reset()[0].tobytes())
            observations += [environment.step(np.array([1.0]))[0].tobytes() for _ in range(5)]
        return observations

    fresh, used = make(GROUPED), make(GROUPED)
    used.reset(seed=3)
    for _ in range(12):
        used.step(np.array([0.5]))
    assert episodes(used) == episodes(fresh)

"""The formulas of generated code have the values of the trees of the language, to the bit."""

from __future__ import annotations

import math
import random

import pytest

from deepbots_cli.expressions.functions import FUNCTIONS, scalar_function
from deepbots_cli.expressions.functions.table import rotation
from deepbots_cli.expressions.scalar import Const, EngineRead, Op, Scalar
from deepbots_cli.frames import Frame
from deepbots_cli.runtime import formulas

_RANDOM = random.Random(0)


def pose() -> Frame:
    turn = [_RANDOM.gauss(0, 1) for _ in range(4)]
    length = math.hypot(*turn)
    place = tuple(_RANDOM.uniform(-1, 1) for _ in range(3))
    return place, tuple(part / length for part in turn)  # type: ignore[return-value]


def computed(tree: Scalar, poses: dict[str, Frame]) -> float:
    match tree:
        case Const(value):
            return value
        case EngineRead("position", (body,), axis):
            return poses[body][0]["xyz".index(axis or "x")]
        case EngineRead("orientation", (body,), axis):
            return poses[body][1]["xyzw".index(axis or "x")]
        case Op(name, args):
            return scalar_function(name)(*(computed(arg, poses) for arg in args))
    raise AssertionError(tree)


@pytest.mark.parametrize("name", [function.name for function in FUNCTIONS.values() if function.tree])
def test_a_function_of_poses_computes_what_its_tree_says(name: str) -> None:
    function = FUNCTIONS[name]
    assert function.tree is not None
    for _ in range(200):
        poses = {"one": pose(), "other": pose()}
        bodies = list(poses)[: len(function.params)]
        expected = computed(function.tree(*bodies), poses)
        assert getattr(formulas, name)(*(poses[body] for body in bodies)) == expected


def test_a_vector_as_a_body_sees_it_is_the_transposed_rotation_times_the_vector() -> None:
    for _ in range(200):
        body = pose()
        vector = [_RANDOM.uniform(-2, 2) for _ in range(3)]
        rows = [
            [computed(rotation("one", row, axis), {"one": body}) * vector[row] for row in range(3)]
            for axis in range(3)
        ]
        assert formulas.to_body_frame(body, vector) == tuple(row[0] + row[1] + row[2] for row in rows)


@pytest.mark.parametrize("helper", ["clamp", "wrap_angle"])
def test_a_helper_computes_what_the_function_says(helper: str) -> None:
    function = next(function for function in FUNCTIONS.values() if function.helper == helper)
    for _ in range(500):
        args = sorted(_RANDOM.uniform(-9, 9) for _ in function.arguments)
        args = [_RANDOM.uniform(-9, 9), *args[1:]]
        assert getattr(formulas, helper)(*args) == scalar_function(function.name)(*args)


def test_a_value_that_is_not_a_number_is_never_scaled() -> None:
    for use in (
        lambda x: formulas.scale(x, -1.0, 1.0),
        lambda x: formulas.scale_each([0.0, x], 0.0, 3.0),
        formulas.clip,
    ):
        with pytest.raises(FloatingPointError):
            use(math.nan)
    for beyond in (math.inf, -math.inf, math.nan):
        with pytest.raises(FloatingPointError):
            formulas.scale_freely(beyond, -1.0, 1.0)

"""Values of formulas, stateful functions and messages.

* The formulas of generated code have the values of the trees of the language, to the bit.
* Stateful functions, from the text of a scenario to the results of a step, against sequences worked out by
  hand.
* Messages are exact in every format, and data of another kind is never read as a message.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import message_formats
from deepbots_cli.errors import MessageError
from deepbots_cli.expressions.functions import FUNCTIONS, rotation, scalar_function
from deepbots_cli.expressions.scalar import Const, EngineRead, Op, Scalar
from deepbots_cli.frames import Frame
from deepbots_cli.insight.inspection import message_size
from deepbots_cli.program.robots import MessageField, MessageLayout
from deepbots_cli.runtime import Supervisor, formulas
from deepbots_cli.runtime.messages import (
    DECODING_ERRORS,
    Channel,
    Codec,
    FieldCodec,
    codec,
    layout_error,
    zero_values,
)
from deepbots_cli.runtime.streams import Streams
from tests.worlds import Make

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


DRIVES = (0.5, -0.25, 1.0, 1.0, -0.5)
NEARLY = 1e-8  # m/s; a motor of limited force leaves the speed so near to its target


def terms(environment: Supervisor, drives: Sequence[float] = DRIVES) -> dict[str, list[float]]:
    """Each reward term over an episode that takes these actions, to its end."""
    environment.reset(seed=0)
    rows = [
        environment.step(np.array([drive]))[4]["reward_terms"]
        for drive in drives
        if environment.ended_by is None
    ]
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("delta(drive)", [0.5, -0.75, 1.25, 0.0, -1.5]),
        ("delta(drive, 0.25)", [0.25, -0.75, 1.25, 0.0, -1.5]),
        ("previous(drive)", [0.0, 0.5, -0.25, 1.0, 1.0]),
        ("previous(drive, 7)", [7.0, 0.5, -0.25, 1.0, 1.0]),
        ("running_max(drive)", [0.5, 0.5, 1.0, 1.0, 1.0]),
        ("running_min(drive)", [0.0, -0.25, -0.25, -0.25, -0.5]),
        ("hold(drive, drive > 0.75)", [0.0, 0.0, 1.0, 1.0, 1.0]),
        ("hold(step, drive < 0)", [0.0, 2.0, 2.0, 2.0, 5.0]),
        ("low_pass(drive, 20 ms)", [0.25, 0.0, 0.5, 0.75, 0.125]),
        ("low_pass(drive, 0 s)", [0.5, -0.25, 1.0, 1.0, -0.5]),
        ("integral(drive) / s", [0.01, 0.005, 0.025, 0.045, 0.035]),
        ("accumulate(drive, -1 .. 1, 0)", [0.5, 0.25, 1.0, 1.0, 0.5]),
        ("accumulate(drive, -1 .. 1, -1)", [-0.5, -0.75, 0.25, 1.0, 0.5]),
        ("duration(drive > 0.75) / s", [0.0, 0.0, 0.02, 0.04, 0.0]),
        ("1 when rising_edge(drive > 0.4)", [1.0, 0.0, 1.0, 0.0, 0.0]),
        ("1 when previous(drive > 0.4)", [0.0, 1.0, 0.0, 1.0, 1.0]),
        ("delta(delta(drive))", [0.5, -1.25, 2.0, -1.25, -1.5]),
        ("delta(integral(drive)) / s", [0.01, -0.005, 0.02, 0.02, -0.01]),
        ("previous(previous(drive))", [0.0, 0.0, 0.5, -0.25, 1.0]),
    ],
)
def test_a_stateful_function_gives_the_sequence_of_its_definition(
    small: Make, expression: str, expected: list[float]
) -> None:
    assert terms(small(f'reward: {{a: "{expression}"}}'))["a"] == pytest.approx(expected, abs=1e-15)


def test_memory_advances_also_while_its_branch_is_not_taken(small: Make) -> None:
    values = terms(
        small(
            'reward: {late: "delta(drive) if step >= 4 else 0", held: "running_max(drive) if step == 5 else'
            ' 0"}'
        )
    )
    assert (values["late"], values["held"]) == ([0.0, 0.0, 0.0, 0.0, -1.5], [0.0, 0.0, 0.0, 0.0, 1.0])


def test_each_occurrence_in_the_text_has_a_memory_of_its_own(small: Make) -> None:
    values = terms(small('reward: {both: "delta(drive) + delta(drive)", twice: "2 * delta(drive)"}'))
    assert values["both"] == values["twice"]


def test_a_new_episode_starts_all_memory_anew(small: Make) -> None:
    environment = small(
        'reward: {a: delta(drive), b: running_max(drive), c: "accumulate(drive, -1 .. 1, 0.5)"}'
    )
    assert terms(environment) == terms(environment)


def test_rewards_may_remember_the_end_of_an_episode(small: Make) -> None:
    endings = "termination: {failure: {fast: drive > 0.9}}"
    sections = (
        f"{endings}\nreward: {{end: 1 when rising_edge(terminated), either: 1 when rising_edge(ended)}}"
    )
    assert terms(small(sections))["end"] == [0.0, 0.0, 1.0]


def test_memory_in_signals_and_endings_advances_once_per_step(small: Make) -> None:
    ending = "termination: {success: {done: duration(drive > 0.75) > 30 ms}}"
    environment = small(
        f"signals: {{total: integral(drive)}}\nreward: {{a: total / s, b: total / s}}\n{ending}"
    )
    assert terms(environment)["a"] == pytest.approx([0.01, 0.005, 0.025, 0.045])
    environment.reset(seed=0)
    assert [environment.step(np.array([drive]))[2] for drive in DRIVES[:4]] == [False, False, False, True]


def test_components_of_a_vector_are_remembered_apart(small: Make) -> None:
    environment = small(
        'signals: {both: "vector(drive, -2 * drive)"}\nreward: {most: "max(delta(both))", least:'
        ' "min(delta(both))"}'
    )
    values = terms(environment)
    assert values["most"] == pytest.approx([max(d, -2 * d) for d in (0.5, -0.75, 1.25, 0.0, -1.5)])
    assert values["least"] == pytest.approx([min(d, -2 * d) for d in (0.5, -0.75, 1.25, 0.0, -1.5)])


def test_two_signals_whose_slots_read_alike_do_not_share_a_memory(small: Make) -> None:
    """Component 1 of `v` and the second integral of `v_0` would both be called `memory_signals_v_0_1`."""
    signals = 'signals: {a: 1 * drive, v: "sum(integral(1 a a a))", v_0: "integral(a) + 10 * integral(a)"}\n'
    values = terms(small(signals + "reward: {v: v / s, v_0: v_0 / s}"))
    integral = np.cumsum([0.02 * drive for drive in DRIVES])
    assert values["v_0"] == pytest.approx(11 * integral)
    assert values["v"] == pytest.approx(3 * integral + 0.02 * np.arange(1, 6))


ON_BOARD = """\
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {type: joint_position, joint: slider}
      rate:  {type: joint_velocity, joint: slider}
    actuators:
      motor: {type: velocity_motor, joint: slider, max_torque: 10 N}
    emit: {place: place, rate: rate, soft: "low_pass(rate, 60 ms)", most: "running_max(rate)"}
    apply: {motor: "APPLY"}
"""
SEEN = (
    "reward: {rate: cart.rate * s / m, soft: cart.soft * s / m, most: cart.most * s / m, place:"
    " cart.place / m}"
)


@pytest.mark.parametrize("format", ["struct", "none"])
def test_what_a_robot_computes_on_board_advances_once_per_tick(small: Make, format: str) -> None:
    values = terms(
        small(SEEN, f"messages.format={format}", robot=ON_BOARD.replace("APPLY", "drive * 0.02 m/s"))
    )
    assert values["rate"] == pytest.approx([0.02 * drive for drive in DRIVES], abs=NEARLY)
    assert values["most"] == pytest.approx(np.maximum.accumulate([0.0, *values["rate"]])[1:])
    soft = 0.0
    for rate, filtered in zip(values["rate"], values["soft"], strict=True):
        soft += (rate - soft) / 4
        assert filtered == pytest.approx(soft)


@pytest.mark.parametrize("format", ["struct", "none"])
def test_what_a_robot_applies_may_remember_earlier_messages(small: Make, format: str) -> None:
    environment = small(
        SEEN,
        f"messages.format={format}",
        robot=ON_BOARD.replace("APPLY", "low_pass(drive, 20 ms) * 0.02 m/s"),
    )
    assert terms(environment)["rate"] == pytest.approx(
        [0.02 * held for held in (0.25, 0.0, 0.5, 0.75, 0.125)], abs=NEARLY
    )


def test_a_robot_may_apply_a_sensor_that_it_does_not_send(small: Make) -> None:
    """The sensors that it sends and those that it applies are read apart, and must not be taken for each
    other."""
    robot = ON_BOARD.replace(
        '{place: place, rate: rate, soft: "low_pass(rate, 60 ms)", most: "running_max(rate)"}', "[rate]"
    ).replace("APPLY", "place / s + drive * 0.02 m/s")
    environment = small(
        "reward: {rate: cart.rate * s / m, x: position(cart.cart).x / m}",
        "observation={cart.rate: -1 .. 1 m/s}",
        robot=robot,
    )
    values = terms(environment)
    before = [0.0, *values["x"][:-1]]
    assert values["rate"] == pytest.approx(
        [x + 0.02 * drive for x, drive in zip(before, DRIVES, strict=True)], abs=NEARLY
    )


TOLD = ON_BOARD.replace("    apply:", "    receive: {RECEIVE}\n    apply:")


@pytest.mark.parametrize("format", ["struct", "none"])
@pytest.mark.parametrize("received", ["position(cart.cart).x", "x", "cart.place", "previous(x) + delta(x)"])
def test_a_robot_receives_values_from_before_the_step(small: Make, format: str, received: str) -> None:
    robot = TOLD.replace("{RECEIVE}", f'{{push: drive, where: "{received}"}}').replace(
        "APPLY", "push * 0.02 m/s + where / s"
    )
    values = terms(
        small(f"signals: {{x: position(cart.cart).x}}\n{SEEN}", f"messages.format={format}", robot=robot)
    )
    before = [0.0, *values["place"][:-1]]
    assert values["rate"] == pytest.approx(
        [x + 0.02 * drive for x, drive in zip(before, DRIVES, strict=True)], abs=NEARLY
    )


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("accumulate(0.1 * drive, -2 .. 2, level)", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("accumulate(0.1 * drive, -2 .. 2, drive)", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("previous(drive, level)", [0.5, 0.5, -0.25, 1.0, 1.0]),
        ("delta(drive, level)", [0.0, -0.75, 1.25, 0.0, -1.5]),
        ("previous(level)", [0.5, 0.5, 0.6, 0.7, 0.8]),
        ("delta(level)", [0.0, 0.1, 0.1, 0.1, 0.1]),
        ("running_min(level)", [0.5] * 5),
        ("hold(level, level > 0.75)", [0.5, 0.5, 0.5, 0.8, 0.9]),
        ("low_pass(level, 20 ms)", [0.5, 0.55, 0.625, 0.7125, 0.80625]),
        ("accumulate(0.1 * drive, -2 .. 2, low_pass(level, 1 s))", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("running_max(drive)", [0.5, 0.5, 1.0, 1.0, 1.0]),
    ],
)
def test_a_received_start_is_kept(small: Make, expression: str, expected: list[float]) -> None:
    """A memory of `apply` that begins with a received value begins with that of the first message; actions
    are 0 at a reset."""
    robot = TOLD.replace("{RECEIVE}", '{level: "0.4 + 5 * time / s"}').replace(
        "APPLY", f"({expression}) * 0.02 m/s"
    )
    environment = small(SEEN, robot=robot)
    for _ in range(2):
        assert terms(environment)["rate"] == pytest.approx([0.02 * value for value in expected], abs=NEARLY)


def test_a_received_start_waits_for_a_late_message(small: Make) -> None:
    robot = TOLD.replace("{RECEIVE}", '{level: "0.4 + 5 * time / s"}').replace(
        "APPLY", "accumulate(0.1 * drive, -2 .. 2, level) * 0.02 m/s"
    )
    assert terms(small(SEEN, "messages.to_robot={latency: 40 ms}", robot=robot))["rate"] == pytest.approx(
        [0.02 * value for value in (0.0, 0.0, 0.55, 0.525, 0.625)], abs=NEARLY
    )


FORMATS = tuple(name for name in message_formats.FORMATS if name != "none")
LAYOUT = MessageLayout(
    "cart",
    "from_robot",
    (
        MessageField("angle", "rad"),
        MessageField("gyro", "rad/s", ("x", "y", "z")),
        MessageField("touch", "", dtype="bool"),
    ),
    0xFFFFFFFE,
)
FLOATS_ONLY = MessageLayout(
    "cart", "from_robot", (MessageField("angle", "rad"), MessageField("gyro", "rad/s", ("x", "y", "z"))), 7
)
EMPTY = MessageLayout("cart", "to_robot", (), 12345)
OTHER = MessageLayout("drone", "from_robot", LAYOUT.fields, 0xFFFFFFFD)
VALUES = (0.125, -0.0, 1e308, 5e-324, True)

finite = st.floats(allow_nan=False, allow_infinity=False)
every_format = pytest.mark.parametrize("format", FORMATS)


def bits(values: Any) -> list[object]:
    return [value if isinstance(value, bool) else struct.pack("<d", value) for value in values]


def reading(receiver: Codec, layout: MessageLayout, message: object) -> tuple[Any, ...] | None:
    """The values of a message as generated code of a receiver reads them, or None where it refuses the
    message."""
    count = sum(len(field.components) or 1 for field in layout.fields)
    try:
        stamp, *values = receiver.decode(message)
        if stamp != layout.layout_hash or len(values) != count:
            raise ValueError(stamp)
    except DECODING_ERRORS:
        return None
    return tuple(values)


@every_format
@given(angle=finite, gyro=st.tuples(finite, finite, finite), touch=st.booleans())
def test_every_format_carries_every_finite_number_to_the_last_bit(
    format: str, angle: float, gyro: tuple[float, float, float], touch: bool
) -> None:
    sender = codec(LAYOUT, format)
    stamp, *values = sender.decode(sender.encode(angle, *gyro, touch))
    assert (stamp, bits(values)) == (LAYOUT.layout_hash, bits((angle, *gyro, touch)))


@every_format
@pytest.mark.parametrize(
    "value",
    [-0.0, 5e-324, 2.2250738585072014e-308, 1e308, -1.7976931348623157e308, 0.1, math.pi, 2.0**53 + 2],
)
def test_the_ends_of_the_range_of_numbers_survive_a_message(format: str, value: float) -> None:
    sender = codec(FLOATS_ONLY, format)
    assert bits(sender.decode(sender.encode(value, value, value, value))[1:]) == bits((value,) * 4)


@every_format
def test_a_message_without_fields_still_has_the_hash_of_its_layout(format: str) -> None:
    sender = codec(EMPTY, format)
    assert list(sender.decode(sender.encode())) == [12345]


@every_format
def test_a_message_of_another_robot_is_recognized(format: str) -> None:
    foreign = codec(OTHER, format).encode(*VALUES)
    assert reading(codec(LAYOUT, format), LAYOUT, foreign) is None
    error = str(layout_error(LAYOUT, format, foreign, 3))
    assert "robot 'cart', from the robot, step 3: the message has another layout" in error


@every_format
def test_the_error_of_a_short_message_names_its_first_missing_field(format: str) -> None:
    partial = MessageLayout("cart", "from_robot", LAYOUT.fields[:1], LAYOUT.layout_hash)
    message = codec(partial, format).encode(0.5)
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert "field 'gyro.x' is missing" in str(layout_error(LAYOUT, format, message, 1))


@every_format
def test_a_message_with_too_many_values_is_refused(format: str) -> None:
    longer = MessageLayout(
        "cart", "from_robot", (*LAYOUT.fields, MessageField("more", "m")), LAYOUT.layout_hash
    )
    message = codec(longer, format).encode(*VALUES, 1.0)
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert "too many values" in str(layout_error(LAYOUT, format, message, 1))


@pytest.mark.parametrize(
    ("format", "message", "field"),
    [
        ("csv", "4294967294,0.5,here,0.0,0.0,True", "gyro.x"),
        ("csv", "4294967294,0.5,0.0,0.0,0.0,1.0", "touch"),
        ("json", b"[4294967294,0.5,0.0,null,0.0,true]", "gyro.y"),
        ("json", b"[4294967294,0.5,0.0,0.0,0.0,1]", "touch"),
        ("json", b"[4294967294,true,0.0,0.0,0.0,true]", "angle"),
    ],
)
def test_the_error_of_a_value_of_the_wrong_kind_names_its_field(
    format: str, message: object, field: str
) -> None:
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert f"field '{field}'" in str(layout_error(LAYOUT, format, message, 1))


@every_format
@pytest.mark.parametrize(
    "message",
    [
        None,
        7,
        1.5,
        [],
        {},
        object(),
        b"",
        "",
        b"\xff\xfe",
        "\ud800",
        b"[" * 100_000,
        b"\x91" * 100_000,
        "," * 1000,
    ],
)
def test_data_that_is_not_a_message_is_refused_in_words(format: str, message: object) -> None:
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert isinstance(layout_error(LAYOUT, format, message, 1), MessageError)
    assert len(str(layout_error(LAYOUT, format, message, 1))) < 400


def damage(message: bytes | str, data: st.DataObject) -> bytes | str:
    """The message with some of it cut out, overwritten, or more put in."""
    start = data.draw(st.integers(0, len(message)))
    end = data.draw(st.integers(start, len(message)))
    if isinstance(message, str):
        return message[:start] + data.draw(st.text("0123456789.,-eTrue \n\0", max_size=8)) + message[end:]
    return message[:start] + data.draw(st.binary(max_size=8)) + message[end:]


@every_format
@given(data=st.data())
def test_a_damaged_message_is_read_or_refused_but_never_breaks_the_reader(
    format: str, data: st.DataObject
) -> None:
    for layout, values in ((LAYOUT, VALUES), (FLOATS_ONLY, VALUES[:4]), (EMPTY, ())):
        sender = codec(layout, format)
        message = damage(sender.encode(*values), data)
        if reading(sender, layout, message) is None:
            assert "robot 'cart'" in str(layout_error(layout, format, message, 5))


@every_format
@given(
    message=st.one_of(
        st.binary(max_size=60),
        st.text(max_size=30),
        st.none(),
        st.integers(),
        st.lists(st.floats(), max_size=3),
    )
)
def test_garbage_is_refused_but_never_breaks_the_reader(format: str, message: object) -> None:
    if reading(codec(LAYOUT, format), LAYOUT, message) is None:
        assert isinstance(layout_error(LAYOUT, format, message, 5), MessageError)


@every_format
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_value_that_is_not_finite_arrives_unchanged(format: str, value: float) -> None:
    sender = codec(FLOATS_ONLY, format)
    values = reading(sender, FLOATS_ONLY, sender.encode(value, 0.0, 0.0, 0.0))
    assert values is not None
    assert values[0] == pytest.approx(value, nan_ok=True)


# The channel delivers at once, one value per field, and forgets at a reset
CHANNEL_FIELDS = (
    MessageField("angle", "rad"),
    MessageField("gyro", "rad/s", ("x", "y", "z")),
    MessageField("touch", "", (), "bool"),
)
CHANNEL = MessageLayout.from_fields("cart", "from_robot", CHANNEL_FIELDS)
MESSAGE = (0.1, [1.0, 2.0, 3.0], True)


def error_of(layout: MessageLayout, message: object) -> MessageError:
    return MessageError(f"{layout.robot} refuses {message!r}")


def channel(format: str = "struct") -> Channel:
    return Channel(FieldCodec(CHANNEL, format, error_of))


@pytest.mark.parametrize("format", message_formats.FORMATS)
def test_a_sent_message_is_received_by_fields(format: str) -> None:
    path = channel(format)
    path.send(MESSAGE)
    angle, gyro, touch = path.receive()
    assert ((angle, list(gyro), touch), len(path)) == (MESSAGE, 0)


def test_messages_arrive_in_order_and_a_new_episode_forgets_them() -> None:
    path = channel("none")
    path.send("old")
    path.send("new")
    assert (len(path), path.receive()) == (2, "old")
    path.begin(Streams(0))
    assert len(path) == 0


# Messages that hold pictures
PICTURE_FIELDS = (
    MessageField("speed", "m/s"),
    MessageField("camera", "", (), "uint8", (4, 6, 3)),
    MessageField("touch", "", dtype="bool"),
)
PICTURES = MessageLayout("rover", "from_robot", PICTURE_FIELDS, 99)
PICTURE = np.arange(72, dtype=np.uint8).reshape(4, 6, 3) * 3


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_carries_every_byte(format: str) -> None:
    sender = codec(PICTURES, format)
    message = sender.encode(0.5, PICTURE, True)
    stamp, speed, picture, touch = sender.decode(message)
    assert (stamp, speed) == (99, 0.5)
    assert touch is True
    assert picture.dtype == np.uint8
    assert np.array_equal(picture, PICTURE)
    assert message_size(PICTURES, format) == (None if format in ("csv", "json") else len(message))


@pytest.mark.parametrize("format", FORMATS)
def test_a_picture_of_another_size_is_refused(format: str) -> None:
    fields = (PICTURE_FIELDS[0], MessageField("camera", "", (), "uint8", (4, 5, 3)), PICTURE_FIELDS[2])
    receiver, sender = (
        codec(PICTURES, format),
        codec(MessageLayout("rover", "from_robot", fields, 99), format),
    )
    message = sender.encode(0.5, PICTURE[:, :5], True)
    with pytest.raises(DECODING_ERRORS):
        receiver.decode(message)
    assert "rover" in str(layout_error(PICTURES, format, message, 3))


@pytest.mark.parametrize("format", FORMATS)
def test_silence_is_a_black_picture(format: str) -> None:
    sender = codec(PICTURES, format)
    picture = sender.decode(sender.encode(*zero_values(PICTURES)))[2]
    assert picture.shape == (4, 6, 3)
    assert not picture.any()

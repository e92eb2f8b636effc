"""Devices of worlds against closed forms.

Motors, sensors, messages and recognition.
"""

from __future__ import annotations

import math
import statistics

import pytest

from tests.webots.exported_projects import (
    FLOOR,
    ROD_INERTIA,
    device,
    hinge,
    node,
    run,
    simulate,
    solid,
    turning,
)


def robot(devices: str, fields: str = "", mass: float = 1.0) -> str:
    """Return a robot in free space: a box of 20 cm."""
    return f"""DEF ROBOT Robot {{ {fields} children [ {devices} ] boundingObject Box {{ size 0.2 0.2 0.2 }}
      physics Physics {{ density -1 mass {mass} }} }}"""


def reading(simulation, name: str, period: int = 8):
    """Enable a sensor, and return it after its first measurement."""
    sensor = device(simulation, name)
    sensor.enable(period)
    simulation.run_step()
    return sensor


def readings(simulation, name: str, count: int, call: str = "getValues"):
    """Enable a sensor, and return what it reads after each step."""
    sensor = device(simulation, name)
    sensor.enable(8)
    values = []
    for _ in range(count):
        simulation.run_step()
        values.append(getattr(sensor, call)())
    return values


# Sampling


def test_a_sensor_measures_first_after_its_period_and_then_once_in_each():
    simulation = simulate(robot("GPS { }", "linearVelocity 1 0 0"), gravity=0)
    gps = device(simulation, "gps")
    gps.enable(24)
    readings = []
    for _ in range(7):
        simulation.run_step()
        readings.append(gps.getValues()[0])
    assert ([math.isnan(value) for value in readings[:2]], readings[2:]) == (
        [True, True],
        pytest.approx([0.024] * 3 + [0.048] * 2),
    )
    assert gps.getSamplingPeriod() == 24


def test_a_sensor_that_is_off_keeps_its_last_value():
    simulation = simulate(robot("GPS { }", "linearVelocity 1 0 0"), gravity=0)
    gps = reading(simulation, "gps")
    gps.disable()
    run(simulation, 1)
    assert (gps.getValues()[0], gps.getSamplingPeriod()) == (pytest.approx(0.008), 0)


def test_a_sampling_period_is_whole_basic_steps():
    simulation = simulate(robot("GPS { }", "linearVelocity 1 0 0"), 32, gravity=0)
    gps = device(simulation, "gps")
    gps.enable(33)
    simulation.run_step()
    assert math.isnan(gps.getValues()[0])
    simulation.run_step()
    assert gps.getValues()[0] == pytest.approx(0.064)


@pytest.mark.parametrize("period", [0, -1, 0.5, math.nan, math.inf])
def test_a_sampling_period_below_a_millisecond_is_refused(period: float):
    sensor = device(simulate(robot("Gyro { }")), "gyro")
    with pytest.raises(ValueError, match="at least 1 ms; write 8 for each basic time step"):
        sensor.enable(period)


# Motion


TURNED = 2 * 0.008


@pytest.mark.parametrize(
    ("sensor", "fields", "call", "expected"),
    [
        pytest.param(
            "Gyro { rotation 0 0 1 1.5707963 }",
            "angularVelocity 1 2 3",
            "getValues",
            [2, -1, 3],
            id="its own frame",
        ),
        pytest.param("Gyro { yAxis FALSE }", "", "getValues", [0, math.nan, 0], id="an axis that is off"),
        pytest.param(
            "Gyro { lookupTable [ -10 -1000 0, 10 1000 0 ] }",
            "angularVelocity 0 0 3",
            "getValues",
            [0, 0, 300],
            id="table",
        ),
        pytest.param("InertialUnit { }", "rotation 0 0 1 0.7", "getRollPitchYaw", [0, 0, 0.7], id="angles"),
        pytest.param(
            "InertialUnit { }",
            "rotation 0 0 1 0.7",
            "getQuaternion",
            [0, 0, math.sin(0.35), math.cos(0.35)],
            id="quaternion",
        ),
        pytest.param("Compass { }", "rotation 0 0 1 1.5707963", "getValues", [1, 0, 0], id="north"),
        pytest.param(
            "GPS { translation 0 0.1 0 }",
            "translation 1 2 3 angularVelocity 0 0 2",
            "getValues",
            [1 - 0.1 * math.sin(TURNED), 2 + 0.1 * math.cos(TURNED), 3],
            id="at its place",
        ),
        pytest.param(
            "GPS { translation 0 0.1 0 }", "angularVelocity 0 0 2", "getSpeed", 0.2, id="speed at its place"
        ),
        pytest.param(
            "GPS { resolution 0.25 }", "translation 0.4 0.3 -0.1", "getValues", [0.5, 0.25, 0], id="rounded"
        ),
    ],
)
def test_a_sensor_of_motion_measures(sensor: str, fields: str, call: str, expected):
    name = {"InertialUnit": "inertial unit"}.get(sensor.split()[0], sensor.split()[0].lower())
    values = getattr(reading(simulate(robot(sensor, fields), gravity=0), name), call)()
    assert values == pytest.approx(expected, rel=1e-3, abs=0.01, nan_ok=True)


def test_an_accelerometer_on_a_wheel_feels_the_centripetal_force():
    text = hinge(
        devices="RotationalMotor { maxTorque 1e6 }",
        end="""children [ Accelerometer { translation 0.5 0 0 } ]
      boundingObject Box { size 1 0.02 0.02 }""",
    )
    simulation = simulate(text, gravity=0)
    turning(simulation, 4)
    sensor = device(simulation, "accelerometer")
    sensor.enable(8)
    run(simulation, 1)
    x, y, z = sensor.getValues()
    assert (math.hypot(x, y, z), x) == (
        pytest.approx(4**2 * 0.5, rel=0.01),
        pytest.approx(-(4**2) * 0.5, rel=0.01),
    )


def test_noise_has_its_deviation():
    values = readings(simulate(robot("GPS { accuracy 0.5 }"), gravity=0), "gps", 500)
    assert statistics.pstdev(x for x, _, _ in values) == pytest.approx(0.5, rel=0.15)


def test_a_position_sensor_reads_its_joint():
    simulation = simulate(hinge(devices="RotationalMotor { maxTorque 1e6 } PositionSensor { }"), gravity=0)
    motor, sensor = turning(simulation, 2), device(simulation, "position sensor")
    sensor.enable(8)
    run(simulation, 0.8)
    assert sensor.getValue() == pytest.approx(2 * 0.8, rel=1e-3)
    assert sensor.getMotor() is motor
    assert motor.getPositionSensor() is sensor


# Motors


@pytest.mark.parametrize(
    ("call", "value", "getter", "limit", "warning"),
    [
        ("setVelocity", -20, "getVelocity", -10, "exceeds maxVelocity 10"),
        ("setTorque", 30, "getMaxTorque", 10, "exceeds the limit 10"),
        ("setPosition", 3, "getTargetPosition", 1, "outside -1 .. 1"),
    ],
)
def test_a_command_beyond_the_limit_of_a_motor_is_limited_with_a_warning(
    call: str, value: float, getter: str, limit: float, warning: str, capsys
):
    motor = device(
        simulate(hinge(devices="RotationalMotor { minPosition -1 maxPosition 1 }")), "rotational motor"
    )
    if call == "setVelocity":
        motor.setPosition(math.inf)
    getattr(motor, call)(value)
    assert getattr(motor, getter)() == limit
    assert warning in capsys.readouterr().err


@pytest.mark.parametrize(
    ("call", "values"),
    [
        ("setPosition", [math.nan]),
        ("setVelocity", [math.nan]),
        ("setVelocity", [-2]),  # under position control
        ("setTorque", [math.nan]),
        ("setAvailableTorque", [-1]),
        ("setAvailableForce", [math.nan]),
        ("setAcceleration", [-2]),
        ("setAcceleration", [math.nan]),
        ("setControlPID", [0, 0, 0]),
        ("setControlPID", [10, -1, 0]),
    ],
)
def test_a_motor_ignores_a_wrong_call_with_an_error_and_the_run_goes_on(
    call: str, values: list[float], capsys
):
    simulation = simulate(hinge(devices="RotationalMotor { }"), gravity=0)
    motor = device(simulation, "rotational motor")
    before = vars(motor._state).copy()
    getattr(motor, call)(*values)
    assert vars(motor._state) == before
    error = capsys.readouterr().err
    assert error.startswith("Error: rotational motor: ")
    assert error.endswith("so the call is ignored\n")
    run(simulation, 0.1)
    assert node(simulation, "ROD").getVelocity()[4] == 0


@pytest.mark.parametrize(
    ("calls", "state", "speed"),
    [
        # The torque of 10 N m accelerates to the velocity of 3 rad/s, whose sign is that of the way left.
        (
            [("setPosition", math.inf), ("setVelocity", -3), ("setPosition", 1)],
            (1, -3, 10),
            10 * 0.04 / ROD_INERTIA,
        ),
        # A torque acts until the next position, and no available torque above it counts.
        ([("setTorque", 0.7), ("setVelocity", 3)], (0, 3, 10), 0.7 * 0.04 / ROD_INERTIA),
        ([("setAvailableTorque", 0.2), ("setForce", 5)], (0, 10, 0.2), 0.2 * 0.04 / ROD_INERTIA),
        ([("setTorque", 0.7), ("setAvailableForce", 12), ("setPosition", 0)], (0, 10, 10), 0),
    ],
)
def test_a_motor_is_in_the_mode_of_its_last_calls(calls: list, state: tuple, speed: float):
    simulation = simulate(hinge(devices="RotationalMotor { minPosition -1 maxPosition 2 }"), gravity=0)
    motor = device(simulation, "rotational motor")
    for name, value in calls:
        getattr(motor, name)(value)
    assert (motor.getTargetPosition(), motor.getVelocity(), motor.getAvailableTorque()) == state
    run(simulation, 0.04)
    assert node(simulation, "ROD").getVelocity()[4] == pytest.approx(speed, rel=0.02, abs=1e-5)


# Surroundings

WALL = "Solid { translation 0.6 0 0 children [ Shape { appearance PBRAppearance { baseColor %s 0 0 } } ] boundingObject Box { size 0.2 4 4 } }"
TABLE = "lookupTable [ 0 0 0, 1 1000 0 ]"


def distance_reading(sensor: str, wall: str = WALL % 1) -> float:
    text = f"{wall} Robot {{ children [ DistanceSensor {{ {TABLE} {sensor} }} ] }}"
    return reading(simulate(text), "distance sensor").getValue()


EDGE = "Solid { translation 0.5 -1 0 boundingObject Box { size 0.2 2 2 } }"
TWO = "numberOfRays 2 aperture 0.2"


@pytest.mark.parametrize(
    ("sensor", "wall", "value"),
    [
        *((f'type "{kind}"', WALL % 1, 500) for kind in ("generic", "infra-red", "sonar", "laser")),
        # Along x of its pose.
        ("rotation 0 0 1 0.5", WALL % 1, 500 / math.cos(0.5)),
        ("rotation 0 0 1 3.1416", WALL % 1, 1000),
        ("translation 0.2 0 0", WALL % 1, 300),
        # A sonar hears no slanted wall, and takes the nearest of its rays.
        ('type "sonar" rotation 0 0 1 0.38', WALL % 1, 500 / math.cos(0.38)),
        ('type "sonar" rotation 0 0 1 0.41', WALL % 1, 1000),
        (TWO, EDGE, (1000 + 400 / math.cos(0.1)) / 2),
        (f'{TWO} type "sonar"', EDGE, 400 / math.cos(0.1)),
        # Infra-red sees dark walls less: 0.5 m / 0.2 is beyond the table.
        ('type "infra-red"', WALL % 0.0, 1000),
        ('type "infra-red" translation 0.4 0 0', WALL % 0.5, 100 / 0.6),
    ],
)
def test_a_distance_sensor_answers_by_its_table(sensor: str, wall: str, value: float):
    assert distance_reading(sensor, wall) == pytest.approx(value, rel=1e-3)


def test_a_lidar_measures_row_by_row_from_the_left():
    text = """Solid { translation 0 2.05 0 boundingObject Box { size 9 0.1 9 } }
      Solid { translation 0.6 0 0 boundingObject Box { size 0.2 1 4 } }
      Robot { children [ Lidar { horizontalResolution 4 numberOfLayers 3 fieldOfView 3.1415926
        verticalFieldOfView 0.6 maxRange 2.5 } ] }"""
    simulation = simulate(text)
    lidar = device(simulation, "lidar")
    lidar.enable(8)
    lidar.enablePointCloud()
    simulation.run_step()
    image = lidar.getRangeImage()
    eighth = math.pi / 8
    middle = [2 / math.sin(3 * eighth), 0.5 / math.cos(eighth), 0.5 / math.cos(eighth), math.inf]
    assert lidar.getLayerRangeImage(1) == image[4:8] == pytest.approx(middle, rel=1e-3)
    assert image[1] == pytest.approx(middle[1] / math.cos(0.3), rel=1e-3)
    assert image[9] == pytest.approx(image[1])
    point = lidar.getPointCloud()[1]
    assert (point.x, point.layer_id) == (pytest.approx(0.5, rel=1e-3), 0)
    assert point.z == pytest.approx(image[1] * math.sin(0.3), rel=1e-3)
    assert lidar.getNumberOfPoints() == 12


def test_a_display_and_a_speaker_have_no_effect():
    simulation = simulate(robot("Display { width 3 height 2 } Speaker { }"))
    display, speaker = device(simulation, "display"), device(simulation, "speaker")
    display.setColor(0xFF0000)
    display.drawPixel(0, 0)
    speaker.speak("hello", 1.0)
    assert (display.getWidth(), display.getHeight()) == (3, 2)
    assert speaker.isSpeaking() is False


def test_noise_of_a_distance_sensor_is_a_share_of_its_value():
    text = f"""{WALL % 1} Robot {{ children [ DistanceSensor {{ lookupTable [ 0 0 0.1, 1 1000 0.1 ] }} ] }}"""
    values = readings(simulate(text), "distance sensor", 400, "getValue")
    deviation = statistics.pstdev(values)
    assert (statistics.mean(values), deviation) == (pytest.approx(500, rel=0.02), pytest.approx(50, rel=0.15))


FEELER = 'TouchSensor { type "%s" translation 0 0 -0.1 boundingObject Box { size 0.1 0.1 0.02 } }'


@pytest.mark.parametrize(
    ("text", "name", "call", "seconds", "expected"),
    [
        *(
            pytest.param(
                FLOOR + robot(f"Accelerometer {{ rotation {rotation} }}", "translation 0 0 0.1"),
                "accelerometer",
                "getValues",
                1,
                pytest.approx(felt, abs=0.05),
                id=f"an accelerometer at rest feels the ground: {rotation}",
            )
            for rotation, felt in (
                ("0 0 1 0", (0, 0, 9.81)),
                ("1 0 0 1.5707963", (0, 9.81, 0)),
                ("0 1 0 1.5707963", (-9.81, 0, 0)),
            )
        ),
        pytest.param(
            robot("Accelerometer { }", "translation 0 0 10"),
            "accelerometer",
            "getValues",
            0.008,
            pytest.approx([0, 0, 0], abs=1e-6),
            id="an accelerometer that falls feels nothing",
        ),
        pytest.param(
            f"""{WALL % 1} Robot {{ children [ DistanceSensor {{ {TABLE} }} ]
              boundingObject Pose {{ translation 0.2 0 0 children [ Box {{ size 0.1 0.1 0.1 }} ] }} }}""",
            "distance sensor",
            "getValue",
            0.008,
            pytest.approx(500, rel=1e-3),
            id="the own robot stops no ray",
        ),
        *(
            pytest.param(
                FLOOR + robot(FEELER % "bumper", "translation 0 0 0.5"),
                "touch sensor",
                "getValue",
                seconds,
                pressed,
                id=f"a bumper is pressed while it touches: {seconds} s",
            )
            for seconds, pressed in ((0.1, 0), (2.1, 1))
        ),
        pytest.param(
            FLOOR + robot(FEELER % "force-3d", "translation 0 0 0.11", mass=3),
            "touch sensor",
            "getValues",
            2,
            pytest.approx([0, 0, 3 * 9.81], rel=0.01, abs=0.05),
            id="a force sensor weighs",
        ),
        pytest.param(
            robot("TouchSensor { lookupTable [ 0 1 0, 9 2 0.1 ] }"),
            "touch sensor",
            "getLookupTable",
            0.008,
            [0, 1, 0, 9, 2, 0.1],
            id="a touch sensor has its table",
        ),
        pytest.param(
            """Solid { translation 2.05 0 0 boundingObject Box { size 0.1 9 9 } }
              Robot { children [ Lidar { numberOfLayers 1 horizontalResolution 3 minRange 2.1 maxRange 4 } ] }""",
            "lidar",
            "getRangeImage",
            0.008,
            pytest.approx([2 / math.cos(math.pi / 6), math.inf, 2 / math.cos(math.pi / 6)], rel=1e-3),
            id="a lidar sees nothing nearer than its range",
        ),
    ],
)
def test_a_sensor_reads(text: str, name: str, call: str, seconds: float, expected: object):
    simulation = simulate(text)
    sensor = device(simulation, name)
    sensor.enable(8)
    run(simulation, seconds)
    assert getattr(sensor, call)() == expected


def test_a_motor_reports_its_torque_and_a_lamp_its_value():
    simulation = simulate(hinge(devices="RotationalMotor { maxTorque 100 }") + robot("LED { }"))
    motor, lamp = device(simulation, "rotational motor"), device(simulation, "led", 1)
    motor.enableTorqueFeedback(8)
    lamp.set(1)
    run(simulation, 1)
    assert (abs(motor.getTorqueFeedback()), lamp.get()) == (pytest.approx(2 * 9.81 * 0.5, rel=0.02), 1)


# Messages

PAIR = """Robot { name "one" children [ Emitter { %s } Receiver { } ] }
Robot { name "two" translation 3 4 0 rotation 0 0 1 1.5707963 children [ Emitter { } Receiver { %s } ] }"""


def exchange(emitter: str = "", receiver: str = "", message: object = b"hello"):
    simulation = simulate(PAIR % (emitter, receiver), 32)
    sender, inbox = device(simulation, "emitter", 0), device(simulation, "receiver", 1)
    inbox.enable(32)
    device(simulation, "receiver", 0).enable(32)
    sent = sender.send(message)
    assert inbox.getQueueLength() == 0
    simulation.run_step()
    assert device(simulation, "receiver", 0).getQueueLength() == 0  # no robot hears itself
    return inbox, sent


def test_a_message_needs_one_basic_step():
    inbox, sent = exchange()
    assert (sent, inbox.getQueueLength(), inbox.getDataSize(), inbox.getString()) == (1, 1, 5, "hello")
    assert (inbox.getBytes(), inbox.getData()) == (b"hello", b"hello")
    inbox.nextPacket()
    assert inbox.getQueueLength() == 0
    with pytest.raises(RuntimeError, match="the queue of the receiver 'receiver' is empty"):
        inbox.getString()


def test_texts_and_numbers_are_messages_too():
    assert (exchange(message="a,ä")[0].getString(), exchange(message=[0.5, -1.0])[0].getFloats()) == (
        "a,ä",
        [0.5, -1.0],
    )


def test_strength_and_direction_are_those_of_the_emitter():
    inbox, _ = exchange()
    assert inbox.getSignalStrength() == pytest.approx(1 / 25)
    assert inbox.getEmitterDirection() == pytest.approx([-0.8, 0.6, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("emitter", "receiver", "count"),
    [
        ("channel 3", "channel 3", 1),
        ("channel 3", "", 0),
        ("channel -1", "channel 7", 1),
        ("channel 3", "channel -1", 1),
        ("range 5.01", "", 1),
        ("range 4.99", "", 0),
        ('type "infra-red"', "", 0),
        ('type "infra-red"', 'type "infra-red"', 1),
        ("bufferSize 4", "", 0),
        ("bufferSize 5", "", 1),
        ("", "bufferSize 4", 0),
        ("", "bufferSize 5", 1),
    ],
)
def test_a_message_arrives_where_channel_and_range_allow(emitter: str, receiver: str, count: int):
    assert exchange(emitter, receiver)[0].getQueueLength() == count


def test_the_buffer_of_an_emitter_is_full_until_its_messages_are_sent():
    simulation = simulate(PAIR % ("bufferSize 8", ""), 32)
    emitter = device(simulation, "emitter", 0)
    assert [emitter.send(b"12345"), emitter.send(b"12345"), emitter.send(b"123")] == [1, 0, 1]
    simulation.run_step()
    assert emitter.send(b"12345") == 1


def test_a_channel_that_is_not_allowed_is_not_taken():
    allowed = "channel 1 allowedChannels [1 2]"
    simulation = simulate(PAIR % (allowed, allowed), 32)
    for name, robot in (("emitter", 0), ("receiver", 1)):
        radio = device(simulation, name, robot)
        radio.setChannel(2)
        radio.setChannel(7)
        assert radio.getChannel() == 2


def test_messages_keep_their_order():
    simulation = simulate(PAIR % ("", ""), 32)
    inbox = device(simulation, "receiver", 1)
    inbox.enable(64)
    for number in range(4):
        device(simulation, "emitter", 0).send(f"{number}")
        simulation.run_step()
    assert [inbox.getString(), inbox.nextPacket(), inbox.getString(), inbox.getQueueLength()] == [
        "0",
        None,
        "1",
        3,
    ]


def test_a_solid_name_is_free_to_repeat():
    assert simulate(solid("Box { }") + solid("Box { }", "translation 1 0 0", name="OTHER"))


# Light

SENSOR = """Robot { children [ LightSensor { lookupTable [ 0 0 0, 1000 1000 0 ] %s } ] }"""


def irradiance(lights: str, fields: str = "") -> float:
    return reading(simulate(SENSOR % fields + lights), "light sensor").getValue()


DIRECTED = "DirectionalLight { direction %s intensity 30 %s }"
POINT = "PointLight { attenuation 0.5 0.2 0.1 location 3 4 0 intensity 100 }"
SHADED = (
    DIRECTED % ("-1 0 0", "ambientIntensity 0.5")
    + "Solid { translation 1 0 0 boundingObject Box { size 0.1 1 1 } }"
)


@pytest.mark.parametrize(
    ("lights", "fields", "value"),
    [
        pytest.param(DIRECTED % ("-1 0 0", ""), "", 30, id="ahead"),
        pytest.param(DIRECTED % ("-1 1 0", ""), "", 30 / 2**0.5, id="by the cosine of its angle"),
        pytest.param(DIRECTED % ("1 0 0", ""), "", 0, id="from behind"),
        pytest.param(DIRECTED % ("-1 0 0", "on FALSE"), "", 0, id="off"),
        pytest.param(DIRECTED % ("1 0 0", "ambientIntensity 0.5"), "", 0.5, id="ambient"),
        pytest.param(DIRECTED % ("-1 0 0", "color 1 0.5 0"), "", 30 * 1.5 / 3, id="color"),
        pytest.param(DIRECTED % ("-1 0 0", "color 1 0.5 0"), "colorFilter 0 1 0", 30 * 0.5 / 3, id="filter"),
        pytest.param(POINT, "", 100 * (3 / 5) / (0.5 + 0.2 * 5 + 0.1 * 25), id="point"),
        pytest.param(
            f"Pose {{ translation 0 -4 0 children [ {POINT} ] }}", "", 100 / 2.0, id="point in a pose"
        ),
        pytest.param(
            "PointLight { location 2 0 0 attenuation 0 0 1 intensity 8 ambientIntensity 0.5 }",
            "",
            8 / 2.0**2,
            id="no ambient part with an attenuation",
        ),
        pytest.param(SHADED, "", 30.5, id="a wall without occlusion"),
        pytest.param(SHADED, "occlusion TRUE", 0.5, id="a wall"),
    ],
)
def test_a_light_sensor_measures(lights: str, fields: str, value: float):
    assert irradiance(lights, fields) == pytest.approx(value, abs=1e-6)


# Rotating lidars

ROOM = """Solid { translation 2.05 0 0 boundingObject Box { size 0.1 9 9 } }
  Solid { name "right" translation 0 -1.05 0 boundingObject Box { size 9 0.1 9 } }"""
LIDAR = """Robot { children [ Lidar { type "rotating" horizontalResolution 40 numberOfLayers 1 maxRange 4
  defaultFrequency 6.25 maxFrequency 50 } ] }"""


def test_a_rotating_lidar_measures_what_it_passes():
    """At 6.25 Hz, the head turns a quarter of the circle in 40 ms: 10 of 40 columns, clockwise from ahead."""
    simulation = simulate(ROOM + LIDAR, step=8)
    lidar = device(simulation, "lidar")
    lidar.enable(40)
    lidar.enablePointCloud()
    run(simulation, 0.04)
    image = lidar.getRangeImage()
    angle = 2 * math.pi * 0.5 / 40
    assert image[0] == pytest.approx(2 / math.cos(angle), rel=1e-3)
    assert image[9] == pytest.approx(1 / math.cos(angle), rel=1e-3)
    assert image[10:] == [0.0] * 30
    point = lidar.getPointCloud()[9]
    assert (point.y, point.time) == (pytest.approx(-1, rel=1e-3), pytest.approx(0.04))
    run(simulation, 0.12)
    image = lidar.getRangeImage()
    assert image[15] == pytest.approx(1 / math.cos(11 * angle), rel=1e-3)
    assert (image[20:30], image[39]) == ([math.inf] * 10, pytest.approx(image[0]))


@pytest.mark.parametrize("projection", ['projection "planar"', "spherical FALSE"])
def test_a_planar_lidar_measures_along_its_axis(projection: str):
    """A wall across the axis at 2 m has a distance of 2 m in each column, at the points of a depth picture."""
    fields = f"{projection} fieldOfView 2 horizontalResolution 5 numberOfLayers 1 maxRange 4"
    wall = "Solid { translation 2.05 0 0 boundingObject Box { size 0.1 99 99 } }"
    simulation = simulate(f"{wall} Robot {{ children [ Lidar {{ {fields} }} ] }}")
    lidar = device(simulation, "lidar")
    lidar.enablePointCloud()
    lidar.enable(8)
    simulation.run_step()
    assert lidar.getRangeImage() == pytest.approx([2] * 5)
    edge = 2 * math.tan(1) * 4 / 5
    points = [coordinate for point in lidar.getPointCloud()[::4] for coordinate in point[:3]]
    assert points == pytest.approx([2, edge, 0, 2, -edge, 0])


# Recognition

CAMERA = """DEF ROBOT Robot { children [ Camera { width 200 height 100 fieldOfView 1.5707963
  recognition Recognition { %s } } ] boundingObject Box { size 0.2 0.2 0.2 } }"""
CEREAL = """DEF BOX Solid { translation %s rotation 0 0 1 %s model "cereal" recognitionColors [ 1 0 0, 0 0 1 ]
  boundingObject Box { size 0.2 0.4 0.8 } }"""
BALL_WITH_COLOR = """Solid { name "ball" translation 4 1 0 recognitionColors [ 0 1 0 ]
  children [ Shape { geometry Sphere { radius 0.1 } } ] }"""
SHELF = 'Solid { name "shelf" translation 1 0 -0.5 boundingObject Box { size 0.1 4 1.2 } }'


def recognized(world: str, fields: str = ""):
    """Return the objects that a camera recognizes at its first measurement; no picture is drawn."""
    simulation = simulate(CAMERA % fields + world)
    camera = device(simulation, "camera")
    camera.recognitionEnable(8)
    assert (camera.getRecognitionObjects(), camera.getRecognitionSamplingPeriod()) == ([], 8)
    simulation.run_step()
    assert camera.getRecognitionNumberOfObjects() == len(camera.getRecognitionObjects())
    return camera.getRecognitionObjects()


def test_a_recognized_object_has_its_place_in_space_and_in_the_picture():
    """The corners of the near face, 1.8 m away, are at 0.1 and 0.4 m beside the axis: 1 m is 100 pixels at
    1 m. The box is turned by a right angle."""
    (seen,) = recognized(CEREAL % ("2 -0.5 0.1", math.pi / 2))
    assert seen.getPosition() == pytest.approx([2, -0.5, 0.1])
    assert seen.getOrientation() == pytest.approx([0, 0, 1, math.pi / 2])
    assert seen.getSize() == pytest.approx([0.2, 0.8])
    left, right, top, bottom = 100 + 100 * 0.4 / 2.2, 100 + 100 * 0.6 / 1.8, 50 - 50 / 1.8, 50 + 30 / 1.8
    assert seen.getSizeOnImage() == [int(right) - int(left), int(bottom) - int(top)]
    assert seen.getPositionOnImage() == pytest.approx([(left + right) / 2, (top + bottom) / 2], abs=1)
    assert (seen.getModel(), seen.get_number_of_colors(), seen.colors[3:]) == ("cereal", 2, [0, 0, 1])


@pytest.mark.parametrize(
    ("world", "fields", "models"),
    [
        pytest.param(CEREAL % ("-2 0 0", 0), "", [], id="behind"),
        pytest.param(CEREAL % ("2 5 0", 0), "", [], id="beside the picture"),
        pytest.param(CEREAL % ("2 0 0", 0), "maxRange 1.9", [], id="too far"),
        pytest.param(BALL_WITH_COLOR, "", [""], id="only seen, without a bounding object"),
        pytest.param(SHELF + CEREAL % ("2 0 0", 0), "", [], id="its middle is hidden"),
        pytest.param(SHELF + CEREAL % ("2 0 0", 0), "occlusion 2", ["cereal"], id="a corner is not hidden"),
        pytest.param(SHELF + CEREAL % ("2 0 0", 0), "occlusion 0", ["cereal"], id="seen through walls"),
        pytest.param(BALL_WITH_COLOR + CEREAL % ("2 0 0", 0), "maxObjects 1", ["cereal"], id="the largest"),
    ],
)
def test_a_camera_recognizes_what_its_fields_allow(world: str, fields: str, models: list[str]):
    assert [each.model for each in recognized(world, fields)] == models

"""Radars, light sensors, rotating lidars and ball joints of worlds against closed forms."""

from __future__ import annotations

import math

import pytest

from deepbots_cli.webots.unimplemented import NotImplementedCallError
from tests.webots.worlds_of_webots import device, node, run, simulate


def measured(text: str, name: str, period: int = 8, **info: object):
    """Return a sensor after its first measurement."""
    simulation = simulate(text, **info)
    sensor = device(simulation, name)
    sensor.enable(period)
    simulation.run_step()
    return sensor


# Radars

RADAR = "DEF ROBOT Robot { %s children [ Radar { minRange 1 maxRange 50 transmittedPower 1 %s } ] }"
TARGET = """Solid { name "%s" translation %s linearVelocity %s radarCrossSection %s
  boundingObject Sphere { radius 0.001 } physics Physics { } }"""


def target(place: str, velocity: str = "0 0 0", section: float = 1.0, name: str = "target") -> str:
    return TARGET % (name, place, velocity, section)


def radar_targets(text: str, fields: str = "", robot: str = ""):
    """Return the targets of a radar at the origin that looks along x."""
    return measured(RADAR % (robot, fields) + text, "radar", gravity=0).getTargets()


def test_a_radar_measures_distance_speed_and_azimuth():
    """A target at (10, -2, 0) with 3 m/s along x moves away with 3 * cos(angle); right is positive."""
    (target_seen,) = radar_targets(target("10 -2 0", "3 0 0"))
    moved = 10 + 3 * 0.008
    angle = math.atan2(2, moved)
    assert target_seen.distance == pytest.approx(math.hypot(moved, 2))
    assert target_seen.azimuth == pytest.approx(angle)
    assert target_seen.speed == pytest.approx(3 * math.cos(angle))


def test_the_power_of_a_target_follows_the_radar_equation():
    """P G^2 lambda^2 sigma / ((4 pi)^3 d^4), here 1 dBm, 20 dBi, 24 GHz, 2 m^2 at 10 m."""
    (target_seen,) = radar_targets(target("10 0 0", section=2.0))
    wavelength = 299_792_458 / 24e9
    milliwatts = 10**0.1 * 100**2 * wavelength**2 * 2.0 / ((4 * math.pi) ** 3 * 10**4)
    assert target_seen.received_power == pytest.approx(10 * math.log10(milliwatts))


def test_the_noise_of_an_azimuth_may_leave_the_field_of_view():
    """As in Webots, which limits an azimuth to the field of view, and then adds the noise."""
    at_the_edge = target("10 -3.9 0").replace("radius 0.001", "radius 1")
    robot = RADAR % ("", "horizontalFieldOfView 0.6 angularNoise 0.05")
    simulation = simulate(robot + at_the_edge, gravity=0)
    radar = device(simulation, "radar")
    radar.enable(8)
    azimuths = []
    for _ in range(200):
        simulation.run_step()
        azimuths.append(radar.getTargets()[0].azimuth)
    assert sum(azimuths) / 200 == pytest.approx(0.3, abs=4 * 0.05 / math.sqrt(200))
    assert max(azimuths) > 0.35


def test_a_moving_radar_measures_relative_speed():
    robot = "linearVelocity 2 0 0 boundingObject Box { } physics Physics { }"
    (target_seen,) = radar_targets(target("10 0 0", "5 0 0"), robot=robot)
    assert target_seen.speed == pytest.approx(3)


@pytest.mark.parametrize(
    ("place", "fields", "count"),
    [
        ("49.9 0 0", "", 1),
        ("50.1 0 0", "", 0),
        ("0.9 0 0", "", 0),
        ("10 3.9 0", "", 1),  # 0.372 rad, of 0.39
        ("10 4.3 0", "", 0),
        ("10 0 0.4", "", 1),
        ("10 0 0.6", "", 0),
        ("-10 0 0", "", 0),
        ("10 4.3 0", "horizontalFieldOfView 1", 1),
        ("10 0 0", "minDetectableSignal -70.1", 1),  # -70.04 dBm arrive
        ("10 0 0", "minDetectableSignal -70", 0),
    ],
)
def test_a_radar_sees_within_its_range_and_field(place: str, fields: str, count: int):
    assert len(radar_targets(target(place), fields)) == count


@pytest.mark.parametrize(
    ("fields", "count"),
    [
        ("minAbsoluteRadialSpeed 1.9", 1),
        ("minAbsoluteRadialSpeed 2.1", 0),
        ("minRadialSpeed -3 maxRadialSpeed -1", 1),
        ("minRadialSpeed 0 maxRadialSpeed 5", 0),
    ],
)
def test_a_radar_sees_within_its_range_of_speeds(fields: str, count: int):
    assert len(radar_targets(target("10 0 0", "-2 0 0"), fields)) == count


def test_a_solid_without_a_cross_section_is_not_a_target():
    assert radar_targets(target("10 0 0", section=0.0)) == []


def test_targets_in_one_cell_are_one():
    """The mean is weighted by power: sections of 1 and 3 at 10.0 and 10.4 m."""
    pair = target("10 0 0") + target("10.4 0 0", section=3.0, name="other")
    assert len(radar_targets(pair)) == 2
    (target_seen,) = radar_targets(pair, "cellDistance 0.5")
    weights = (1 / 10**4, 3 / 10.4**4)
    assert target_seen.distance == pytest.approx((10 * weights[0] + 10.4 * weights[1]) / sum(weights))
    assert len(radar_targets(pair, "cellDistance 0.5 cellSpeed 0.1")) == 1


def test_a_wall_hides_a_target_if_occlusion_counts():
    wall = 'Solid { name "wall" translation 5 0 0 boundingObject Box { size 0.1 2 2 } }'
    assert len(radar_targets(wall + target("10 0 0"))) == 1
    assert radar_targets(wall + target("10 0 0"), "occlusion TRUE") == []
    assert len(radar_targets(target("10 0 0"), "occlusion TRUE")) == 1


# Light

SENSOR = """Robot { children [ LightSensor { lookupTable [ 0 0 0, 1000 1000 0 ] %s } ] }"""


def irradiance(lights: str, fields: str = "") -> float:
    return measured(SENSOR % fields + lights, "light sensor").getValue()


def test_a_directional_light_arrives_by_the_cosine_of_its_angle():
    assert irradiance("DirectionalLight { direction -1 0 0 intensity 30 }") == pytest.approx(30)
    assert irradiance("DirectionalLight { direction -1 1 0 intensity 30 }") == pytest.approx(30 / 2**0.5)
    assert irradiance("DirectionalLight { direction 1 0 0 intensity 30 }") == 0
    assert irradiance("DirectionalLight { direction -1 0 0 intensity 30 on FALSE }") == 0


def test_a_point_light_fades_with_the_distance():
    light = "PointLight { attenuation 0.5 0.2 0.1 location 3 4 0 intensity 100 }"
    assert irradiance(light) == pytest.approx(100 * (3 / 5) / (0.5 + 0.2 * 5 + 0.1 * 25))
    assert irradiance(f"Pose {{ translation 0 -4 0 children [ {light} ] }}") == pytest.approx(100 / 2.0)


@pytest.mark.parametrize(("angle", "share"), [(0.2, 1.0), (0.35, 0.5), (0.45, 0.0)])
def test_a_spot_light_ends_at_its_cone(angle: float, share: float):
    light = f"""SpotLight {{ location 2 0 0 direction {-math.cos(angle)!r} {math.sin(angle)!r} 0
      beamWidth 0.3 cutOffAngle 0.4 intensity 50 }}"""
    assert irradiance(light) == pytest.approx(50 * share, abs=1e-6)


def test_ambient_light_has_no_direction():
    light = "DirectionalLight { direction 1 0 0 intensity 9 ambientIntensity 0.5 }"
    assert irradiance(light) == pytest.approx(0.5)


def test_a_light_with_an_attenuation_has_no_ambient_part():
    light = "PointLight { location 2 0 0 attenuation 0 0 1 intensity 8 ambientIntensity 0.5 }"
    assert irradiance(light) == pytest.approx(8 / 2.0**2)


def test_colors_pass_a_filter():
    light = "DirectionalLight { direction -1 0 0 intensity 30 color 1 0.5 0 }"
    assert irradiance(light) == pytest.approx(30 * 1.5 / 3)
    assert irradiance(light, "colorFilter 0 1 0") == pytest.approx(30 * 0.5 / 3)


def test_a_wall_shades_direct_light_if_occlusion_counts():
    scene = """DirectionalLight { direction -1 0 0 intensity 30 ambientIntensity 0.5 }
      Solid { translation 1 0 0 boundingObject Box { size 0.1 1 1 } }"""
    assert irradiance(scene) == pytest.approx(30.5)
    assert irradiance(scene, "occlusion TRUE") == pytest.approx(0.5)


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
    assert image[20:30] == [math.inf] * 10
    assert image[39] == pytest.approx(image[0])


def test_the_frequency_of_a_lidar_is_limited(capsys):
    simulation = simulate(ROOM + LIDAR, step=8)
    lidar = device(simulation, "lidar")
    lidar.setFrequency(12.5)
    lidar.enable(40)
    run(simulation, 0.04)
    assert [value > 0 for value in lidar.getRangeImage()] == [True] * 20 + [False] * 20
    lidar.setFrequency(60)
    assert lidar.getFrequency() == lidar.getMaxFrequency() == 50
    assert "outside 1 .. 50" in capsys.readouterr().err


def test_a_lidar_sees_nothing_nearer_than_its_range():
    text = (
        ROOM
        + "Robot { children [ Lidar { numberOfLayers 1 horizontalResolution 3 minRange 2.1 maxRange 4 } ] }"
    )
    image = measured(text, "lidar").getRangeImage()
    assert image[1] == math.inf
    assert image[0] == pytest.approx(2 / math.cos(math.pi / 6), rel=1e-3)


def test_a_planar_lidar_says_so():
    lidar = device(simulate('Robot { children [ Lidar { projection "planar" } ] }'), "lidar")
    with pytest.raises(NotImplementedCallError, match="planar projection is not implemented"):
        lidar.enable(8)


# Ball joints

BALL = """DEF ROBOT Robot { children [ DEF JOINT BallJoint {
  jointParameters DEF FIRST BallJointParameters { %s }
  device [ RotationalMotor { name "one" maxTorque 100 } PositionSensor { name "angle one" } ]
  device2 [ RotationalMotor { name "two" maxTorque 100 } PositionSensor { name "angle two" } ]
  device3 [ RotationalMotor { name "three" maxTorque 100 } PositionSensor { name "angle three" } ]
  endPoint DEF END Solid { boundingObject Box { size 0.2 0.3 0.4 } physics Physics { density -1 mass 1 } }
} ] }"""


def world_after_turns(angles: dict[str, float], parameters: str = ""):
    """Return the world after its motors reached positions, about x, y and z in turn."""
    simulation = simulate(BALL % parameters, gravity=0)
    for name, angle in angles.items():
        device(simulation, name).setPosition(angle)
        device(simulation, f"angle {name}").enable(8)
    run(simulation, 1.2)
    return simulation


def test_three_motors_turn_a_ball_joint_about_its_axes_in_turn():
    a, b, c = 0.5, 0.3, -0.7
    simulation = world_after_turns({"one": a, "two": b, "three": c})
    readings = [device(simulation, f"angle {name}").getValue() for name in ("one", "two", "three")]
    assert readings == pytest.approx([a, b, c], abs=1e-3)
    matrix = node(simulation, "END").getOrientation()
    # Rx(a) Ry(b) Rz(c): its last column is (sin b, -sin a cos b, cos a cos b), its first row begins so.
    assert matrix[2::3] == pytest.approx(
        [math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)], abs=2e-3
    )
    assert matrix[:2] == pytest.approx([math.cos(b) * math.cos(c), -math.cos(b) * math.sin(c)], abs=2e-3)


def test_the_stop_of_a_ball_joint_stops_its_first_axis():
    simulation = world_after_turns({}, "minStop -0.4 maxStop 0.4")
    motor = device(simulation, "one")
    motor.setAvailableTorque(1)
    motor.setPosition(0.9)
    device(simulation, "angle one").enable(8)
    run(simulation, 1)
    assert device(simulation, "angle one").getValue() == pytest.approx(0.4, abs=0.02)
    assert motor.getPositionSensor() is device(simulation, "angle one")


def test_a_supervisor_reads_and_sets_the_positions_of_a_ball_joint():
    simulation = world_after_turns({})
    joint = node(simulation, "JOINT")
    joint.setJointPosition(0.2, 3)
    assert joint.getField("position3").getSFFloat() == pytest.approx(0.2)
    assert joint.getField("position2").getSFFloat() == pytest.approx(0.0)

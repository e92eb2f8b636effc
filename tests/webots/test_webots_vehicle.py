"""Cars of the library, driven by the module `vehicle`, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from deepbots_webots.project import equivalents
from deepbots_webots.scene import build_scene
from deepbots_webots.simulation import Simulation
from deepbots_webots.supervisor import activate, deactivate
from deepbots_webots.vehicle import Car
from tests.webots.exported_projects import FLOOR, device, enu, node, read, simulate

MAKES = ["BmwX5", "CitroenCZero", "LincolnMKZ", "TeslaModel3", "ToyotaPrius", "Truck"]


def driver(text: str, axes: str = "ENU") -> Car:
    """Return the driver of the first car of a world; its steps advance the world."""
    simulation = simulate(text + FLOOR, 10, axes)
    activate(simulation)
    simulation.current = simulation.scene.robots[0]
    try:
        return Car()
    finally:
        deactivate()


def drive(car: Car, seconds: float) -> None:
    for _ in range(round(seconds * 100)):
        car.step()


def place(car: Car, axes: str) -> Sequence[float]:
    return enu(node(car._webots_simulation, "CAR").getPosition(), axes)


@pytest.mark.parametrize("axes", ["ENU", "NUE"])
@pytest.mark.parametrize("make", MAKES)
def test_a_car_cruises_on_a_circle_around_the_point_of_its_wheels(make: str, axes: str):
    car = driver(f"DEF CAR {make} {{ }}", axes)
    car.setSteeringAngle(0.2)
    car.setCruisingSpeed(18)
    drive(car, 6)
    assert car.getCurrentSpeed() == pytest.approx(18, rel=0.01)
    assert car.getSteeringAngle() == pytest.approx(0.2, abs=0.005)
    first = place(car, axes)
    drive(car, 1)
    middle = place(car, axes)
    drive(car, 1)
    last = place(car, axes)
    # The radius of the circle through three points; positive angles turn right.
    sides = math.dist(first, middle), math.dist(middle, last), math.dist(first, last)
    double_area = (middle[0] - first[0]) * (last[1] - first[1]) - (middle[1] - first[1]) * (
        last[0] - first[0]
    )
    radius = -math.prod(sides) / (2 * double_area)
    assert radius == pytest.approx(car.getWheelbase() / math.tan(0.2), rel=0.03)


def test_a_car_reaches_100_km_per_h_in_its_time():
    car = driver("DEF CAR BmwX5 { }")
    car.setCruisingSpeed(100)
    drive(car, 6.5)
    assert car.getCurrentSpeed() == pytest.approx(100 * 6.5 / 7, rel=0.02)
    drive(car, 1)
    assert car.getCurrentSpeed() == pytest.approx(100, rel=0.01)
    assert car.getTargetCruisingSpeed() == 100
    assert car.getControlMode() == Car.SPEED


def test_the_engine_accelerates_a_car_by_its_gear_and_the_brakes_stop_it():
    car = driver("DEF CAR BmwX5 { }")
    car.setGear(1)
    car.setThrottle(0.5)
    drive(car, 1)
    # At 1,000 rpm: 34.11 + 0.136 * 1000 - 0.00001461 * 1000^2 N m, times the ratio 12.5 of the gear. The wheels
    # turn as disks of 30 kg; their damping of 2 N m s/rad is left out.
    force = 0.5 * (34.11 + 136 - 14.61) * 12.5 / 0.374
    speed = force / (2000 + 4 * 30 * 1.5)
    assert car.getCurrentSpeed() / 3.6 == pytest.approx(speed, rel=0.05)
    assert car.getRpm() == pytest.approx(speed / 0.374 * 12.5 * 30 / math.pi, rel=0.05)
    car.setCruisingSpeed(50)
    drive(car, 5)
    car.setThrottle(0)
    car.setBrakeIntensity(0.5)
    start = place(car, "ENU")
    drive(car, 6)
    assert car.getCurrentSpeed() == pytest.approx(0, abs=0.1)
    # Half of the torque 1,800 N m at each of four wheels, and the damping.
    inertia = 0.374 * (2000 + 4 * 30 * 1.5)
    braking, damping = 4 * 900 / inertia, 4 * 2 / 0.374 / inertia
    way = 50 / 3.6 / damping - braking / damping**2 * math.log(1 + 50 / 3.6 * damping / braking)
    assert math.dist(start, place(car, "ENU")) == pytest.approx(way, rel=0.02)


def test_a_car_of_a_project_drives_by_its_own_numbers():
    text = """DEF CAR Car { wheelbase 2 trackFront 1 trackRear 1.2 type "propulsion" engineType "electric"
      wheelRearRight VehicleWheel { tireRadius 0.5 } wheelRearLeft VehicleWheel { tireRadius 0.5 }
      boundingObject Box { size 1 1 0.2 } physics Physics { density -1 mass 500 centerOfMass [ 1 0 0 ] } }"""
    car = driver(text)
    numbers = car.getWheelbase(), car.getTrackFront(), car.getTrackRear(), car.getRearWheelRadius()
    assert numbers == (2, 1, 1.2, 0.5)
    assert (car.getType(), car.getEngineType()) == (Car.PROPULSION, Car.ELECTRIC_ENGINE)
    car.setCruisingSpeed(9)
    drive(car, 2)
    assert car.getWheelSpeed(Car.WHEEL_REAR_LEFT) == pytest.approx(9 / 3.6 / 0.5, rel=0.01)
    assert place(car, "ENU")[0] > 3


def test_lamps_and_wipers_keep_what_a_driver_asks_for():
    car = driver("DEF CAR ToyotaPrius { }")
    car.setIndicator(Car.INDICATOR_LEFT)
    car.setHazardFlashers(True)
    car.setDippedBeams(True)
    car.setAntifogLights(True)
    car.setWiperMode(Car.FAST)
    kept = car.getIndicator(), car.getHazardFlashers(), car.getDippedBeams(), car.getAntifogLights()
    assert (*kept, car.getWiperMode()) == (2, True, True, True, 3)


def test_a_driver_of_another_robot_is_an_error_that_names_it():
    with pytest.raises(
        RuntimeError, match="'e-puck' is no car; Driver and Car need a robot of the PROTO Car"
    ):
        driver("E-puck { }")


def test_a_car_of_an_older_file_looks_along_z_with_its_sensors():
    """Before R2022a, cars drive along z, and their slots turn a camera, which looks along -z, away from the car."""
    slots = (f'sensorsSlot{end} [ GPS {{ name "{end}" translation 0 0 -1 }} ]' for end in ("Front", "Rear"))
    world = read(
        f"""#VRML_SIM R2021b utf8
        WorldInfo {{ coordinateSystem "NUE" }} BmwX5 {{ translation 0 0.4 0 {" ".join(slots)} }}"""
    )
    simulation = Simulation(build_scene(world), world.span)
    front, rear = device(simulation, "Front"), device(simulation, "Rear")
    front.enable(32)
    rear.enable(32)
    simulation.run_step()
    assert front.getValues() == pytest.approx([0, 0.85, 4.85], abs=0.01)
    assert rear.getValues() == pytest.approx([0, 0.7, -2], abs=0.01)


def test_worlds_of_cities_load_with_plain_signs_and_buildings():
    names = sorted(equivalents() & {"StopSign", "GenericTrafficLight", "Hotel", "Oak", "PedestrianCrossing"})
    assert len(names) == 5
    world = read("\n".join(f"{name} {{ size 2 7 }}" for name in names))
    build_scene(world)
    assert {finding.severity for finding in world.findings} == {"warning"}

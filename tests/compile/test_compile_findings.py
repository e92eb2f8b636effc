"""What a change of a scenario brings, as tables: the codes of its findings, in order, each with the text at its
place after a colon where that counts."""

from __future__ import annotations

import pytest

from deepbots_cli.compiler.namespace import MAX_CHAIN

Edits = tuple[tuple[str, str], ...]


def robot(text: str) -> tuple[str, str]:
    return "    sensors:", f"    {text}\n    sensors:"


def cases(text: str) -> tuple[str, str]:
    return "solved: mean", f"evaluation: {{episodes: 30, cases: {{{text}}}}}\nsolved: mean"


def lines(count: int, text: str) -> str:
    return "".join(text.replace("N", str(number)) for number in range(count))


def chain(count: int, definition: str) -> Edits:
    """A chain of parameters, `definition` with the name of the next one."""
    links = "".join(f"  p{n}: {definition.replace('NEXT', f'p{n + 1}')}\n" for n in range(count - 1))
    return (
        ("parameters:\n", f"parameters:\n{links}  p{count - 1}: 1 mm\n"),
        ("-0.4 .. 0.4 m", "-0.4 m .. p0 + 0.4 m"),
    )


DRAWN = ("{cart_speed", "{drawn: uniform(1 .. 2), cart_speed")
GRANTED = (
    ("reward:", "signals: {lean: joint_position(cart.hinge)}\nreward:"),
    ("  cart.turn:", "  lean: -1 .. 1 rad\n  cart.turn:"),
)
CIRCLE = (
    "termination:\n  failure:\n    fallen: abs(cart.lean) > 12 deg\n    off:    abs(cart.place) > 2.3 m\n",
    "termination:\n  success: {done: not lost}\n  failure: {lost: not done}\n",
)
BALLS = lines(600, "  oN: {shape: sphere, radius: 1 cm, mass: 1 kg}\n")
MANY_SIGNALS = lines(3000, "  pN: N\n")
MANY_CASES = lines(39, "    cN: {set: {cart_speed: N + 1 m/s}}\n")
SPARE = ("parameters:", "parameters:\n  spare: 10 deg")
STRONGER = ("10 N*m", "15 N*m")
WHEELS = "wheels: {type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m}"
CRATES = (
    (
        "robots:",
        "objects:\n  crate: {count: 2, fixed: true, one_of: {cube: {shape: box, size: 5 5 5 cm}}}\nrobots:",
    ),
    ("place: {", "place: {crate: {region: {x: -0.4 .. 0.4 m, y: 0.2 .. 0.4 m}}, "),
)

OF_RAIL: list[tuple[str, Edits]] = [
    # What shapes spaces and time must be fixed.
    ("DB407", (DRAWN, ("timestep: 20 ms", "timestep: drawn * 20 ms"))),
    ("DB407", (DRAWN, ("cart.place: -2.4 .. 2.4 m", "cart.place: -2.4 m .. drawn * 2.4 m"))),
    ("DB407", (DRAWN, ("max_steps: 300", "max_steps: drawn"))),
    ("DB407", (DRAWN, ("forward: 1,", "forward: drawn,"))),
    ("DB407", (DRAWN, ("reset:", "reset:\n  settle: drawn * 1 s"))),
    ("DB207", (CIRCLE,)),
    ("DB609", GRANTED),
    ("", (*GRANTED, ("reward:", "augment: [lean]\nreward:"))),
    # More than any machine can give is refused while it is read.
    *(("DB105", (("reset:", f"reset:\n  settle: {time}"),)) for time in ("1e9 s", "1e300 s", "1 h")),
    ("DB105", (("substeps: 4", "substeps: 10_001"),)),
    ("", (("substeps: 4", "substeps: 10_000"),)),
    ("DB005:objects", (("action:", f"objects:\n{BALLS}action:"),)),
    (
        "DB005",
        (
            ("  failure:\n", "  failure:\n" + lines(300, "    fN: time > N + 1 s\n")),
            ("reward: {alive: 1}", "reward:\n" + lines(300, "  rN: 1 when fN\n")),
        ),
    ),
    (
        "DB005:cases",
        (
            (
                "world:",
                f"signals:\n{MANY_SIGNALS}evaluation:\n  cases:\n{MANY_CASES}world:",
            ),
        ),
    ),
]
OF_CARTPOLE: list[tuple[str, Edits]] = [
    # One broken piece is one finding: what it takes away is not reported again where it is used.
    ("DB101", (("parameters:", "parameter:"),)),
    ("DB101", (("augment:", "augmnt:"),)),
    ("DB101", (("termination:", "terminations:"),)),
    ("DB101", (("truncation:", "trunkation:"),)),
    ("DB101", (("robots:", "robot:"),)),
    ("DB101", (("\naction:", "\nactoin:"),)),
    ("DB101", (("    sensors:", "    sensor:"),)),
    ("DB101", (("    actuators:", "    actuator:"),)),
    ("DB101", (("    apply:", "    emits: [pole_angle]\n    apply:"),)),
    ("DB101", (("    urdf:", "    urfd:"),)),
    ("DB104", (("type: joint_position", "type: joint_angle"),)),
    ("DB302", (("joint: pole_hinge", "joint: pole"),)),
    ("DB107", (("fall_angle:  15 deg", "fall_angle:"),)),
    ("DB103", (("track:       0.39 m", "track:       [0.39 m]"),)),
    ("DB501", (("wheel_speed: 5 rad/s", "wheel_speed: 5 rd/s"),)),
    ("DB204", (("urdf: cartpole", "urdf: cart"),)),
    ("DB204", (("    urdf: cartpole", "    include: cart.yaml"),)),
    ("DB201", (("    apply: {wheels", "    emit: [pole_angel]\n    apply: {wheels"),)),
    ("DB402", (("x:         position(cart).x", "x:         position(cart).q"),)),
    ("DB103", (("forward: 1, backward: -1", "forward: {drive: 1}, backward: -1"),)),
    (
        "DB101 DB502 DB402 DB503 DB104",  # Findings far apart do not hide each other.
        (
            ("    sensors:", "    sensor:"),
            ("-0.8 .. 0.8 m/s", "-0.8 .. 0.8"),
            ("  alive: 1", "  alive: 1 - wobble"),
            ("algorithm: PPO", "algorithm: PP0"),
            ("{z: 0.04 m}", "{z: 0.04 kg}"),
        ),
    ),
    ("DB503", (("> track", "> track or abs(cart.pole_angle) > track"),)),
    ("DB302", (robot("groups: {upper: [pole, tip]}"), ("[wheel_*]", "upper"))),
    *(
        (
            "DB001:*wheel",
            ((WHEELS, f"wheels:\n        type: velocity_motor\n        joints: {joints}"),),
        )
        for joints in ("[*wheel]", "[wheel_front_left, *wheel]", "\n          - *wheel")
    ),
    ("", chain(MAX_CHAIN, "NEXT + 1 mm")),
    ("DB005", chain(MAX_CHAIN + 1, "NEXT + 1 mm")),
    # Cases of the evaluation: the scenario once more, under other settings.
    ("DB205", (SPARE,)),
    ("", (SPARE, cases("steep: {set: {fall_angle: spare}}"))),
    ("DB503", (("fall_angle:  15 deg", "fall_angle: 15 kg"), cases("a: {set: {track: 1 m}}, b: {}"))),
    (
        "DB201:truck DB401:^ DB105:-1 s",
        (cases("a: {set: {truck: 1 m}}, b: {set: {track: 1 mm^}}, c: {set: {world.timestep: -1 s}}"),),
    ),
    *(
        ("DB407", (cases(f"odd: {{set: {{{path}: 1}}}}"),))
        for path in ("train.algorithm", "observation.x", "action", "evaluation.episodes", "name", "solved")
    ),
    (
        "DB613",
        (
            cases("odd: {set: {size: 2 m}}"),
            ("parameters:", "parameters:\n  size: 1 m"),
            ("-0.4 .. 0.4 m", "-1 * size .. size"),
        ),
    ),
    ("DB005", (cases(", ".join(f"case_{i}: {{}}" for i in range(65))),)),
    (
        "DB503:3 kg",
        (
            *CRATES,
            cases(
                "round: {set: {objects.crate.one_of: {can: {shape: cylinder, radius: 3 kg, height: 8 cm}}}}"
            ),
        ),
    ),
    # Every figure keeps the bounds of its field, also one with a unit, a parameter or a vector.
    ("DB105", (("timestep: 32 ms", "timestep: 0 s"),)),
    ("DB105", (("timestep: 32 ms", "timestep: 2 min"),)),
    ("DB105", (("size: 1 1 m", "size: 1 0 m"),)),
    ("DB105", (("wall_height: 0.1 m", "wall_height: -10 cm"),)),
    ("DB105", (("friction: 1.0", "friction: track / m - 1"),)),
    ("DB105", (("max_torque: 10 N*m", "max_torque: -10 N*m"),)),
    ("DB105", (("{max_steps: 200}", "{max_steps: 200 / 3}"),)),
    ("DB105", (("{max_steps: 200}", "{max_time: -1 s}"),)),
    ("DB105", (("reset:", "reset:\n  settle: -1 s"),)),
    ("DB105", (("mean_return >= 195", "success_rate >= 150 %"),)),
    ("DB308", (("reset:", "reset:\n  settle: 50 ms"),)),
    ("", (("reset:", "reset:\n  settle: 0.32 s"),)),
    ("DB304", (STRONGER,)),
    ("", (STRONGER, robot('joints: {"wheel_*": {max_torque: 15 N*m}}'))),
    # A change of the robot that cannot be made is one finding.
    ("DB105", (robot("links: {pole: {mass: 0}}"),)),
    ("DB503", (robot("links: {pole: {mass: 1 m}}"),)),
    ("DB105", (robot("links: {pole: {mass: -1 kg}}"),)),
    ("DB201", (robot("links: {poel: {mass: 1 kg}}"),)),
    ("DB206", (robot('links: {"pol_*": {mass: 1 kg}}'),)),
    ("DB105", (robot("links: {pole: {scale: 1 1 0}}"),)),
    ("DB105", (robot("links: {wheel_front_left: {scale: 1 1 2}}"),)),
    ("DB105", (robot("links: {pole: {friction: uniform(-0.5 .. 1)}}"),)),
    ("DB105", (robot("links: {pole: {friction: -0.5}}"),)),
    ("DB404", (robot("links: {body: {com: uniform(0 .. 1 cm)}}"),)),
    ("DB105", (robot("links: {body: {inertia: 0}}"),)),
    ("DB105", (robot("links: {body: {inertia: normal(1 +- 0.1)}}"),)),
    ("DB302", (robot("joints: {pole_hing: {damping: 1 N*m*s/rad}}"),)),
    ("DB303", (robot("joints: {tip_mount: {damping: 1 N*m*s/rad}}"),)),
    ("DB503", (robot("joints: {pole_hinge: {damping: 1 N*s/m}}"),)),
    ("DB105", (robot("joints: {pole_hinge: {range: 1 .. 1 rad}}"),)),
    ("DB503", (robot("joints: {pole_hinge: {range: -1 .. 1 m}}"),)),
    ("DB502", (robot("joints: {pole_hinge: {range: -1 .. 1}}"),)),
    ("DB502", (("uniform(-1 .. 1 deg)", "integer(1 .. 2)"),)),
    ("DB203", (robot('joints: {"wheel_*": {range: -1 .. 1 rad}}'),)),
    ("DB503", (robot("joints: {pole_hinge: {armature: 0.1 kg}}"),)),
    ("DB105", (robot("joints: {pole_hinge: {armature: -1 kg*m^2}}"),)),
    # Copies without the policy that acts for them.
    ("DB108:count", (robot("count: 2"), robot("spacing: 0 1 0 m"))),
    ("DB108:spacing", (robot("spacing: 0 1 0 m"),)),
]
ERRORS_OF_CARTPOLE = [  # What cannot be computed is one error, whatever else follows.
    *(
        ("timestep: 32 ms", f"timestep: {figure}")
        for figure in ("32 ms / 0", "1e300 s * 1e300", "sqrt(-1) * 1 s", "log(0) * 1 s")
    ),
    *(("track:       0.39 m", f"track: {figure} * 1 m") for figure in ("1 / 0", "1e300 * 1e300")),
]


def found(findings, expected: str) -> str:
    return " ".join(
        f"{finding.code}:{finding.span.text}" if ":" in expected else finding.code for finding in findings
    )


@pytest.mark.parametrize(("expected", "edits"), OF_CARTPOLE)
def test_a_change_of_cartpole_brings_these_findings(workshop, cartpole, expected, edits) -> None:
    assert found(workshop.lint(cartpole(*edits)), expected) == expected


@pytest.mark.parametrize(("expected", "edits"), OF_RAIL)
def test_a_change_of_the_rail_brings_these_findings(workshop, rail, expected, edits) -> None:
    findings = workshop.lint(rail(*edits))
    kept = [finding for finding in findings if len(findings) < 99 or finding.severity == "error"]
    assert found(kept, expected) == expected


@pytest.mark.parametrize("edit", ERRORS_OF_CARTPOLE)
def test_what_cannot_be_computed_is_one_error(workshop, cartpole, edit) -> None:
    errors = [finding for finding in workshop.lint(cartpole(edit)) if finding.severity == "error"]
    assert found(errors, "") == "DB105"


def test_a_chain_of_nested_operations_is_a_finding_and_not_an_error(workshop, cartpole) -> None:
    findings = workshop.lint(cartpole(*chain(20, f"{'(1 mm - ' * 60}NEXT{')' * 60}")))
    assert {finding.code for finding in findings} == {"DB005"}
    assert findings[0].headline == "`p0` depends on too long a chain of definitions"


@pytest.mark.parametrize(("length", "expected"), [(MAX_CHAIN - 1, ""), (MAX_CHAIN, "DB005"), (400, "DB005")])
def test_a_chain_of_drawn_values_in_the_order_of_the_file_has_a_limit(
    workshop, cartpole, length, expected
) -> None:
    links = "".join(f"  p{n}: p{n - 1} * 1.01\n" for n in range(1, length))
    edits = (
        ("parameters:\n", f"parameters:\n  p0: uniform(0 .. 1 mm)\n{links}"),
        ("forward: 1,", "forward: 1, wait: 0,"),
        ("-0.4 .. 0.4 m", "-1 .. 1 m"),
        ("> track", f"> track + p{length - 1}"),
    )
    assert found(workshop.lint(cartpole(*edits)), "") == expected

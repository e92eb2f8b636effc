"""Files that mean harm, and the codes that have to answer them.

What they are after: time, memory, the stack of an interpreter, files that are none of the scenario's
business, code that runs, a parser that believes what it is told.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

SCENARIO = """\
deepbots: 1
name: Hostile
world: {timestep: 20 ms}
robots:
  cart:
    urdf: rail.urdf
    base: fixed
    actuators: {motor: {type: torque_motor, joint: slider, max_torque: 5 N}}
    apply: {motor: push * 4 N}
action: {push: -1 .. 1}
augment: {lean: joint_position(cart.hinge)}
observation: {lean: -20 .. 20 deg}
reward: {upright: "cos(lean)"}
truncation: {max_steps: 100}
"""
ROBOT = (Path(__file__).parents[1] / "fuzz" / "seeds" / "rail.urdf").read_bytes()
MESHED = b"""<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="%b"/></geometry></visual></link></robot>"""
MEGA = 1 << 20

Make = Callable[[Path], None]


@dataclass(frozen=True)
class Hostile:
    """A scenario `text`, further `files`, and what else is `made` in the folder; at least one of `codes` has
    to be found.

    `make test` leaves out what is `slow`, since another case meets the same limit, and every second of the
    others.
    """

    name: str
    codes: tuple[str, ...]
    text: bytes
    files: dict[str, bytes] = field(default_factory=dict)
    make: Make | None = None
    slow: bool = False

    def write(self, folder: Path) -> Path:
        """Write everything into `folder`, an empty one; the path of the scenario."""
        (folder / "deepbots.toml").touch()
        (folder / "rail.urdf").write_bytes(ROBOT)
        for name, data in self.files.items():
            (folder / name).write_bytes(data)
        if self.make is not None:
            self.make(folder)
        main = folder / "hostile.yaml"
        main.write_bytes(self.text)
        return main


def changed(old: str, new: str) -> bytes:
    if old not in SCENARIO:
        raise ValueError(old)
    return SCENARIO.replace(old, new).encode("utf-8", "surrogatepass")


def added(text: str) -> bytes:
    return (SCENARIO + text).encode("utf-8", "surrogatepass")


def cases() -> Iterator[Hostile]:
    yield from _of_yaml()
    yield from _of_bytes()
    yield from _of_expressions()
    yield from _of_numbers()
    yield from _of_includes()
    yield from _of_paths()
    yield from _of_robot_files()
    yield from _of_meshes()
    yield from _of_pictures()


def _of_yaml() -> Iterator[Hostile]:
    laughs = "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" if i else "a0: &a0 [x, x]\n" for i in range(30)
    )
    yield Hostile("alias bomb", ("DB005",), added(laughs))
    yield Hostile(
        "alias bomb of many small steps",
        ("DB005",),
        added("a: &a [" + "x, " * 1000 + "x]\nb: [" + "*a, " * 10_000 + "*a]\n"),
    )
    merging = "".join(
        f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 9)}]}}\n" if i else "m0: &m0 {x: 1}\n"
        for i in range(20)
    )
    yield Hostile("merge-key bomb", ("DB101", "DB005"), added(merging))
    yield Hostile("anchor in itself", ("DB001",), added("loop: &a [*a, *a]\n"))
    yield Hostile(
        "a hundred thousand anchors", ("DB005",), added("".join(f"k{i}: &a{i} x\n" for i in range(60_000)))
    )
    for sign in ("[", "{a: ", "- ", "? ", "[{a: ", "!t [", "&a ["):
        yield Hostile(
            f"nested by `{sign.strip()}`",
            ("DB005", "DB001"),
            added("deep: " + ("\n  " if sign in ("- ", "? ") else "") + sign * 50_000),
        )
    yield Hostile("nested by indentation", ("DB005",), added("".join(f"{' ' * i}k:\n" for i in range(900))))
    yield Hostile("many documents", ("DB001",), SCENARIO.encode() + b"---\na: 1\n" * 50_000)
    yield Hostile("many keys", ("DB005", "DB101"), added("".join(f"k{i}: 1\n" for i in range(60_000))))
    yield Hostile("one key forty thousand times", ("DB002", "DB005"), added("again: 1\n" * 40_000))
    yield Hostile(
        "python object", ("DB005",), added('evil: !!python/object/apply:os.system ["touch pwned"]\n')
    )
    yield Hostile("python name as a key", ("DB005", "DB001"), added("!!python/name:os.system : 1\n"))
    yield Hostile(
        "tag of one's own",
        ("DB001", "DB005"),
        b"%TAG ! tag:evil.example,2000:\n---\n" + added("evil: !thing x\n"),
    )
    yield Hostile("quote that is never closed", ("DB001",), added('x: "' + "y" * 900_000))
    yield Hostile("key of half a megabyte", ("DB101", "DB001"), added("k" * 500_000 + ": 1\n"))
    yield Hostile(
        "unknown keys that are alike",
        ("DB101",),
        added("".join(f"{'timesteq' * 20}{i}: 1\n" for i in range(3000))),
    )
    yield Hostile("escapes without end", ("DB101",), added('x: "' + "\\u00e9" * 150_000 + '"\n'))
    yield Hostile(
        "suppressions without number",
        ("DB101",),
        added("".join(f"# deepbots: ignore[XB{i}]\n" for i in range(30_000)) + "x: 1\n"),
    )
    yield Hostile(
        "suppression of everything",
        ("DB101",),
        added(f"x: 1 # deepbots: ignore[{' '.join(f'DB{i}' for i in range(90_000))}]\n"),
        slow=True,
    )
    yield Hostile(
        "suppressions on one line", ("DB101",), added("x: 1 " + "# deepbots: ignore[DB604] " * 35_000 + "\n")
    )
    yield Hostile(
        "aliases without anchors", ("DB001",), added("".join(f"k{i}: *nothing{i}\n" for i in range(30_000)))
    )
    yield Hostile(
        "tags without number", ("DB005",), added("".join(f"k{i}: !t{i} 1\n" for i in range(40_000)))
    )
    yield Hostile(
        "old truth values without number", ("DB005", "DB101"), added("x: [" + "yes, " * 30_000 + "yes]\n")
    )
    yield Hostile("words like one key", ("DB101",), added("".join(f"timestep{i}: 1\n" for i in range(3_500))))
    directives = "".join(f"%TAG !a{i}! tag:x{i}:\n" for i in range(40_000))
    yield Hostile("directives without number", ("DB001",), directives.encode() + b"---\n" + SCENARIO.encode())
    yield Hostile("directive", ("DB001",), b"%YAML 99999999999999999999.1\n---\n" + SCENARIO.encode())


def _of_bytes() -> Iterator[Hostile]:
    yield Hostile("line of ten megabytes", ("DB005",), added("x: " + "y" * (10 * MEGA)))
    yield Hostile("file of ten megabytes", ("DB005",), added("# comment\n" * MEGA))
    yield Hostile("empty", ("DB107",), b"")
    yield Hostile("byte order mark alone", ("DB107",), b"\xef\xbb\xbf")
    yield Hostile("two byte order marks", ("DB001", "DB101"), b"\xef\xbb\xbf\xef\xbb\xbf" + SCENARIO.encode())
    yield Hostile("NUL", ("DB001",), added("x: a\0b\n"))
    yield Hostile("zeros", ("DB001",), b"\0" * MEGA)
    yield Hostile("UTF-16", ("DB001",), SCENARIO.encode("utf-16"))
    yield Hostile("UTF-16 without a mark", ("DB001",), SCENARIO.encode("utf-16-le"))
    yield Hostile("UTF-32", ("DB001",), SCENARIO.encode("utf-32"))
    yield Hostile("not UTF-8", ("DB001",), added("x: ").rstrip(b"\n") + b"\xff\xfe\xfa\n")
    yield Hostile("overlong UTF-8", ("DB001",), added("x: ") + b"\xc0\xaf\n")
    yield Hostile("surrogates", ("DB001",), added("x: \ud800\n"))
    yield Hostile("text that turns around", ("DB101",), added("x: '\u202egnp.exe'\n"))
    yield Hostile("control characters", ("DB001",), added("x: \x1b[2J\n"))
    yield Hostile("line separators", ("DB001",), added("x: a\u2028b\n"))


def _of_expressions() -> Iterator[Hostile]:
    for name, opening, closing in (
        ("parentheses", "(", ")"), ("minus", "- ", ""), ("not", "not ", ""),
        ("power", "2^", ""), ("calls", "abs(", ")"), ("sums", "1 + ", ""),
    ):  # fmt: skip
        for count in (3000, 100_000):
            text = opening * count + "1" + closing * count
            yield Hostile(f"{name}, {count} deep", ("DB005",), changed('"cos(lean)"', f'"{text}"'))
    yield Hostile(
        "expression of half a megabyte",
        ("DB005",),
        changed('"cos(lean)"', '"' + "lean + " * 70_000 + 'lean"'),
    )
    yield Hostile("name of many parts", ("DB401", "DB402"), changed('"cos(lean)"', '"' + "a." * 4000 + 'a"'))
    yield Hostile(
        "code in an expression",
        ("DB401", "DB402"),
        changed('"cos(lean)"', """"__import__('os').system('touch pwned')\""""),
    )
    chain = "".join(f"  s{i}: s{i + 1} + s{i + 1}\n" for i in range(2000))
    yield Hostile(
        "signals upon signals", ("DB005", "DB402", "DB205"), added(f"signals:\n{chain}  s2000: lean\n")
    )
    unknown = "".join(f"  s{i}: laen{i}\n" for i in range(3_500))
    yield Hostile(
        "thousands of names that nobody knows", ("DB402",), added(f"signals:\n{unknown}"), slow=True
    )
    endings = "".join(f"    f{i}: abs(lean) > {i} deg\n" for i in range(1, 3_500))
    yield Hostile("thousands of endings", ("DB005",), added(f"termination:\n  failure:\n{endings}"))
    yield Hostile("signals in a circle", ("DB207",), added("signals: {a: b + 1, b: a + 1}\n"))
    yield Hostile("pattern of stars", ("DB206",), changed("joint: slider", f'joints: ["{"*a" * 2000}b"]'))
    yield Hostile(
        "pattern with classes", ("DB206", "DB201"), changed("joint: slider", f'joints: ["{"[a-z]*" * 300}!"]')
    )


def _of_numbers() -> Iterator[Hostile]:
    yield Hostile(
        "integer of a megabyte",
        ("DB105", "DB401", "DB103"),
        changed("max_steps: 100", "max_steps: " + "9" * 900_000),
    )
    yield Hostile(
        "integer of 5000 digits",
        ("DB401", "DB103", "DB105"),
        changed("max_steps: 100", "max_steps: " + "9" * 5000),
    )
    yield Hostile(
        "digits and then underscores", ("DB101",), added("x: " + "1" * 400_000 + "_" * 400_000 + "x\n")
    )
    yield Hostile(
        "exponent", ("DB105", "DB401", "DB103"), changed("max_steps: 100", "max_steps: 1e999999999")
    )
    yield Hostile("infinity", ("DB105", "DB103", "DB401"), changed("max_steps: 100", "max_steps: .inf"))
    yield Hostile("not a number", ("DB105", "DB103", "DB401"), changed("20 ms", ".nan"))
    yield Hostile("denormal timestep", ("DB105", "DB308"), changed("20 ms", "5e-324 s"))
    for what, text in (
        ("copies", "objects: {ball: {shape: sphere, radius: 1 cm, count: 1000000000}}\n"),
        ("attempts", "reset: {attempts: 1000000000000}\n"),
        ("stack", "agent: {frame_stack: 1000000000}\n"),
        (
            "layers of a network",
            "train: {algorithm: PPO, total_timesteps: 10, network: {hidden: [1000000000]}}\n",
        ),
        ("environments", "train: {algorithm: PPO, total_timesteps: 10, environments: 1000000000}\n"),
    ):
        yield Hostile(f"a billion {what}", ("DB005", "DB105"), added(text))
    for what, text in (
        (
            "rays",
            "sensors: {eye: {type: lidar, link: cart, angle_range: 180 .. -180 deg, rays: 1000000000, range: 0"
            " .. 1 m}}",
        ),
        ("pixels", "sensors: {eye: {type: camera, link: cart, resolution: 100000 100000}}"),
        ("robots", "count: 1000000000\n    spacing: 0 1 0 m"),
    ):
        yield Hostile(
            f"a billion {what}",
            ("DB005", "DB105", "DB108"),
            changed("base: fixed", f"base: fixed\n    {text}"),
        )
    yield Hostile(
        "history",
        ("DB005", "DB105"),
        changed("{lean: -20 .. 20 deg}", "{lean: {range: -20 .. 20 deg, history: 1000000000}}"),
    )
    letters = "\n".join("        " + ". " * 1000 for _ in range(400))
    text = (
        f"reset:\n  layout: big\n  layouts:\n    big:\n      cell: 1 cm\n      legend: {{R: cart}}\n     "
        f" map: |\n{letters}\n"
    )
    yield Hostile("map of 400 000 letters", ("DB005",), added(text))
    many = ", ".join(f"c{i}: {{set: {{world.substeps: {i + 1}}}}}" for i in range(2000))
    large = "".join(f"  p{i}: {i}\n" for i in range(3_000))
    some = ", ".join(f"c{i}: {{set: {{p0: {i}}}}}" for i in range(60))
    yield Hostile(
        "cases of a large scenario",
        ("DB005",),
        added(f"parameters:\n{large}evaluation: {{episodes: 1, cases: {{{some}}}}}\n"),
    )
    deep = added(f'evaluation: {{episodes: 1, cases: {{c: {{set: {{"{".".join("a" * 200)}": 1}}}}}}}}\n')
    yield Hostile("setting of two hundred steps", ("DB005",), deep)
    yield Hostile(
        "thousands of cases", ("DB005", "DB105"), added(f"evaluation: {{episodes: 1, cases: {{{many}}}}}\n")
    )


def _of_includes() -> Iterator[Hostile]:
    yield Hostile("file that extends itself", ("DB204",), b"deepbots: 1\nextends: hostile.yaml\n")
    circle = {"a.yaml": b"extends: b.yaml\n", "b.yaml": b"extends: a.yaml\n"}
    yield Hostile("files in a circle", ("DB204",), b"deepbots: 1\nextends: a.yaml\n", circle)
    chain = {f"c{i}.yaml": b"extends: c%d.yaml\n" % (i + 1) for i in range(500)}
    yield Hostile("five hundred files in a chain", ("DB204",), b"deepbots: 1\nextends: c0.yaml\n", chain)
    fan = {
        f"f{i}.yaml": b"a: {include: f%d.yaml}\nb: {include: f%d.yaml}\n" % (i + 1, i + 1) for i in range(25)
    } | {"f25.yaml": b"x: 1\n"}
    yield Hostile("files that double", ("DB005", "DB204"), b"deepbots: 1\nextends: f0.yaml\n", fan)
    nested = {f"n{i}.yaml": b"[" * 60 + b"{include: n%d.yaml}" % (i + 1) + b"]" * 60 for i in range(10)} | {
        "n10.yaml": b"x: 1\n"
    }
    yield Hostile("depth in steps", ("DB005", "DB103"), b"deepbots: 1\nextends: n0.yaml\n", nested)
    wide = {f"w{i}.yaml": b"x: [" + b"1, " * 20_000 + b"1]\n" for i in range(20)}
    text = added("".join(f"k{i}: {{include: w{i}.yaml}}\n" for i in range(20)))
    yield Hostile("many large parts", ("DB005",), text, wide)
    heavy = {f"h{i}.yaml": b"#" * (MEGA - 8) + b"\nx: 1\n" for i in range(40)}
    text = added("".join(f"k{i}: {{include: h{i}.yaml}}\n" for i in range(40)))
    yield Hostile("files of a megabyte by the dozen", ("DB005",), text, heavy)
    yield Hostile(
        "included binary", ("DB001",), added("k: {include: b.yaml}\n"), {"b.yaml": bytes(range(256)) * 1000}
    )
    yield Hostile(
        "included file of ten megabytes",
        ("DB005",),
        added("k: {include: b.yaml}\n"),
        {"b.yaml": b"#" * (10 * MEGA)},
    )


OUTSIDE = [
    *(
        "/etc/passwd",
        "/dev/zero",
        "/dev/stdin",
        "/proc/self/mem",
        "/proc/self/environ",
        "../secret.yaml",
        "../../../../../../etc/passwd",
        "~/.bashrc",
    ),
    *(
        "~root/.bashrc",
        "//etc/passwd",
        "file:///etc/passwd",
        "http://127.0.0.1:9/x.yaml",
        "package://../../etc/passwd",
        "package://os/../../../etc/passwd",
    ),
    *(
        "package://deepbots_cli/../../pyproject.toml",
        "package://yaml/../../../../../../../../etc/passwd",
        "package:///etc/passwd",
        "$HOME/.bashrc",
    ),
    *(
        "link.yaml",
        "folder_link/passwd",
        "loop.yaml",
        "pipe.yaml",
        "folder.yaml",
        "",
        ".",
        "..",
        "/",
        "x" * 5000,
        "a/" * 3000 + "x",
        "a\\0b",
        "con\\nf",
    ),
]


def _make_traps(folder: Path) -> None:
    (folder.parent / "secret.yaml").write_text("x: secret\n")
    (folder / "link.yaml").symlink_to("/etc/passwd")
    (folder / "folder_link").symlink_to("/etc")
    (folder / "loop.yaml").symlink_to("loop.yaml")
    (folder / "folder.yaml").mkdir()
    os.mkfifo(folder / "pipe.yaml")


def _of_paths() -> Iterator[Hostile]:
    """Every path in every place; `make test` tries every path by `extends`, and in each other place every
    third."""
    for number, path in enumerate(OUTSIDE):
        others = [(number + place) % 3 != 0 for place in range(5)]
        shown = f"{path[:40]}…" if len(path) > 40 else path or "nothing"
        quoted = f'"{path}"'
        yield Hostile(
            f"extends {shown}",
            ("DB204", "DB107", "DB103"),
            f"deepbots: 1\nextends: {quoted}\n".encode(),
            make=_make_traps,
        )
        yield Hostile(
            f"includes {shown}",
            ("DB204", "DB107", "DB103"),
            added(f"k: {{include: {quoted}}}\n"),
            make=_make_traps,
            slow=others[0],
        )
        robot = changed("rail.urdf", quoted)
        yield Hostile(
            f"robot from {shown}",
            ("DB204", "DB301", "DB201", "DB107", "DB103"),
            robot,
            make=_make_traps,
            slow=others[1],
        )
        codes = ("DB204", "DB301", "DB103", "DB107", "DB105")
        thing = added(f"objects: {{thing: {{shape: mesh, file: {quoted}, mass: 1 kg}}}}\n")
        yield Hostile(f"mesh of an object from {shown}", codes, thing, make=_make_traps, slow=others[2])
        relief = changed(
            "timestep: 20 ms",
            f"timestep: 20 ms, terrain: {{type: heightfield, file: {quoted}, size: 4 4 m, height: 1 m}}",
        )
        yield Hostile(f"heights from {shown}", codes, relief, make=_make_traps, slow=others[3])
        if "\\" not in path:
            codes = ("DB301", "DB204")
            meshed = {"rail.urdf": MESHED % path.encode()}
            yield Hostile(
                f"mesh of a robot from {shown}",
                codes,
                SCENARIO.encode(),
                meshed,
                make=_make_traps,
                slow=others[4],
            )


def _of_robot_files() -> Iterator[Hostile]:
    def robot(name: str, data: bytes, *codes: str) -> Hostile:
        return Hostile(name, codes or ("DB301",), SCENARIO.encode(), {"rail.urdf": data})

    entities = b"".join(
        b'<!ENTITY a%d "%b">' % (i, b"&a%d;" % (i - 1) * 10 if i else b"ha") for i in range(30)
    )
    yield robot("entity bomb", b"<!DOCTYPE r [" + entities + b']><robot name="&a29;"/>')
    yield robot(
        "entity bomb of one step",
        b'<!DOCTYPE r [<!ENTITY a "' + b"x" * 100_000 + b'">]><robot>' + b"&a;" * 10_000 + b"</robot>",
    )
    yield robot(
        "external entity", b'<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="&e;"/>'
    )
    yield robot("external DTD", b'<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>')
    yield robot("parameter entity", b'<!DOCTYPE r [<!ENTITY % p SYSTEM "file:///dev/zero"> %p;]><robot/>')
    yield robot("elements nested", b"<robot>" + b"<a>" * 500_000, "DB005", "DB301")
    yield robot("elements without number", b"<robot>" + b"<a/>" * 900_000 + b"</robot>", "DB005", "DB301")
    yield robot(
        "attributes without number",
        b"<robot " + b" ".join(b'a%d="1"' % i for i in range(200_000)) + b"/>",
        "DB005",
        "DB301",
    )
    yield robot("large", b"<robot>" + b" " * (5 * MEGA) + b"</robot>", "DB005", "DB301")
    yield robot("UTF-16 robot", '<?xml version="1.0" encoding="utf-16"?><robot/>'.encode("utf-16"))
    yield robot("encoding that does not exist", b'<?xml version="1.0" encoding="rot13"?><robot/>')
    yield robot("binary robot", bytes(range(256)) * 4000)
    yield robot("text without end", b"<robot><link name='" + b"x" * (3 * MEGA))
    yield robot("comment without end", b"<robot><!--" + b"x" * (3 * MEGA))
    chain = b"".join(
        b'<link name="l%d"/><joint name="j%d" type="fixed"><parent link="l%d"/><child link="l%d"/></joint>'
        % (i, i, i - 1, i)
        for i in range(1, 20_000)
    )
    yield robot(
        "twenty thousand links", b'<robot name="r"><link name="l0"/>' + chain + b"</robot>", "DB005", "DB301"
    )
    ring = b"".join(
        b'<joint name="j%d" type="fixed"><parent link="l%d"/><child link="l%d"/></joint>'
        % (i, i, (i + 1) % 9)
        for i in range(9)
    )
    yield robot(
        "links in a ring",
        b'<robot name="r">' + b"".join(b'<link name="l%d"/>' % i for i in range(9)) + ring + b"</robot>",
    )
    yield robot(
        "numbers of a megabyte", ROBOT.replace(b'mass value="10"', b'mass value="' + b"9" * MEGA + b'"')
    )


def _of_meshes() -> Iterator[Hostile]:
    def mesh(name: str, file: str, data: bytes, *codes: str) -> Hostile:
        return Hostile(
            name, codes or ("DB301",), SCENARIO.encode(), {"rail.urdf": MESHED % file.encode(), file: data}
        )

    def thing(name: str, file: str, data: bytes, *codes: str) -> Hostile:
        text = added(f"objects: {{thing: {{shape: mesh, file: {file}, mass: 1 kg}}}}\n")
        return Hostile(
            f"{name}, of an object",
            codes or ("DB301", "DB005"),
            text,
            {file: data},
            slow=file.endswith((".obj", ".dae")),
        )

    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    faces = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 3_900_000
    for make in (mesh, thing):
        yield make(
            "STL that claims four billion triangles", "m.stl", b"\0" * 80 + b"\xff\xff\xff\xff" + triangle
        )
        yield make("STL cut off", "m.stl", b"\0" * 80 + struct.pack("<I", 10) + triangle * 5)
        yield make(
            "STL that begins as text", "m.stl", b"solid " + b"\0" * 74 + struct.pack("<I", 9) + triangle
        )
        yield make(
            "STL that is not a number",
            "m.stl",
            b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", *[float("nan")] * 12, 0),
        )
        yield make("OBJ whose faces name no vertex", "m.obj", b"v 0 0 0\nf 1 2 999999999999\n")
        yield make("OBJ that is not a number", "m.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        yield make("OBJ of millions of faces", "m.obj", faces, "DB301", "DB005")
        yield make(
            "OBJ of ten million faces", "m.obj", b"v 0 0 0\n" + b"f 1 1 1\n" * 10_000_000, "DB301", "DB005"
        )
        yield make("OBJ of one line", "m.obj", b"v" + b" 0" * 10_000_000)
        yield make(
            "OBJ with a face of millions of corners",
            "m.obj",
            b"v 0 0 0\nf" + b" 1" * 5_000_000 + b"\n",
            "DB301",
            "DB005",
            "DB105",
        )
        yield make(
            "COLLADA with an entity bomb", "m.dae", b'<!DOCTYPE a [<!ENTITY b "ha">]><COLLADA>&b;</COLLADA>'
        )
        yield make("COLLADA that is nested", "m.dae", b"<COLLADA>" + b"<a>" * 1_000_000)
        yield make("archive", "m.stl", b"PK\x03\x04" + b"\0" * 1000)
        yield make("empty mesh", "m.obj", b"")
        yield make("mesh in a format that is not read", "m.blend", b"BLENDER")


def _png(width: int, height: int, packed: bytes, color: int = 0, bits: int = 8, interlaced: int = 0) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def _of_pictures() -> Iterator[Hostile]:
    bomb = zlib.compress(b"\0" * (200 * MEGA), 9)
    relief = changed(
        "timestep: 20 ms",
        "timestep: 20 ms, terrain: {type: heightfield, file: p.png, size: 4 4 m, height: 1 m}",
    )
    for name, data in {
        "that claims ten billion pixels": _png(100_000, 100_000, zlib.compress(b"\0" * 1000)),
        "that claims more pixels than it holds": _png(1000, 1000, zlib.compress(b"\0" * 1000)),
        "that is a bomb": _png(64, 64, bomb),
        "that is a bomb and claims little less": _png(1025, 1025, bomb, bits=16)[: 4 * MEGA],
        "of no size": _png(0, 0, b""),
        "cut off": _png(64, 64, zlib.compress(b"\0" * 65 * 64))[:60],
        "that is interlaced": _png(64, 64, zlib.compress(b"\0" * 65 * 64), interlaced=1),
        "with a filter that does not exist": _png(64, 64, zlib.compress(b"\x09" * 65 * 64)),
        "of five megabytes": _png(64, 64, b"\0" * (5 * MEGA)),
        "whose first piece is four gigabytes": b"\x89PNG\r\n\x1a\n\xff\xff\xff\xffIHDR" + b"\0" * 100,
    }.items():
        yield Hostile(f"picture {name}", ("DB103", "DB301", "DB005"), relief, {"p.png": data})

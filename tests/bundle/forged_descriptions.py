"""Ways to forge bundle.json."""

from __future__ import annotations

import hashlib
import random
from typing import Any

from deepbots_robot import bundle
from tests.bundle.forged import HUGE, NUMBERS, TEXTS, Forged, as_json


def _places(tree: Any) -> list[tuple[Any, Any]]:
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                collect(node[key])

    collect({key: value for key, value in tree.items() if key != "files"})
    return [*places, *((tree, key) for key in tree)]


def json_value(rng: random.Random, forged: Forged) -> None:
    node, key = rng.choice(_places(forged.tree))
    node[key] = rng.choice(
        [
            None,
            True,
            [],
            {},
            [node[key]],
            {"a": node[key]},
            HUGE,
            rng.choice(TEXTS),
            *rng.sample(NUMBERS, 6),
        ]
    )


def json_number(rng: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if type(node[key]) in (int, float)]
    node, key = rng.choice(places)
    node[key] = rng.choice([-node[key], node[key] * 2, node[key] * 1e6, node[key] + 1, *NUMBERS, HUGE])


def json_text(rng: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node[key], str)]
    node, key = rng.choice(places)
    node[key] = rng.choice([*TEXTS, node[key] + "\n", node[key].upper(), node[key] + "_next"])


def json_list(rng: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node[key], list)]
    node, key = rng.choice(places)
    value = node[key]
    node[key] = rng.choice(
        [value[::-1], value[:-1], value * 2, value * 5_000, [value], [*value, None], sorted(value, key=str)]
    )


def json_keys(rng: random.Random, forged: Forged) -> None:
    """A key is missing, new, renamed, or in another record."""
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node, dict)]
    node, key = rng.choice(places)
    match rng.randrange(4):
        case 0:
            del node[key]
        case 1:
            node[rng.choice(["extra", "__class__", *TEXTS])] = rng.choice([1, [], {}, "x"])
        case 2:
            node[key + "s"] = node.pop(key)
        case _:
            forged.tree[key] = node[key]


def json_depth(rng: random.Random, forged: Forged) -> None:
    text = as_json(forged.tree)
    depth = rng.choice([50, 1_000, 100_000, 2_000_000])
    nested = {0: b"[" * depth, 1: b'{"a":' * depth, 2: b"[" * depth + b"]" * depth}[rng.randrange(3)]
    at = rng.choice([0, text.index(b":") + 1, text.rindex(b":") + 1])
    forged.description = text[:at] + nested + text[at:]


def json_twice(rng: random.Random, forged: Forged) -> None:
    """A key twice, of which one reader may take the first and another the last."""
    text = as_json(forged.tree)
    key = rng.choice(["outputs", "inputs", "files", "rate_hz", "format"])
    first = rng.random() < 0.5
    value = as_json(rng.choice([forged.tree[key], None, []]))
    pair = b'"' + key.encode() + b'":' + value
    forged.description = text[:1] + pair + b"," + text[1:] if first else text[:-1] + b"," + pair + text[-1:]


def json_layout(rng: random.Random, forged: Forged) -> None:
    text = as_json(forged.tree)
    forged.description = rng.choice(
        [
            b"\xef\xbb\xbf" + text,
            text + b"\x00",
            text + text,
            b" " * 9_000_000 + text,
            b"\n" + text,
            text.replace(b'"', b"'"),
            text.decode().encode("utf-16"),
            text.replace(b"a", b"\\u0061", 3),
            text.replace(b".0", b".00", 1),
            b"",
            b"null",
            b"[]",
        ]
    )


def json_limits(rng: random.Random, forged: Forged) -> None:
    """Ranges, rates and safe commands, by which a robot is kept from harm."""
    output = rng.choice(forged.tree["outputs"])
    size = output["shape"][0]
    key = rng.choice(["range", "max_rate", "max_effort", "safe"])
    value = rng.choice([None, 0, -1, 1e-9, 1e12, 1e300, "@NaN@", "@1e999@"])
    if key == "range":
        low, high = output["range"]
        ends = [
            [high, low],
            [low, low],
            [[None] * size] * 2,
            [[-1e300] * size, [1e300] * size],
            [low[:-1], high],
            [[value] * size, high],
        ]
        output["range"] = rng.choice(ends)
    else:
        output[key] = rng.choice([[value] * size, [value] * (size + 1), [], [value]])


def json_memory(rng: random.Random, forged: Forged) -> None:
    memories = forged.tree["memory"]
    if not memories or rng.random() < 0.4:
        shape = rng.choice([[1], [4_000_000], [2_000, 2_000], [1] * 4, [0], [-1], [1 << 40]])
        new = {
            "name": f"m{rng.randrange(3)}",
            "shape": shape,
            "dtype": rng.choice(["float64", "uint8", "bool"]),
            "initial": [0],
        }
        memories.extend([new] * rng.choice([1, 2, 400]))
        return
    memory = rng.choice(memories)
    memory["initial"] = [rng.choice([1e300, -1e300, 0.5, -1, 300, 1e39, "@NaN@"])] * rng.choice(
        [1, 1, 2, len(memory["initial"])]
    )
    if rng.random() < 0.3:
        memory["dtype"] = rng.choice(["float64", "float32", "int64", "bool", "uint8"])


def json_inputs(rng: random.Random, forged: Forged) -> None:
    entry = rng.choice(forged.tree["inputs"])
    match rng.randrange(6):
        case 0:
            entry["shape"] = rng.choice([[1, 1, 1], [2, 2], [1] * 4, [4_000_000], entry["shape"] * 2, [0]])
        case 1:
            entry["dtype"] = rng.choice(["float64", "float32", "int64", "bool", "uint8"])
        case 2:
            entry["robot"] = rng.choice(["a b", "ä", "/", None, "x" * 200])
        case 3:
            forged.tree["inputs"].append(
                {
                    **entry,
                    "name": rng.choice([f"{entry['name']} ", entry["name"].replace("(", " "), "?", "(", ")"]),
                }
            )
        case 4:
            entry["source"] = rng.choice(["goal", "sensor", "supervisor"])
            entry["rate_hz"] = rng.choice([1e-6, 1e6, 1.0])
        case _:
            entry["max_age_s"] = rng.choice([None, 1e-9, 1e6, 5e-324])
            entry["latency_s"] = rng.choice([0, 1e6])


def json_files(rng: random.Random, forged: Forged) -> None:
    files = forged.tree["files"]
    digest = rng.choice([hashlib.sha256(b"").hexdigest(), "0" * 64, "A" * 64, "", "0" * 64 + "\n"])
    name = rng.choice(
        [
            "/dev/zero",
            "/etc/passwd",
            "../x",
            "a/../../x",
            "inputs",
            ".",
            "",
            "a" * 256,
            "é" * 200,
            "a/" * 249 + "a",
            "a//b",
            "bundle.json",
            "C:x",
            "a\\b",
            "x\n",
            bundle.SIGNATURE_NAME,
            "README.md/x",
            "policy.onnx/",
        ]
    )
    match rng.randrange(3):
        case 0:
            files[name] = digest
        case 1:
            files.pop(rng.choice(sorted(files)))
        case _:
            files |= {f"inputs/{number}": digest for number in range(rng.choice([1, 4_000, 6_000]))}


def json_topics(rng: random.Random, forged: Forged) -> None:
    name = rng.choice([entry["name"] for key in ("inputs", "outputs") for entry in forged.tree[key]])
    types = [
        "std_msgs/Float64MultiArray",
        "sensor_msgs/JointState",
        "sensor_msgs/Image",
        "geometry_msgs/Twist",
        "x/Y",
        "",
    ]
    topic = rng.choice(["/a", "a", "/", "/a\n", "/a/" + "b" * 200, "/deepbots/action", "/deepbots/episode"])
    forged.tree["ros"] = {
        name: {
            "topic": topic,
            "type": rng.choice(types),
            "part": rng.choice([None, "data", "position", "x", "linear.x"]),
        }
    }


def json_actions(rng: random.Random, forged: Forged) -> None:
    action = forged.tree["action"]
    part = rng.choice(action)
    match rng.randrange(4):
        case 0:
            part["options"] = {f"o{number}": {} for number in range(rng.choice([0, 1, 2, 100_000]))}
        case 1:
            action.extend([part] * rng.choice([1, 5_000]))
        case 2:
            part["low"], part["high"] = rng.choice([(1, -1), (0, 0), (-1e300, 1e300), (None, 1)])
        case _:
            action.remove(part)

"""Files that went wrong: a number becomes a scenario with its robot and its parts, one of which was damaged.

The damage is of every size: single bits and bytes, signs of YAML, XML and expressions, words and numbers
exchanged, lines moved, two files spliced, a file cut off, values nested too deep. The same number always
gives the same bytes.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SEEDS = Path(__file__).parent / "seeds"
FULL_SHARE = 0.004
"""Of shipped scenarios and golden cases without findings, which take ten times as long as the small ones in
`seeds`."""

READS: dict[str, tuple[str, ...]] = {
    "mini.yaml": ("rail.urdf",),
    "balance.yaml": ("rail.urdf",),
    "wireless.yaml": ("balance.yaml", "rail.urdf"),
    "arena.yaml": ("rover_part.yaml", "rover.urdf", "wedge.obj"),
    "maze.yaml": ("rover_part.yaml", "rover.urdf", "wedge.obj"),
    "reach.yaml": ("rover.urdf", "wedge.obj"),
    "flight.yaml": ("rover.urdf", "wedge.obj"),
    "odd.yaml": ("rail.urdf",),
}
"""The scenarios among the seeds, and what each reads."""
OFTEN = {"mini.yaml": 12, "odd.yaml": 6, "maze.yaml": 1, "arena.yaml": 1}
"""How often each is taken; 2 where nothing is said."""

SIGNS = [
    *(
        ": ",
        ":",
        "- ",
        "? ",
        ", ",
        "{",
        "}",
        "[",
        "]",
        "(",
        ")",
        "|\n",
        ">-\n",
        "&a ",
        "*a",
        "!t ",
        "!!python/object:os.system ",
        "<<: ",
    ),
    *(
        "---\n",
        "...\n",
        "%YAML 1.1\n",
        " #",
        "'",
        '"',
        "\\",
        "\\x4",
        "\n",
        "\n  ",
        "\r",
        "\r\n",
        "\t",
        "\0",
        "\x85",
        "\u2028",
        "\ufeff",
    ),
    *(
        "\ud7ff",
        "é",
        "日",
        "😀",
        "e\u0301",
        "..",
        "+-",
        "^",
        "*",
        "/",
        "==",
        "<=",
        " when ",
        " every ",
        " each step",
        " not ",
        "$",
        "@",
        "`",
        "~",
    ),
    *("<", "/>", "</robot>", "<!--", "-->", "]]>", "<!DOCTYPE a>", "&lt;", "&x;", "<?xml version='9'?>"),
    *(
        " deg",
        " m",
        " rad/s",
        " N*m",
        " %",
        "include: ",
        "extends: ",
        "remove: ",
        "*_",
        "package://",
        "file:///",
        "../",
        "/dev/zero",
        "~/x",
    ),
]
NUMBERS = [
    *(
        "0",
        "-0",
        "-1",
        "1e308",
        "-1e308",
        "1e309",
        "5e-324",
        "1e-320",
        "nan",
        ".nan",
        ".inf",
        "-.inf",
        "9" * 400,
        "0." + "0" * 400 + "1",
    ),
    *(
        "2147483648",
        "18446744073709551616",
        "0x7f",
        "0o17",
        "1_000",
        "1_00",
        "1,5",
        "12:30",
        "1e",
        "1e+",
        "0 .. 0",
        "1 2 3",
        "1e9",
        "1e-9",
    ),
    *("true", "null", "~", "auto", "any", "''", "{}", "[]", "50001", "64", "65", "1000000"),
]
NESTINGS = [
    "[",
    "{a: ",
    "(",
    "-",
    "not ",
    "abs(",
    "- ",
    "? ",
    "- - ",
    "2^",
    "<a>",
    "{include: ",
    "1 if x > 0 else ",
    "'",
    '"',
    "!t ",
    "&a ",
]
_WORD = re.compile(rb"[\w.]+")
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d[\d_.]*(?:e[-+]?\d+)?")
_VALUE = re.compile(rb"(?<=: )[^\n{\[]+?(?=[,}\n])")


@dataclass(frozen=True)
class Case:
    """One damaged scenario: `file` holds `data` in place of what it should, and `main` is linted; both are
    relative to the repository."""

    number: int
    main: Path
    file: Path
    data: bytes


def corpus() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(SEEDS.iterdir())}


def _full_sources() -> list[Path]:
    return sorted(
        [
            *ROOT.glob("scenarios/*.yaml"),
            *ROOT.glob("tests/golden/lint/*/*.yaml"),
            *ROOT.glob("tests/data/scenarios/*.yaml"),
        ]
    )


CORPUS = corpus()
FULL = _full_sources()
SCENARIOS = [name for name in READS for _ in range(OFTEN.get(name, 2))]
WORDS = sorted({word for data in CORPUS.values() for word in _WORD.findall(data)})
LINES = sorted({line for data in CORPUS.values() for line in data.splitlines(keepends=True) if line.strip()})
PIECES = [*(sign.encode("utf-8") for sign in SIGNS), *(number.encode() for number in NUMBERS)]


def case(number: int) -> Case:
    """The damaged scenario of a number."""
    chance = random.Random(number)
    if chance.random() < FULL_SHARE:
        path = chance.choice(FULL)
        return Case(
            number, path.relative_to(ROOT), path.relative_to(ROOT), damaged(path.read_bytes(), chance)
        )
    main = chance.choice(SCENARIOS)
    victim = main if chance.random() < 0.7 else chance.choice(READS[main])
    folder = SEEDS.relative_to(ROOT)
    return Case(number, folder / main, folder / victim, damaged(CORPUS[victim], chance))


def damaged(data: bytes, chance: random.Random) -> bytes:
    """`data` after one change, or, ever less likely, several."""
    while True:
        data = chance.choice(CHANGES)(data, chance)
        if chance.random() < 0.55:
            return data


Change = Callable[[bytes, random.Random], bytes]


def _place(data: bytes, chance: random.Random) -> int:
    return chance.randint(0, len(data))


def _flip(data: bytes, chance: random.Random) -> bytes:
    if not data:
        return data
    at = chance.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]


def _other_byte(data: bytes, chance: random.Random) -> bytes:
    at = _place(data, chance)
    return data[:at] + bytes([chance.randrange(256)]) + data[at + chance.randrange(2) :]


def _delete(data: bytes, chance: random.Random) -> bytes:
    at = _place(data, chance)
    return data[:at] + data[at + chance.choice((1, 1, 1, 2, 3, 8, 40)) :]


def _repeat(data: bytes, chance: random.Random) -> bytes:
    at = _place(data, chance)
    return (
        data[:at] + data[at : at + chance.choice((1, 3, 10, 60))] * chance.choice((2, 2, 3, 50)) + data[at:]
    )


def _insert(data: bytes, chance: random.Random) -> bytes:
    at = _place(data, chance)
    return data[:at] + chance.choice(PIECES) + data[at:]


def _cut_off(data: bytes, chance: random.Random) -> bytes:
    return data[: _place(data, chance)]


def _splice(data: bytes, chance: random.Random) -> bytes:
    """The beginning of one file and the end of another, cut between lines or anywhere."""
    other_file = CORPUS[chance.choice(SCENARIOS)]
    if chance.random() < 0.5:
        return data[: _place(data, chance)] + other_file[_place(other_file, chance) :]
    mine, other_lines = data.splitlines(keepends=True), other_file.splitlines(keepends=True)
    return b"".join(mine[: chance.randint(0, len(mine))] + other_lines[chance.randint(0, len(other_lines)) :])


def _nest(data: bytes, chance: random.Random) -> bytes:
    at = _place(data, chance)
    return (
        data[:at]
        + chance.choice(NESTINGS).encode() * chance.choice((2, 20, 63, 64, 65, 200, 3000))
        + data[at:]
    )


def _exchanged(pattern: re.Pattern[bytes], replacements: list[bytes]) -> Change:
    def change(data: bytes, chance: random.Random) -> bytes:
        matches = list(pattern.finditer(data))
        if not matches:
            return data
        chosen = chance.choice(matches)
        return data[: chosen.start()] + chance.choice(replacements) + data[chosen.end() :]

    return change


def _typo(data: bytes, chance: random.Random) -> bytes:
    words = [word.span() for word in _WORD.finditer(data) if len(word.group()) > 2]
    if not words:
        return data
    at = chance.randrange(*chance.choice(words))
    letter = bytes([chance.choice(b"abcdefghijklmnopqrstuvwxyz_0.")])
    return data[:at] + chance.choice((b"", letter, letter + data[at : at + 1])) + data[at + 1 :]


def _move_lines(data: bytes, chance: random.Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b"\n"]
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    match chance.randrange(6):
        case 0:
            del lines[first]
        case 1:
            lines.insert(first, chance.choice(LINES))
        case 2:
            lines[first], lines[second] = lines[second], lines[first]
        case 3:
            lines[first] = b"  " + lines[first]
        case 4:
            lines[first] = lines[first].lstrip(b" ")
        case _:
            lines[first] = lines[first].rstrip(b"\n") + b" " + lines[second].lstrip()
    return b"".join(lines)


def _requote(data: bytes, chance: random.Random) -> bytes:
    """A value in quotes, in a block, or behind an escape."""
    values = list(_VALUE.finditer(data))
    if not values:
        return data
    chosen = chance.choice(values)
    wrapped = chance.choice(
        (
            b'"%b"',
            b"'%b'",
            b"|\n        %b",
            b">\n        %b\n",
            b'"\\u0020%b"',
            b'"\\n%b\\\n   "',
            b"&a %b",
            b"!!str %b",
        )
    )
    return data[: chosen.start()] + wrapped % chosen.group() + data[chosen.end() :]


CHANGES: tuple[Change, ...] = (
    *(
        _flip,
        _other_byte,
        _delete,
        _repeat,
        _insert,
        _insert,
        _cut_off,
        _splice,
        _nest,
        _typo,
        _typo,
        _move_lines,
        _move_lines,
        _requote,
    ),
    *(
        _exchanged(_WORD, WORDS),
        _exchanged(_WORD, PIECES),
        _exchanged(_NUMBER, PIECES),
        _exchanged(_VALUE, WORDS),
        _exchanged(_VALUE, PIECES),
    ),
)

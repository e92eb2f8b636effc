"""The table "How true is the simulation?" of docs/engines.md, from the record of the part `physics`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from deepbots_cli.words import number_text
from tools.results.card import measured_on, table
from tools.results.standing import Entry

NAMES = {"pybullet": "PyBullet", "mujoco": "MuJoCo", "batch": "a batch", "webots": "Webots"}
_TABLES = re.compile(r"(?<=<!-- physics -->\n).*?(?=<!-- end of physics -->)", re.DOTALL)


def filled(page: str, tables: Entry) -> str:
    """Return the page with the tables of all measured entries between its two comments."""
    lines = [line for entry in tables.values() for line in _lines(entry)]
    return _TABLES.sub(lambda _: "\n".join(["", *lines, "", ""]), page)


def _lines(entry: Entry) -> Iterator[str]:
    verdicts = {
        engine: [engine not in row["wrong"] for row in entry["rows"] if engine in row["measured"]]
        for engine in NAMES
    }
    shares = (f"{NAMES[engine]} {sum(met)} of {len(met)}" for engine, met in verdicts.items())
    yield f"Numbers in the range: {', '.join(shares)}."
    for section, rows in groupby(entry["rows"], key=lambda row: row["section"]):
        cases = [list(group) for _, group in groupby(rows, key=lambda row: row["case"])]
        yield from ("", f"### {section}", "")
        yield from table(
            ("case", "number", "truth", "PyBullet", "MuJoCo", "Webots"),
            (_cells(row, row is case[0]) for case in cases for row in case),
        )
    yield from ("", *measured_on([entry]))


def _cells(row: Any, is_first: bool) -> tuple[str, ...]:
    """Return the cells of a quantity; its first one names the case, and a batch has a number where it
    differs."""
    pybullet, mujoco, batch, webots = (_number(row, engine) for engine in NAMES)
    truth = f"{number_text(row['truth'])} ±" if row["truth"] else "at most"
    return (
        row["case"] if is_first else "",
        row["what"],
        f"{truth} {number_text(row['tolerance'], 2)} {row['unit']}".rstrip(),
        pybullet,
        mujoco if batch in ("", mujoco) else f"{mujoco}; batch {batch}",
        webots,
    )


def _number(row: Any, engine: str) -> str:
    """Return a number, bold where it is not the truth; what is far below the tolerance of an error is 0."""
    value = row["measured"].get(engine, "")
    if not isinstance(value, float):
        return "**diverges**" if value is None else ""
    if not row["truth"] and abs(value) < row["tolerance"] / 100:
        return "0"
    text = number_text(value, 4 if row["truth"] or abs(value) >= 100 else 2)
    return f"**{text}**" if engine in row["wrong"] else text

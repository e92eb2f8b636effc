"""Parts of the language that this version reads but does not run yet: an honest finding for each.

One table, so that delivering a part means taking out its line.
"""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler.sensors import SENSOR_KINDS
from deepbots_cli.compiler.values import Values
from deepbots_cli.lang.names import NOT_YET
from deepbots_cli.schema.part import Part
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.source.nodes import Path

# A key of the parts found at a path (a `*` stands for any name) that is not delivered yet.
LATER: tuple[tuple[tuple[str, ...], str], ...] = ()


def check_support(spec: Scenario, values: Values) -> None:
    """DB108 for everything in the file that is not delivered yet."""
    for path, part in _parts(spec, ()):
        kind = getattr(part, "type", None)
        if _fits(path, ("robots", "*", "sensors", "*")) and kind not in SENSOR_KINDS:
            _report(values, (*path, "type"), f"the sensor kind `{kind}`")
            continue
        for pattern, key in LATER:
            if key in part.model_fields_set and _fits(path, pattern):
                _report(values, (*path, key), f"`{key}`")


def _report(values: Values, path: Path, what: str) -> None:
    values.findings.add("DB108", values.key_span(path), f"{what} is not supported yet", help=NOT_YET)


def _fits(path: Path, pattern: tuple[str, ...]) -> bool:
    return len(path) == len(pattern) and all(p in ("*", step) for p, step in zip(pattern, path, strict=True))


def _parts(value: object, path: Path) -> Iterator[tuple[Path, Part]]:
    """Every part that the user wrote, with its path."""
    if isinstance(value, Part):
        yield path, value
        for name in value.model_fields_set:
            yield from _parts(getattr(value, name, None), (*path, name))
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _parts(item, (*path, key))
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _parts(item, (*path, index))

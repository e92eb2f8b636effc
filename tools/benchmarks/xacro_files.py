"""xacro files of public repositories, expanded here and by the package `xacro` of ROS, as JSON.

    python -m tools.benchmarks.xacro_files FOLDER PYTHON > tools/results/records/xacro.json

FOLDER has a folder for each repository, and PYTHON is an interpreter with the packages `xacro` and `pyyaml`.
Every file whose expansion by ROS has a link is compared: elements, attributes, and numbers to 1e-9. An
argument without a default is `false`, or the value in `ARGUMENTS`. A file `.gazebo` that is not in FOLDER is
one empty macro.
"""

from __future__ import annotations

import datetime
import json
import math
import re
import subprocess
import sys
import tempfile
import types
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ARGUMENTS = {"mav_name": "firefly", "namespace": "r", "robot_model": "lite6", "foot_collision": "default"}
_EMPTY = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="gazebo_config" params="robot_namespace"/></robot>'
_MANIFEST_NAME = re.compile(r"<name>\s*([^<\s]+)")
_MISSING = re.compile(r"Undefined substitution argument (\w+)")


def packages(repository: Path) -> dict[str, str]:
    """Return the folder of each package by its name, and by that of its folder."""
    folders: dict[str, str] = {}
    for manifest in sorted(repository.rglob("package.xml")):
        text = re.sub("<!--.*?-->", "", manifest.read_text(errors="replace"), flags=re.DOTALL)
        for match in filter(None, [_MANIFEST_NAME.search(text)]):
            folders.setdefault(match[1], str(manifest.parent))
        folders.setdefault(manifest.parent.name, str(manifest.parent))
    return folders


def expand_with_ros(repository: Path, empty: Path) -> dict[str, dict[str, Any]]:
    """Return the URDF of each file, its arguments, or the error; runs in the interpreter that has `xacro`."""
    import xacro  # type: ignore[import-not-found]

    index = types.ModuleType("ament_index_python.packages")
    index.get_package_share_directory = packages(repository).__getitem__  # type: ignore[attr-defined]
    sys.modules |= {"ament_index_python": types.ModuleType("ament_index_python"), index.__name__: index}
    parse = xacro.parse

    def parse_or_empty(text: str | None, name: str | None = None) -> Any:
        missing = name is not None and name.endswith(".gazebo") and not Path(name).exists()
        return parse(text, str(empty) if missing else name)

    xacro.parse = parse_or_empty
    results: dict[str, dict[str, Any]] = {}
    for path in sorted(repository.rglob("*.xacro")):
        arguments: dict[str, str] = {}
        result: dict[str, Any] = {}
        while not result:
            try:
                urdf = xacro.process_file(str(path), mappings=dict(arguments)).toxml()
                result = {"arguments": arguments, "urdf": urdf}
            except Exception as error:  # noqa: BLE001  # of any file of anyone
                missing = _MISSING.search(str(error))
                if missing is None or missing[1] in arguments:
                    result = {"error": f"{type(error).__name__}: {error}"}
                else:
                    arguments[missing[1]] = ARGUMENTS.get(missing[1], "false")
        results[str(path.relative_to(repository))] = result
    return results


def numbers(text: str) -> list[float] | None:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return None


def differs(ours: ElementTree.Element, theirs: ElementTree.Element, folders: dict[str, str]) -> bool:
    """Return whether two elements differ in a name, a text, a number, or below; other tools' namespaces
    aside."""
    if ours.tag != theirs.tag or set(ours.attrib) != {key for key in theirs.attrib if "{" not in key}:
        return True
    for key in ours.attrib:
        values = [
            re.sub(r"package://(\w+)", lambda match: folders.get(match[1], match[0]), element.attrib[key])
            for element in (ours, theirs)
        ]
        first, second = map(numbers, values)
        same = values[0].removeprefix("file://") == values[1].removeprefix("file://")
        if first is not None and second is not None and len(first) == len(second):
            same = same or all(map(lambda a, b: math.isclose(a, b, rel_tol=1e-9), first, second))
        if not same:
            return True
    below = [[child for child in element if not child.tag.startswith("{")] for element in (ours, theirs)]
    return len(below[0]) != len(below[1]) or any(differs(a, b, folders) for a, b in zip(*below, strict=True))


def compare(repository: Path, results: dict[str, dict[str, Any]], empty: Path) -> list[dict[str, object]]:
    """Return a row for each file that ROS expands to a robot with links."""
    from deepbots_cli.diagnostics import Findings, Source
    from deepbots_cli.robots.elements import Element, parse
    from deepbots_cli.robots.xacro import expand

    def as_tree(element: Element) -> ElementTree.Element:
        tree = ElementTree.Element(element.tag, element.attributes)
        tree.extend(as_tree(child) for child in element.children if ":" not in child.tag)
        return tree

    folders = packages(repository)
    rows: list[dict[str, object]] = []
    for name, result in results.items():
        path = repository / name

        def resolve(reference: str, folder: Path = path.parent) -> Path:
            scheme, _, rest = reference.partition("://")
            package, _, inside = rest.partition("/")
            located = (
                Path(folders.get(package, "/")) / inside
                if scheme == "package"
                else folder / (rest or reference)
            )
            return empty if located.suffix == ".gazebo" and not located.exists() else located

        if "urdf" not in result or not (theirs := ElementTree.fromstring(result["urdf"])).findall("link"):
            continue
        findings = Findings()
        root = parse(Source(name, path.read_text(errors="replace")), findings)
        expansion = root and expand(root, resolve, result["arguments"], findings)
        ours = as_tree(expansion.root) if expansion else ElementTree.Element("")
        rows.append(
            {
                "repository": repository.name.replace("+", "/"),
                "file": name,
                "arguments": result["arguments"],
                "links": len(theirs.findall("link")),
                "joints": len(theirs.findall("joint")),
                "same": not differs(ours, theirs, folders),
            }
        )
    return rows


def main(folder: Path, python: str) -> None:
    rows, failed = [], 0
    with tempfile.TemporaryDirectory() as temporary:
        empty = Path(temporary, "empty.xacro")
        empty.write_text(_EMPTY)
        for repository in sorted(path for path in folder.iterdir() if next(path.rglob("*.xacro"), None)):
            command = [python, __file__, str(repository), str(empty)]
            output = subprocess.run(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True
            ).stdout
            results = json.loads(output)
            failed += sum("error" in result for result in results.values())
            rows += compare(repository, results, empty)
    facts = {
        "command": "python -m tools.benchmarks.xacro_files FOLDER PYTHON",
        "date": datetime.date.today().isoformat(),
        "robots": len(rows),
        "same": sum(bool(row["same"]) for row in rows),
        "repositories": len({row["repository"] for row in rows}),
        "refused_by_ros": failed,
    }
    head = json.dumps(facts, indent=2).removesuffix("\n}")
    print(f'{head},\n  "rows": [\n    ' + ",\n    ".join(map(json.dumps, rows)) + "\n  ]\n}")


if __name__ == "__main__":
    first, second = sys.argv[1:]
    if second.endswith("empty.xacro"):
        print(json.dumps(expand_with_ros(Path(first).resolve(), Path(second))))
    else:
        main(Path(first), second)

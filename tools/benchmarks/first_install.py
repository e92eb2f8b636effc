"""The first install of each distribution into a new environment, from a clone and from wheels.

    python -m tools.benchmarks.first_install [--json]

Minutes are those of the clock; pip reads its cache and the package index that it is configured for. MB are those
of all files of the environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from tools.benchmarks.report import Row, options, show
from tools.packaging.clean import PROJECTS, Environment, build

CLI, ROBOT, WEBOTS = PROJECTS
INSTALLS = {
    f"{CLI}[train]": (f"{{{CLI}}}[train]",),
    ROBOT: (f"{{{ROBOT}}}",),
    f"{WEBOTS}, with what it needs of {CLI}": (f"{{{WEBOTS}}}", f"{{{CLI}}}[webots]"),
}
"""What is installed together, with a place for the folder or the wheel of a distribution."""


def measure(origin: str, places: Mapping[str, Path]) -> list[Row]:
    rows = []
    for name, parts in INSTALLS.items():
        with TemporaryDirectory() as folder:
            environment = Environment(Path(folder, "environment"))
            start = monotonic()
            environment.install(*(part.format_map(places) for part in parts), fetch=True)
            minutes = (monotonic() - start) / 60
            size = sum(path.stat().st_size for path in environment.folder.rglob("*") if path.is_file())
        rows += [Row(f"{name}, from {origin}", minutes, "minutes"), Row("its environment", size / 1e6, "MB")]
    return rows


def main() -> None:
    arguments = options(__doc__)
    with TemporaryDirectory() as folder:
        wheels = {name: build(sources, Path(folder, name)) for name, sources in PROJECTS.items()}
        rows = [*measure("a clone", PROJECTS), *measure("wheels", wheels)]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()

"""The packages that deepbots requires by extra, and how an extra is installed, by the metadata of the
installation."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

# `importlib.metadata` takes 30 ms, so it is imported only for messages.

_EXTRAS_OF_MODULES = {
    "PIL": "sim",
    "websockets": "view",
    "zmq": "zmq",
}
"""The extras of the modules whose packages have other names."""
_FOLDERS = {"deepbots-robot": "deepbots_robot", "deepbots-webots": "deepbots_webots"}
"""The folders of a clone with the other distributions."""


def requirements() -> dict[str, list[str]]:
    """Return the packages that deepbots requires on this machine, by extra; those that are always required
    have an empty name. Empty if deepbots is not installed."""
    by_extra: dict[str, list[str]] = {}
    for package, extra, requirement in _requirements_of("deepbots-cli"):
        by_extra.setdefault(extra, []).extend([package, *_packages_of_clone(requirement)])
    return by_extra


def _requirements_of(distribution: str) -> Iterator[tuple[str, str, str]]:
    """Yield the package, the extra or "", and the text of each requirement that is for this machine."""
    from importlib.metadata import PackageNotFoundError, requires

    with suppress(PackageNotFoundError):
        for requirement in requires(distribution) or ():
            package = re.match(r"[\w.-]+", requirement)
            extra = re.search(r"extra == .([\w-]+)", requirement)
            if package and _is_for_this_machine(requirement):
                yield package[0], extra[1] if extra else "", requirement


def _packages_of_clone(requirement: str) -> list[str]:
    """Return the packages that a requirement of a distribution of the clone adds, such as
    `deepbots-robot[log,zmq]`; none for other packages."""
    own = re.match(rf"({'|'.join(_FOLDERS)})(?:\[([\w,-]+)\])?", requirement)
    if own is None:
        return []
    return [
        package for package, extra, _ in _requirements_of(own[1]) if extra in ("", *(own[2] or "").split(","))
    ]


def _is_for_this_machine(requirement: str) -> bool:
    """Return whether markers include this Python and system, as in `pybullet>=3.2.6; python_version < '3.12'
    and sys_platform != 'win32'`."""
    if re.search(rf"sys_platform != .{sys.platform}\b", requirement):
        return False
    below = re.search(r"python_version < .(\d+)\.(\d+)", requirement)
    return below is None or sys.version_info[:2] < (int(below[1]), int(below[2]))


def extra_with(module: str) -> str | None:
    """Return the smallest extra that requires the package of a module; None if there is none."""
    if module in _EXTRAS_OF_MODULES:
        return _EXTRAS_OF_MODULES[module]
    packages = requirements()
    fitting = [
        extra
        for extra, names in packages.items()
        if extra and module.lower() in (name.lower().replace("-", "_") for name in names)
    ]
    return min(fitting, key=lambda extra: len(packages[extra]), default=None)


def install_hint(extra: str, origin: str | None = None) -> str:
    """Return the advice to install an extra from `origin`, by default from where deepbots was installed.

    From a clone, its other distributions are installed in the same command if the extra needs them: no
    package index has them.
    """
    origin = origin or str(clone_folder() or "deepbots-cli")
    packages = [f"'{origin}[{extra}]'"]
    if origin != "deepbots-cli":
        # An installation that is older than the extra does not know what it needs.
        needed = {*requirements().get(extra, ()), f"deepbots-{extra}"}
        packages[:0] = [f"'{origin}/{folder}'" for name, folder in _FOLDERS.items() if name in needed]
    return f"install it with: pip install {' '.join(packages)}"


def clone_folder() -> Path | None:
    """Return the clone that deepbots was installed from; None if pip does not know it, or it is gone."""
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        address = urlsplit(
            str(json.loads(distribution("deepbots-cli").read_text("direct_url.json") or "{}").get("url", ""))
        )
    except (PackageNotFoundError, ValueError):
        return None
    folder = Path(url2pathname(address.path))
    return folder if address.scheme == "file" and (folder / "pyproject.toml").is_file() else None

"""Builds what goes to a package index: sdist and wheel of both distributions, checked by twine and tried in
new environments.

python -m tools.packaging.release https://HOST/OWNER/NAME           into `dist`; the argument is the page of the repository
python -m tools.packaging.release https://HOST/OWNER/NAME --fetch   pip installs what the wheels need

A page on an index has no files beside it. Relative links of README.md become links into the repository, at
the tag of the version.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import deepbots_cli
from tools.packaging import clean

_LINK = re.compile(r"(?P<before>\]\(|\bsrc=\"|\bhref=\")(?P<target>[^)\"#:]+)(?P<after>[#)\"])")
"""The relative target of a link in Markdown, or of an image."""
_PICTURES = (".gif", ".jpg", ".png", ".svg")


def with_absolute_links(text: str, repository: str, tag: str) -> str:
    """A page whose relative links lead into the repository at a tag; pictures are their files, all else is a
    page."""

    def absolute(match: re.Match[str]) -> str:
        kind = "raw" if match["target"].endswith(_PICTURES) else "blob"
        return f"{match['before']}{repository}/{kind}/{tag}/{match['target']}{match['after']}"

    return _LINK.sub(absolute, text)


def copy_sources(folder: Path, repository: str) -> None:
    """Copy the files that git knows, with absolute links in README.md."""
    names = subprocess.run(
        ["git", "ls-files", "-z"], cwd=clean.ROOT, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    for name in filter(None, names):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(clean.ROOT / name, target)
    page = folder / "README.md"
    page.write_text(
        with_absolute_links(page.read_text(encoding="utf-8"), repository, f"v{deepbots_cli.__version__}"),
        encoding="utf-8",
    )


def reasons_against(dist: Path) -> list[str]:
    """Why this state cannot be released, in sentences."""
    version = deepbots_cli.__version__
    changes = (clean.ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = next(iter(re.findall(r"^## (\S+)", changes, re.MULTILINE)), "")
    reasons = []
    if first != version:
        reasons.append(
            f"CHANGELOG.md begins with '{first}', and `__version__` of deepbots_cli is {version}: write `##"
            f" {version}`"
        )
    if subprocess.run(
        ["git", "status", "--porcelain"], cwd=clean.ROOT, check=True, capture_output=True, text=True
    ).stdout:
        reasons.append("there are changes that are not committed: commit them, or put them aside")
    if dist.exists() and any(dist.iterdir()):
        reasons.append(f"{dist.name} is not empty: remove it")
    return reasons


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="make release", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("repository", help="the page of the repository, such as https://HOST/OWNER/NAME")
    parser.add_argument(
        "--fetch", action="store_true", help="pip installs what the wheels need, instead of lending it"
    )
    parser.add_argument(
        "--draft", action="store_true", help="build into `dist` although the state is not a release"
    )
    options = parser.parse_args(arguments)
    repository = options.repository.rstrip("/")
    if not re.fullmatch(r"https://[\w.-]+(/[\w.-]+){2,}", repository):
        print(
            "make release needs the page of the repository: make release REPOSITORY=https://HOST/OWNER/NAME",
            file=sys.stderr,
        )
        return 2
    dist = clean.ROOT / "dist"
    reasons = [] if options.draft else reasons_against(dist)
    if reasons:
        print("\n".join(reasons), file=sys.stderr)
        return 1
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        copy_sources(folder / "sources", repository)
        built = folder / "dist"
        wheels = [
            clean.build(folder / "sources" / sources.relative_to(clean.ROOT), built / project)
            for project, sources in clean.PROJECTS.items()
        ]
        files = [*built.glob("*/*.whl"), *built.glob("*/*.tar.gz")]
        subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *map(str, files)], check=True)
        clean.try_wheels(wheels, folder, fetch=options.fetch)
        dist.mkdir(exist_ok=True)
        for file in files:
            shutil.copyfile(file, dist / file.name)
    print("\n".join(f"dist/{file.name}" for file in files))
    return 0


if __name__ == "__main__":
    sys.exit(main())

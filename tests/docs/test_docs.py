"""What README and docs say is true: scenarios lint, Python runs, commands parse, links lead somewhere, tables
and maps are current."""

from __future__ import annotations

import ast
import re
import shlex
import sys
from collections.abc import Iterator
from importlib import util
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.cli.command import Commands
from deepbots_cli.cli.commands import COMMANDS, module_name
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.findings import suppress
from deepbots_cli.document import loads
from deepbots_cli.lint import static_findings as run_rules
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.scenario.isaac_lab import TERMS_FILE
from tests.docs.test_docs_tutorials import TUTORIALS

ROOT = Path(__file__).parents[2]
PACKAGES = sorted(path.parent for path in (ROOT / "deepbots_cli").rglob("__init__.py"))
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]

TOPICS = "(?:cart|supervisor|deepbots)/"  # of ROS 2, in docs/ros.md
FORBIDDEN = re.compile(
    rf"(?<![\w.:/)\]}}*-])/(?!{TOPICS}|dev/null)[a-z]+/[A-Za-z]\w*|index-url|\bTODO\b"
)  # an absolute path is some machine's
BESIDES = {
    "DB314": ("DB306",),
    "DB603": ("DB205",),
    "DB702": ("DB810",),
    "DB703": ("DB708",),
    "DB705": ("DB810",),
    "DB708": ("DB810",),
    "DB710": ("DB205",),
    "DB711": ("DB810",),
    "DB801": ("DB205",),
    "DB802": ("DB205",),
    "DB806": ("DB611",),
    "DB807": ("DB708",),
}
"""The other findings of the example of a rule."""
UPON_CARTPOLE = "deepbots: 1\nextends: cartpole\n"


class Block(NamedTuple):
    """A fenced block: its page, first line, language, what follows the language, and its text."""

    page: str
    line: int
    language: str
    mark: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(language: str) -> list[Block]:
    return [block for page in PAGES for block in _blocks(page) if block.language == language]


def _blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for match in re.finditer(r"^```(\w+)[ ]?([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield Block(
            str(page.relative_to(ROOT)), text[: match.start()].count("\n") + 1, match[1], match[2], match[3]
        )


def findings_of(text: str, base: Path = ROOT / "scenarios") -> list[Finding]:
    checked = check(loads(text, base=base))
    kept, unused = suppress(
        [*checked.findings, *run_rules(checked, preview=True)], checked.document.sources, preview=True
    )
    return [*kept, *unused]


def load_reference() -> ModuleType:
    spec = util.spec_from_file_location("build_reference", ROOT / "docs" / "build_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("block", blocks("yaml"), ids=str)
def test_a_scenario_in_the_docs_is_what_the_text_says(block: Block, tmp_path: Path):
    if "pybullet_data" in block.text:
        pytest.importorskip("pybullet_data")
    mark, _, code = block.mark.partition(" ")
    if mark == "wrong":
        findings = findings_of(UPON_CARTPOLE + block.text)
        assert {finding.code for finding in findings} == {code, *BESIDES.get(code, ())}
    elif mark == "part":  # of a file, which the tests of the tutorials lint
        assert block.page.removeprefix("docs/").removesuffix(".md") in TUTORIALS
    elif mark == "deep":  # simulated by the tests of the pages
        assert block.text.strip() in {page.example for page in pages_of(code) if page.deep}
    elif mark == "fragment":
        for file in _blocks(ROOT / block.page):
            if file.language == "xml" and file.mark:  # a robot file of the same page
                (tmp_path / file.mark).write_text(file.text, encoding="utf-8")
        findings = findings_of(UPON_CARTPOLE + block.text, tmp_path)
        assert [
            f"{finding.code} {finding.headline}" for finding in findings if finding.severity == "error"
        ] == []
    else:
        assert [f"{finding.code} {finding.headline}" for finding in findings_of(block.text)] == []


@pytest.mark.parametrize("block", blocks("python"), ids=str)
def test_python_in_the_docs_runs(block: Block, monkeypatch: pytest.MonkeyPatch):
    code = compile(block.text, str(block), "exec")
    if block.mark.startswith("skip"):
        pytest.skip(block.mark)
    monkeypatch.chdir(ROOT)
    exec(code, {"__name__": "__main__"})


def command_lines() -> list[tuple[str, str]]:
    lines = []
    for block in blocks("console"):
        lines += [
            (str(block), line.removeprefix("$ ")) for line in block.text.splitlines() if line.startswith("$ ")
        ]
    for page in PAGES:
        quoted = re.findall(r"`(deepbots [a-z][^`]*)`", page.read_text(encoding="utf-8"))
        lines += [(page.name, line) for line in quoted if not re.search("COMMAND|VERB|NAME", line)]
    return sorted(set(lines))


@pytest.mark.parametrize(("place", "line"), command_lines(), ids=str)
def test_a_command_in_the_docs_is_one(place: str, line: str):
    words = shlex.split(line)
    if words[0] == "make":
        targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert words[1] in targets
        return
    if words[0] != "deepbots":
        assert words[:2] in (["pip", "install"], ["python3.11", "-m"]) or words[0] in (
            ".",
            "mkdir",
            "cd",
            "optuna-dashboard",
        )
        return
    verb, *arguments = words[1:]
    assert verb in COMMANDS
    options = {
        option
        for parameter in Commands().get_command(None, verb).params
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
    assert {word.partition("=")[0] for word in arguments if word.startswith("-")} <= options


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("https://"):
            continue
        path, _, fragment = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert not fragment or fragment in anchors(there), target


def linked(page: Path) -> set[Path]:
    targets = re.findall(r"\]\(([^)\s#]+)", page.read_text(encoding="utf-8"))
    return {
        (page.parent / target).resolve()
        for target in targets
        if target.endswith(".md") and "://" not in target
    }


def test_every_page_is_reached_from_the_readme():
    reached = set()
    waiting = {ROOT / "README.md"}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        waiting |= linked(page) - reached
    assert sorted(set(PAGES) - reached) == []


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", ["keys.md", "functions.md", "rules.md", "commands.md", "glossary.md"])
def test_the_reference_is_current(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        sys, "path", [folder for folder in sys.path if Path(folder).name != "exact"]
    )  # an engine of the tests
    written = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert written == load_reference().pages()[name], "run: python docs/build_reference.py"


def test_the_terms_of_isaac_lab_are_those_of_its_page():
    assert TERMS_FILE.read_text(encoding="utf-8") == load_reference().isaac_lab_terms(), (
        "run: python docs/build_reference.py"
    )


def test_every_algorithm_of_the_language_can_be_trained_with():
    from deepbots_cli.learning.sb3.algorithms import ALGORITHMS
    from deepbots_cli.scenario.training import ALGORITHMS as DECLARED

    assert set(ALGORITHMS) == set(DECLARED)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "docs" / "build_reference.py"], ids=lambda page: page.name)
def test_a_page_speaks_of_nothing_that_a_reader_cannot_see(page: Path):
    assert FORBIDDEN.findall(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_the_map_of_a_package_names_its_modules_and_no_others(package: Path):
    docstring = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""
    modules = {path.name for path in package.glob("*.py")} - {"__init__.py", "__main__.py"}
    named = (
        {f"{module_name(name)}.py" for name in COMMANDS}
        if package.name == "commands"
        else set(re.findall(r"\b[a-z_]+\.py\b", docstring))
    )
    assert named == modules


def test_the_picture_is_small():
    assert (ROOT / "docs" / "images" / "cartpole.png").stat().st_size < 60_000


def test_the_readme_shows_a_finding_as_lint_prints_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (scenario,) = (block.text for block in blocks("yaml") if block.page == "README.md")
    (example,) = (block.text for block in blocks("text") if block.page == "README.md")
    monkeypatch.chdir(tmp_path)
    Path("pole.yaml").write_text(scenario.replace("> 15 deg", "> 15"), encoding="utf-8")
    assert main(["lint", "pole.yaml"]) == 1
    assert capsys.readouterr().out.startswith(example)


def test_the_page_about_the_pipeline_quotes_the_code():
    page = (ROOT / "docs" / "pipeline.md").read_text(encoding="utf-8")
    files = [
        ROOT / "deepbots_cli" / name for name in re.findall(r"^\| `([\w/]+\.py)` \|", page, re.MULTILINE)
    ]
    assert len(files) == 5
    code = "\n".join(
        [path.read_text(encoding="utf-8") for path in (*files, ROOT / "scenarios" / "cartpole.yaml")]
    )
    code += api.compile("cartpole").code
    lines = [
        line
        for block in blocks("text")
        if block.page == "docs/pipeline.md"
        for line in block.text.splitlines()
    ]
    assert [line for line in lines if line not in ("", "...") and line not in code] == []

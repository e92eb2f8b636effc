"""Commands that deepbots prints as the next step: each can be pasted into a shell.

The templates of messages are read from the source: a command is what stands between backquotes, behind a colon
or on a line of its own. The names in them must be words of a shell, whatever the file is called.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from deepbots_cli.cli.command import Commands, help_text
from deepbots_cli.cli.commands import COMMANDS
from deepbots_cli.cli.commands.new import validated_name
from deepbots_cli.diagnostics import RULES
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.words import shell_word
from tests.commands import Deepbots, refusal

ROOT = Path(__file__).parents[2]
VERB = rf"deepbots (?:{'|'.join(COMMANDS)})\b(?!:)"
PRINTED = re.compile(rf"`({VERB}[^`]*)`|(?:^|: | {{2}})({VERB}[^`;\n]*)")
HOLE = re.compile("\0(.*?)\1")
"""A field of a message, as its Python text."""
STANDING_FOR = {
    r"command": "start 1",
    r"' '.join\(following\)": "hint --step drive",
    r"option": "--from",
    r"settings|longer|_folder_argument.*|allowed": "",
    r"unused_seeds.*|number|.*\.number|episode|first.*|seed|.*\.seed|len\(.*|\d \* study.*": "3",
    r".*": "x",
}
"""What the fields of messages stand for in a command, by a pattern of their Python text."""


def literals(tree: ast.AST) -> Iterator[str]:
    """The texts of a module, each with its fields; no docstrings."""
    inside: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            inside.add(node.value)
        if node in inside:
            continue
        if isinstance(node, ast.JoinedStr):
            inside.update(ast.walk(node))
            yield "".join(
                str(part.value) if isinstance(part, ast.Constant) else f"\0{ast.unparse(part.value)}\1"
                for part in node.values
                if isinstance(part, ast.Constant | ast.FormattedValue)
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def templates() -> Iterator[tuple[str, str, str]]:
    """The commands in messages: the place, the text of its module, and the command with its fields."""
    for package in ("deepbots_cli", "deepbots_robot", "deepbots_webots"):
        for path in sorted((ROOT / package).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if not re.search(VERB, source):
                continue
            for text in literals(ast.parse(source)):
                for match in PRINTED.finditer(text):
                    yield f"{path.relative_to(ROOT)}", source, (match[1] or match[2]).strip()


FILE = re.compile(r"(\w+\.)*(\w*path|folder|file|run|recording|reference|scenario|source|study|log)")
"""The fields of messages that name a file."""


def test_each_command_in_a_message_parses_and_quotes_its_files() -> None:
    wrong, found = [], 0
    for place, source, command in templates():
        line = HOLE.sub(
            lambda field: next(word for form, word in STANDING_FOR.items() if re.fullmatch(form, field[1])),
            command,
        )
        wrong += [
            f"{place}: {field} is not quoted in {line}"
            for field in HOLE.findall(command)
            if FILE.fullmatch(field) and not re.search(rf"\b{re.escape(field)}\b.* = .*shell_word\(", source)
        ]
        wrong.append(refusal(place, line))
        found += 1
    assert "\n".join(filter(None, wrong)) == ""
    assert found > 150


PAGES = {
    **{f"--help of {verb}": help_text(verb) for verb in ("deepbots", *COMMANDS)},
    **{f"explain {code}": page.text() for code in RULES for page in pages_of(code)},
}


def test_each_command_in_a_help_text_or_a_page_of_a_finding_parses() -> None:
    lines = {
        (place, (match[1] or match[2]).partition("  ")[0].partition(" && ")[0])
        for place, text in PAGES.items()
        for match in PRINTED.finditer(text, 1)
    }
    assert "\n".join(filter(None, (refusal(*line) for line in sorted(lines)))) == ""
    assert len(lines) > 100


@given(name=st.text(st.characters(exclude_categories=("Cc", "Cs")), min_size=1, max_size=12))
@example("my läufe/it's")
@example("--fix")
@example("-")
@example("$HOME/`a`*.yaml")
def test_a_file_of_any_name_is_one_argument_of_a_printed_command(name: str) -> None:
    command = Commands().get_command(None, "fmt")
    with command.make_context("fmt", shlex.split(f"{shell_word(name)} --check")) as context:
        (path,) = context.params["paths"]
    assert Path(path) == Path(name)


FAULTY = "deepbots: 1\nextends: cartpole\nworld: {timestop: 30 ms}\n"
CHEAP = {"lint", "inspect", "explain", "scenarios", "replay", "compile"}
"""The commands that are run here when they are printed."""


@pytest.mark.parametrize("name", ["mein lauf", 'it\'s "2"', "-a", "$HOME*é"])
def test_the_commands_that_are_printed_about_a_file_run(
    deepbots: Deepbots, tmp_path: Path, name: str
) -> None:
    (tmp_path / f"{name}.yaml").write_text(FAULTY, encoding="utf-8")
    (tmp_path / f"{name}.urdf").write_text("<robot name='a'><link name='b'/></robot>")
    (tmp_path / f"{name}.mcap").touch()
    printed: set[str] = set()
    for words in (
        ("compile", f"./{name}.yaml"),
        ("inspect", f"./{name}.yaml"),
        ("train", f"./{name}.yaml"),
        ("eval", f"./{name}.yaml"),
        ("try", f"./{name}.urdf"),
        ("new", "mine", f"./{name}", "--from", "cartpole"),
        ("render", f"./{name}.mcap", "-o", "b.mcap"),
    ):
        ran = deepbots(*words, code=None)
        printed.update(match[1] or match[2] for match in PRINTED.finditer(ran.out + ran.err))
    assert len(printed) > 6
    for command in printed:
        assert refusal("printed", command) == ""
        verb, *words = shlex.split(command)[1:]
        assert verb != "new" or validated_name(words[0])
        if verb in CHEAP:
            assert deepbots(verb, *words, code=None).code < 2, command


def test_a_command_that_shows_findings_again_reads_the_same_scenario(
    deepbots: Deepbots, tmp_path: Path
) -> None:
    deepbots("new", "cart", "project", "--from", "cartpole", "--json")
    (tmp_path / "project" / "robots").rename(tmp_path / "my robots")
    path = tmp_path / "project" / "cart.yaml"
    text = path.read_text(encoding="utf-8").replace("robots/urdf", "../my robots/urdf")
    path.write_text(text, encoding="utf-8")
    options = ("--allow-path", "my robots", "--set", "signals.spare=abs(1 m)")
    (command,) = PRINTED.findall(deepbots("compile", "project/cart.yaml", *options).err)
    assert "spare" in deepbots(*shlex.split(command[1])[1:]).out
    path.write_text(text.replace("timestep:", "timestop:"), encoding="utf-8")
    ran = deepbots("compile", "project/cart.yaml", *options[:2], "--set", "world.tiemstep=on", code=1)
    assert "1 can be fixed by" in ran.err
    (command,) = PRINTED.findall(ran.err)
    assert "1 fixed in 1 file" in deepbots(*shlex.split(command[1])[1:], code=None).err

"""The layout of generated code: short lines that mean what the long ones meant, as a formatter would write
them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.codegen.text import WIDTH, docstring, wrap_line

ROOT = Path(__file__).parents[2]
SCENARIOS = ["cartpole", *map(str, sorted((ROOT / "tests/data/scenarios").glob("*.yaml")))]
LONG = [
    "first_quantity",
    "another(1.0, 2.0)",
    "self.memory_third",
    "table[0][1]",
    '"a (text, with = signs + ] "',
] * 5

LINES = {
    "call": f"self.read = engine.thing({', '.join(LONG)})",
    "call of calls": f"self.read = engine.thing(hypot({', '.join(LONG)}), {LONG[0]})",
    "sum": f"self.reward = reward = {' + '.join(LONG)}",
    "increment": f"memory += ({' + '.join(LONG)} - memory) * (0.01 / (0.5 + 0.01))",
    "sum of products": f"total = {' + '.join(f'{item} * {item}' for item in LONG)}",
    "choice": f"value = {' + '.join(LONG)} if {' and '.join(LONG)} else 0.0",
    "condition": f"if {' or '.join(LONG)}:",
    "tuple": f"one, two = {' and '.join(LONG[:10])}, {LONG[0]}",
    "targets": f"stamp, {', '.join(f'a_long_name_{number}' for number in range(20))} = self.decode(message)",
    "addition": f"value += ({' + '.join(LONG)}) * ({LONG[0]} / {LONG[1]})",
    "return": f"return {{{', '.join(f'{number}: {item}' for number, item in enumerate(LONG))}}}",
    "one item": f"self.drive(({' * '.join(LONG)},))",
    "product": f"x = ({' + '.join(LONG)}) * ({' - '.join(LONG)})",
    "definition": f"def apply(self, {', '.join(f'a_long_name_{number}: Any' for number in range(20))}) ->"
    " None:",
    "comment": f"table = {{{', '.join(f'{number}: 1.0' for number in range(30))}}}  # {', '.join(LONG)}",
}


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_long_line_is_broken_and_means_the_same(line: str) -> None:
    lines = wrap_line(f"        {line}")
    body = "\n            pass" if line.endswith(":") else ""
    whole, broken = (
        ast.dump(ast.parse("if True:\n" + text + body)) for text in (f"        {line}", "\n".join(lines))
    )
    assert broken == whole
    assert [text for text in lines if len(text) > WIDTH and not text.lstrip().startswith("#")] == []


@pytest.mark.parametrize(
    "text",
    ["", "plain", 'say "hello" \\ and go', '"', '"""', "\\", "many words " * 30, "new\nline\x00", "車 é 🚗"],
)
def test_a_docstring_says_what_the_text_says(text: str) -> None:
    said = ast.literal_eval("\n".join(docstring(text)))
    assert said.split() == text.split()


@pytest.mark.parametrize("format", ["struct", "none"])
@pytest.mark.parametrize("source", SCENARIOS, ids=lambda source: Path(source).stem)
def test_generated_code_is_formatted(tmp_path: Path, source: str, format: str) -> None:
    file = tmp_path / "environment.py"
    overrides = (
        ["messages={format: none}"] if format == "none" else [f"messages.format={format}"]
    )  # without messages, nothing is late
    file.write_text(api.compile(source, overrides=overrides).code)
    command = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "--diff",
        "--config",
        str(ROOT / "pyproject.toml"),
        "--line-length",
        str(WIDTH),
        str(file),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
    assert max(map(len, file.read_text().splitlines())) <= WIDTH

"""How soon `deepbots lsp` answers, and what it imports.

    python -m tools.benchmarks.lsp_cost [--json] [--requests 100]

The server runs as an editor runs it, over standard input and output. Each of completion, hover, definition,
code actions and formatting is asked for at so many places of a scenario, drawn with seed 0, a
quarter of them right behind a change of the text, whose analysis may go on beside. The time of an answer is
the CPU time of the thread that answers, once everything has been asked for before; that of findings is the
CPU time of the whole process, its analysis included. Memory is what the server held at most when all this was
done, which is some hundred changes of the text.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

from tests.lsp.client import ROOT, Client, position
from tools.benchmarks.lint_cost import HEAVY
from tools.benchmarks.report import Row, options, show

SCENARIOS = ("pit_escape", "find_ball_random")
METHODS = ("completion", "hover", "definition", "codeAction", "formatting")
BAR = 50.0
MOST_MEMORY = 300.0


def cpu_milliseconds(process: int, threads: str = "*") -> float:
    """What threads of a process have used, as the scheduler counts it; the one that answers has the number of
    the process."""
    counts = Path(f"/proc/{process}/task").glob(f"{threads}/schedstat")
    return sum(int(count.read_text().split()[0]) for count in counts) / 1e6


def ask(client: Client, method: str, uri: str, place: dict[str, int]) -> None:
    params: dict[str, Any] = {
        "textDocument": {"uri": uri},
        "position": place,
        "range": {"start": place, "end": place},
    }
    params |= {"context": {"diagnostics": []}} if method == "codeAction" else {}
    params |= {"options": {"tabSize": 2, "insertSpaces": True}} if method == "formatting" else {}
    client.request(f"textDocument/{method}", params)


def answers(client: Client, uri: str, count: int) -> Iterator[float]:
    """CPU milliseconds of each answer."""
    drawn, text = random.Random(0), client.texts[uri]
    for method in METHODS:
        for number in range(count):
            if number % 4 == 0:
                client.findings(uri)  # what came before is done with
                client.change(uri, text + " " * (number % 8))
            place = position(text, drawn.randrange(len(text)))
            server = client.process.pid
            before = cpu_milliseconds(server, str(server))
            ask(client, method, uri, place)
            yield cpu_milliseconds(server, str(server)) - before


def analysis(client: Client, uri: str, count: int) -> Iterator[float]:
    """CPU milliseconds from a change of the text to the findings."""
    text = client.texts[uri]
    for number in range(count):
        client.findings(uri)
        time.sleep(0.1)
        before = cpu_milliseconds(client.process.pid)
        client.change(uri, text + "\n" * (number % 2))
        client.findings(uri)
        yield cpu_milliseconds(client.process.pid) - before


def most_memory(process: int) -> float:
    """Megabytes that a process held at most."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6


def heavy_imports(process: int) -> int:
    """How many of the heavy packages the process has mapped, or has a file open of."""
    maps = Path(f"/proc/{process}/maps").read_text()
    return sum(f"/{name}" in maps for name in HEAVY)


def rows(count: int) -> Iterator[Row]:
    with Client(ROOT) as client:
        for name in SCENARIOS:
            uri = client.open(ROOT / "scenarios" / f"{name}.yaml")
            list(answers(client, uri, 8))
            taken = list(answers(client, uri, count))
            yield Row(f"an answer in {name}.yaml, median of {len(taken)}", median(taken), "ms", BAR)
            yield Row(f"an answer in {name}.yaml, worst of {len(taken)}", max(taken), "ms", BAR)
            yield Row(
                f"from a change of {name}.yaml to its findings", median(analysis(client, uri, 11)), "ms"
            )
        yield Row("memory that it held at most", most_memory(client.process.pid), "MB", MOST_MEMORY)
        yield Row(f"of {', '.join(HEAVY)} it imports", heavy_imports(client.process.pid), "", 0)


def main() -> None:
    arguments = options(__doc__, requests=100)
    show(rows(arguments.requests), as_json=arguments.json)


if __name__ == "__main__":
    main()

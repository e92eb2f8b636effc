"""What is not lint, upon damaged files: `fmt`, `diff`, and sessions of the language server."""

from __future__ import annotations

import contextlib
import io
import random
from pathlib import Path
from typing import Any

from deepbots_cli.cli import main as command_line
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import files
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from tests.fuzz.mutations import CORPUS, PIECES, READS, Case, case, damaged
from tests.fuzz.workbench import FailedError, Workbench, check_rules
from tests.lsp.client import Client, edited

STEPS = 40
ASKED = ("hover", "completion", "definition", "codeAction", "formatting")


def _meaning(text: str) -> tuple[object, bool]:
    findings = Findings()
    source, readable = files.decode(text.encode(), "fuzz", findings)
    root = parse(Source(source.name, source.text), findings) if readable else None
    return (to_data(root), True) if root is not None and not findings.errors else (None, False)


def check_verbs(damaged: Case) -> int:
    """The exit code of `diff` of a file with itself, which has no difference; `fmt` and `schema` end as they
    should as well.

    Raises:
        FailedError: A verb says otherwise, or ends in a fault.
    """
    name = str(damaged.main)
    for words, allowed in (
        (("fmt", "--diff", name), (0, 1)),
        (("lsp", "--schema", "--for", name), (0, 1, 2)),
        (("diff", name, name), (0, 2)),
    ):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = command_line(list(words))
        if code not in allowed or "Traceback" in err.getvalue():
            raise FailedError(
                f"{' '.join(words)} ends with {code}: {out.getvalue()[-300:]} {err.getvalue()[-300:]}"
            )
    return code


def session(client: Client, folder: Path, chance: random.Random) -> int:
    """Edit documents at random, ask about places at random, some of them nowhere, and see that all answers
    fit; how many there were.

    Raises:
        FailedError: An answer does not fit the text, or the server has said that it failed.
    """
    uris = [client.open(folder / name) for name in chance.sample(sorted(READS), 2)]
    answers = 0
    for _ in range(STEPS):
        uri = chance.choice(uris)
        if chance.random() < 0.5:
            client.change(uri, _edit(client.texts[uri], chance))
        elif chance.random() < 0.1:
            client.close(uri)
            uris[uris.index(uri)] = client.open(folder / uri.rpartition("/")[2])
        else:
            answers += _ask(client, uri, chance)
    for uri in uris:
        findings = client.findings(uri)
        _check_places(client.texts[uri], findings)
        check_rules([finding["message"] for finding in findings if finding.get("code") == "DB903"])
        client.close(uri)
    if client.logged:
        raise FailedError(f"the language server says: {client.logged}")
    return answers


def _edit(text: str, chance: random.Random) -> str:
    if chance.random() < 0.1:
        return CORPUS[chance.choice(sorted(READS))].decode()
    if chance.random() < 0.5:
        at = chance.randint(0, len(text))
        return text[:at] + chance.choice(PIECES).decode() + text[at + chance.choice((0, 0, 1, 30)) :]
    return damaged(text.encode("utf-8", "surrogatepass"), chance).decode("utf-8", "replace")[:100_000]


def _place(text: str, chance: random.Random) -> dict[str, int]:
    """A line and a column, beyond the end now and then."""
    lines = text.split("\n")
    line = chance.choice(
        (0, chance.randrange(len(lines)), chance.randrange(len(lines)), len(lines) + 3, 2**31 - 1)
    )
    longest = len(lines[line]) if line < len(lines) else 5
    return {
        "line": line,
        "character": chance.choice(
            (0, chance.randint(0, longest), chance.randint(0, longest), longest + 7, 2**31 - 1)
        ),
    }


def _ask(client: Client, uri: str, chance: random.Random) -> bool:
    text = client.texts[uri]
    method = chance.choice(ASKED)
    params: dict[str, Any] = {"textDocument": {"uri": uri}}
    if method in ("hover", "completion", "definition"):
        params["position"] = _place(text, chance)
    elif method == "codeAction":
        params |= {
            "range": {"start": _place(text, chance), "end": _place(text, chance)},
            "context": {"diagnostics": []},
        }
    elif method == "formatting":
        params["options"] = {"tabSize": chance.choice((2, 4, 0)), "insertSpaces": True}
    answer = client.request(f"textDocument/{method}", params)
    if method == "formatting" and answer and "\r" not in text:
        formatted = edited(text, answer)
        if _meaning(formatted) != _meaning(text):
            raise FailedError(f"formatting changes what the document says: {text!r} -> {formatted!r}")
    return answer is not None


def _check_places(text: str, places: list[dict[str, Any]]) -> None:
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for place in places:
        start, end = place["range"]["start"], place["range"]["end"]
        if (start["line"], start["character"]) > (end["line"], end["character"]) or end["line"] >= len(lines):
            raise FailedError(f"{place} lies outside of its text of {len(lines)} lines")
        if end["character"] > len(lines[end["line"]].encode("utf-16-le", "surrogatepass")) // 2:
            raise FailedError(f"{place} lies behind the end of its line")


def check(bench: Workbench, number: int) -> None:
    """Everything that must hold of the file of a number but what lint says of it."""
    mutated = case(number)
    with bench.laid_out(mutated):
        check_verbs(mutated)


def check_session(folder: Path, number: int) -> None:
    """Hold the session of a number with the language server, which leaves in order."""
    with Client(folder) as client:
        session(client, folder / "tests" / "fuzz" / "seeds", random.Random(number))
    if (client.code, client.errors) != (0, ""):
        raise FailedError(f"the language server leaves with {client.code}: {client.errors}")

"""Figures as files, and as parts of a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.files import atomic_write, check_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_figure_files(folder: Path, figures: Iterable[tuple[str, Figure]]) -> list[Path]:
    """Write figures by their names as PNG.

    Raises:
        UsageError: A file cannot be written, or the folder is a file.
    """
    check_folder(folder)
    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures:
        paths.append(folder / f"{name}.png")
        with atomic_write(paths[-1]) as draft:
            figure.savefig(draft, dpi=150)
    return paths


def svg_uri(figure: Any) -> str:
    """Return a figure as SVG in a data URI."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "deepbots"}):  # the same names of clip paths each time
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return data_uri("image/svg+xml", stream.getvalue())


def data_uri(kind: str, data: bytes) -> str:
    """Return data as a URI that contains it; `kind` is its media type."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"

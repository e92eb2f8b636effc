"""Files that tests make."""

from pathlib import Path


def written(path: Path, content: str | bytes) -> Path:
    """Write a file, and return its path."""
    path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return path

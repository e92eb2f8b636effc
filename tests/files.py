"""Files that tests make."""

from pathlib import Path


def written(path: Path, content: str | bytes) -> Path:
    """Write a file with the folders above it, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return path

"""Files that a page offers."""

from pathlib import Path


def data_lines(path: Path) -> list[str]:
    """Lines of a CSV file below its header of comments."""
    return [line for line in path.read_text().splitlines() if not line.startswith("# ")]

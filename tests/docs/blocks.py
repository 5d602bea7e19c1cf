"""Fenced code blocks of the manual."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^(?P<fence>```+)(?P<info>[^\n`]*)\n(?P<text>.*?)^(?P=fence)[ ]*$", re.MULTILINE | re.DOTALL)
COMMANDS = frozenset({"", "sh", "bash", "shell", "console", "python", "ts"})
"""Languages of blocks that contain commands or programs; "" is a block without a language."""
COMMAND_LINE = re.compile(
    r"(?:\$ |[A-Z_]+=\S+ )*(?:curl|docker|git|make|node|npm|npx|pip|python3?|ricochet|uv)(?= (?![\w-]+:))"
)
"""Matches a line with a command, but not a line of output such as `ricochet cra: must be ...`."""


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Parameters
    ----------
    line
        Line of the page on which its content begins.
    info
        Words after the fence: the language, `run`, and `server` if the block queries a service.
    """

    page: Path
    line: int
    info: tuple[str, ...]
    text: str

    @property
    def language(self) -> str:
        return self.info[0] if self.info else ""

    @property
    def runs(self) -> bool:
        return "run" in self.info[1:]

    @property
    def uses_service(self) -> bool:
        return "server" in self.info[1:]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        if found["info"].startswith("{"):  # This is a MyST directive, not code.
            continue
        yield Block(page, text.count("\n", 0, found.start()) + 2, tuple(found["info"].split()), found["text"])

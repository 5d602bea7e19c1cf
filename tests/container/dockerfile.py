"""Parser of the Dockerfile, for the instructions that it uses."""

import json
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
KNOWN = {
    *("FROM", "ARG", "ENV", "WORKDIR", "RUN", "COPY", "USER"),
    *("VOLUME", "EXPOSE", "HEALTHCHECK", "LABEL", "ENTRYPOINT", "CMD"),
}


@dataclass(frozen=True)
class Step:
    """An instruction and its arguments, joined into one line."""

    instruction: str
    text: str

    def assignments(self) -> dict[str, str]:
        """Return the names and values that an ENV, a LABEL or an ARG with a default sets."""
        return dict(word.split("=", 1) for word in shlex.split(self.text))

    def command(self) -> list[str]:
        """Return program and arguments of a CMD or ENTRYPOINT, or of the CMD of a HEALTHCHECK."""
        words: list[str] = json.loads(self.text.partition("CMD ")[2] if "CMD " in self.text else self.text)
        return words

    def paths(self) -> tuple[str, list[str], str]:
        """Return stage, sources and destination of a COPY; the stage is "" for the build context."""
        *words, destination = self.text.split()
        stage = words.pop(0).removeprefix("--from=") if words[0].startswith("--from=") else ""
        return stage, words, destination


@dataclass
class Stage:
    """Steps from one FROM to the next."""

    image: str
    name: str
    steps: list[Step] = field(default_factory=list)

    @property
    def tag(self) -> str:
        """Name and tag of the base image, without the digest."""
        return self.image.partition("@")[0]

    def last(self, instruction: str) -> Step:
        """Return the last step with this instruction, which is the one that takes effect."""
        return [step for step in self.steps if step.instruction == instruction][-1]

    def environment(self) -> dict[str, str]:
        """Return all environment variables, as written in the file."""
        found: dict[str, str] = {}
        for step in self.steps:
            if step.instruction == "ENV":
                found |= step.assignments()
        return found


def read(path: Path = ROOT / "Dockerfile") -> list[Stage]:
    """Return the stages of the Dockerfile; the last one is the image."""
    text = re.sub(r"(?m)^\s*#.*\n", "", path.read_text(encoding="utf-8"))
    stages: list[Stage] = []
    for line in filter(None, re.sub(r"\\\n\s*", "", text).splitlines()):
        instruction, _, rest = line.partition(" ")
        assert instruction in KNOWN, f"the tests do not know {instruction}"
        if instruction == "FROM":
            image, _, name = rest.partition(" AS ")
            stages.append(Stage(image, name))
        else:
            stages[-1].steps.append(Step(instruction, rest))
    return stages

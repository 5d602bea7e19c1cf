"""`make sbom`: the packages in each image, in CycloneDX format."""

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PINNED = re.compile(r"^([\w.-]+)==(\S+)", re.MULTILINE)


def made(image: str) -> dict[str, Any]:
    """Run `make sbom` for an image; return the bill of materials."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        ["make", "--old-file=setup", "sbom", f"IMAGES={image}"],  # noqa: S607
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    bill: dict[str, Any] = json.loads((ROOT / "build" / f"sbom-{image}.cdx.json").read_text())
    return bill


@pytest.mark.parametrize(
    "image", [pytest.param("run", marks=pytest.mark.system), pytest.param("cluster", marks=pytest.mark.system), "full"]
)
def test_bill_names_every_locked_package_with_its_hashes(image: str) -> None:
    lock, bill = (ROOT / "requirements" / f"{image}.txt").read_text(), made(image)
    assert (bill["bomFormat"], bill["metadata"]["component"]["name"]) == ("CycloneDX", "concrete-ricochet")
    listed = {(part["name"], part["version"]) for part in bill["components"]}
    assert listed == set(PINNED.findall(lock))
    hashes = {
        found["content"]
        for part in bill["components"]
        for reference in part["externalReferences"]
        for found in reference.get("hashes", [])
    }
    assert hashes == set(re.findall(r"--hash=sha256:([0-9a-f]{64})", lock))


def test_locks_pin_every_package_with_hashes_and_name_no_index() -> None:
    for path in (ROOT / "requirements").glob("*.txt"):
        text = path.read_text()
        packages = re.split(r"\n(?=\S)", re.sub(r"(?m)^#.*\n", "", text).strip())
        assert len(packages) >= 5
        assert all(PINNED.match(package) and "--hash=sha256:" in package for package in packages), path
        assert "://" not in text

"""Build the generated clients into `dist`: a Python wheel and an npm package, with the version of the contract.

    python clients/build.py [--output dist] [--only python|typescript]

Building the npm package needs Node.js 20 and an npm registry. Without npm only the wheel is built.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
CONTRACT = HERE.parent / "openapi" / "openapi.json"


def run(command: list[str], folder: Path, **environment: str) -> None:
    """Run a command in a folder; if it fails, exit with its output."""
    scripts = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # The generator calls ruff.
    variables = os.environ | {"PATH": scripts} | environment
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} ended in {done.returncode}\n{done.stdout}{done.stderr}")


def build_wheel(folder: Path, output: Path, version: str) -> None:
    """Generate the Python package and put its wheel into `output`."""
    shutil.copytree(HERE / "python", folder)
    generate = ["openapi-python-client", "generate", "--path", str(CONTRACT), "--output-path", "ricochet_client"]
    run([*generate, "--meta", "none", "--fail-on-warning", "--config", "config.yml"], folder)
    wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]
    run([*wheel, "--no-build-isolation", "--wheel-dir", str(output), "."], folder, RICOCHET_CLIENT_VERSION=version)


def build_package(folder: Path, output: Path, version: str) -> None:
    """Generate the types, compile the npm package and pack it into `output`."""
    shutil.copytree(HERE / "typescript", folder)
    shutil.copy(CONTRACT, folder / "contract.json")
    described = json.loads((folder / "package.json").read_text(encoding="utf-8"))
    (folder / "package.json").write_text(json.dumps(described | {"version": version}), encoding="utf-8")
    npm = str(shutil.which("npm"))
    run([npm, "ci", "--ignore-scripts", "--prefer-offline"], folder)
    run([npm, "run", "build"], folder)
    run([npm, "pack", "--pack-destination", str(output)], folder)


def main() -> None:
    """Build the requested clients; the npm package is left out if npm is not installed."""
    parser = argparse.ArgumentParser(description="Build the clients from the contract.")
    parser.add_argument("--output", type=Path, default=Path("dist"))
    parser.add_argument("--only", choices=["python", "typescript"])
    options = parser.parse_args()
    output = options.output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    version = (
        json.loads(CONTRACT.read_text(encoding="utf-8"))["info"]["version"] + ".0.0"
    )  # npm requires three numbers.
    with tempfile.TemporaryDirectory() as folder:
        if options.only != "typescript":
            build_wheel(Path(folder) / "python", output, version)
        if options.only != "python" and shutil.which("npm"):
            build_package(Path(folder) / "typescript", output, version)
        elif options.only != "python":
            print("there is no npm here: no package for TypeScript")
    for built in sorted(output.glob("ricochet[-_]client*")):
        print(built)


if __name__ == "__main__":
    main()

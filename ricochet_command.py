"""Entry point of the `ricochet` command.

The packages of ricochet are called `service` and `solver`, names that other projects use too. Before `main` imports
them, it checks that Python would find those of ricochet.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

PACKAGES = {"service": "cli/outputs.py", "solver": "plausibility.py"}
"""A file in each package that identifies it as that of ricochet."""


def main() -> int:
    """Run the command, unless Python would import something else in place of a package; return the exit status."""
    for name, known in PACKAGES.items():
        spec = find_spec(name)
        places = list(spec.submodule_search_locations or ()) if spec else []
        if not any((Path(place) / known).is_file() for place in places):
            found = next(iter(places), spec.origin if spec else None) or "nothing"
            text = f"{found} is found as the Python package {name}, in place of that of ricochet"
            print(f"ricochet: {text}: rename it, or take its folder out of PYTHONPATH", file=sys.stderr)
            return 1
    from service.cli import main as run

    return run()

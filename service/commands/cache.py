"""`ricochet cache`: look after the results of the data folder."""

import argparse
import sys

from service.results import storage
from service.settings import Settings


def add_commands(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add what can be done to the results, each with its help."""
    actions.add_parser("stat", help="tell how much is stored, also while the service runs")
    actions.add_parser("verify", help="read everything, and set aside what is damaged")
    actions.add_parser("rebuild", help="make the index anew from the stored results")
    evict = actions.add_parser("evict", help="remove the results used longest ago")
    evict.add_argument("--bytes", type=int, help="what may stay; RICOCHET_CACHE_BYTES unless said otherwise")


def look_after(settings: Settings, asked: argparse.Namespace) -> int:
    """Do what is asked to the results; return 1 if it cannot be done or something was damaged."""
    folder, damaged = settings.data_dir, list[str]()
    try:
        if asked.action == "stat":
            found = storage.stat(folder)
        elif asked.action == "verify":
            verified = storage.verify(folder)
            found, damaged = verified.statistics, verified.damaged
        elif asked.action == "rebuild":
            found = storage.rebuild(folder)
        else:
            found = storage.evict(folder, settings.cache_bytes if asked.bytes is None else max(0, asked.bytes))
    except storage.UnusableFolderError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{found.cases} results, {found.segments} files, {found.bytes} bytes")
    for name in damaged:
        print(f"damaged, set aside: {name}")
    return 1 if damaged else 0

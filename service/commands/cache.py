"""`ricochet cache`: look after the results of the data folder."""

import argparse
import sys

from service.commands.environment import read_settings
from service.commands.parsers import add_actions, examples

ACTIONS = (
    ("stat", "tell how much is stored, also while the service runs", "ricochet cache stat"),
    ("verify", "read everything, and set aside what is damaged", "ricochet cache verify"),
    ("rebuild", "make the index anew from the stored results", "ricochet cache rebuild"),
    ("evict", "remove the results used longest ago", "ricochet cache evict --bytes 1000000000"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what can be done to the results, each with its help."""
    parser.description = "Look after the results of the data folder, RICOCHET_DATA_DIR."
    parser.epilog = examples("ricochet cache stat")
    actions = add_actions(parser, "action", ACTIONS)
    actions["evict"].add_argument("--bytes", type=int, help="what may stay; RICOCHET_CACHE_BYTES unless said otherwise")


def run(asked: argparse.Namespace) -> int:
    """Do what is asked to the results; return 1 if it cannot be done or something was damaged."""
    from service.cache import maintenance as storage

    settings = read_settings()
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

"""`ricochet keys`: who may ask the service, and for how much."""

import argparse
import sys
from datetime import UTC, datetime

from service.access.key import SCOPES, Key, make_key
from service.access.keyring import KeysUnreadableError, add_key, read_keys, revoke_key
from service.commands.environment import read_settings
from service.commands.errors import FAILED, CommandError
from service.commands.parsers import examples

LONGEST_OWNER = 100
MOST_CASES = 1_000_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what can be done to the keys, each with its help."""
    parser.epilog = examples("ricochet keys add --owner alice --scope run --scope read --cases-per-hour 100000")
    actions = parser.add_subparsers(dest="action", required=True)
    add = actions.add_parser("add", help="make a key and print its token, this once")
    add.add_argument("--owner", required=True, type=owner, help="whose jobs are made with it; keys may share one")
    add.add_argument(
        "--scope",
        action="append",
        choices=SCOPES,
        help="what it is good for, may be given again; read and run unless said otherwise",
    )
    add.add_argument("--cases-per-hour", type=count, help="most cases it may ask for within an hour; any number if not")
    add.add_argument("--expires", type=days, metavar="DAYS", help="how long it is good; until it is revoked if not")
    actions.add_parser("list", help="list the keys, without their tokens")
    revoke = actions.add_parser("revoke", help="make a key good for nothing, at once, also in a running service")
    revoke.add_argument("id", help="of the key, as `list` tells it")


def run(asked: argparse.Namespace) -> int:
    """Do what is asked to the keys.

    Raises
    ------
    CommandError
        If it cannot be done.
    """
    folder = read_settings().data_dir
    try:
        if asked.action == "add":
            scopes = frozenset(asked.scope or ("read", "run"))
            key, token = make_key(asked.owner, scopes, cases_per_hour=asked.cases_per_hour, days=asked.expires)
            add_key(folder, key)
            print(f"key {key.id} of {key.owner}; its token is shown this once:", file=sys.stderr)
            print(token)
        elif asked.action == "list":
            for key in read_keys(folder).values():
                print(told(key))
        elif revoke_key(folder, asked.id) is None:
            raise CommandError(f"there is no key {asked.id}", FAILED)
    except (KeysUnreadableError, OSError) as error:
        raise CommandError(str(error), FAILED) from None
    return 0


def told(key: Key) -> str:
    """Return a line about a key."""
    limit = "any number of cases" if key.cases_per_hour is None else f"{key.cases_per_hour:,} cases an hour"
    if key.revoked is not None:
        state = f"revoked {day(key.revoked)}"
    elif key.usable:
        state = "good" if key.expires is None else f"good until {day(key.expires)}"
    else:
        state = f"expired {day(key.expires or 0.0)}"
    return f"{key.id}  {key.owner}  {','.join(sorted(key.scopes))}  {limit}  made {day(key.created)}  {state}"


def day(seconds: float) -> str:
    """Return a day, in UTC."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def owner(text: str) -> str:
    """Return the name of an owner."""
    if not (0 < len(text) <= LONGEST_OWNER and text.isprintable() and text == text.strip()):
        raise argparse.ArgumentTypeError(f"1 to {LONGEST_OWNER} printable characters, got {text!r}")
    return text


def count(text: str) -> int:
    """Return a number of cases."""
    if not (text.isascii() and text.isdigit() and 0 < int(text) <= MOST_CASES):
        raise argparse.ArgumentTypeError(f"a whole number from 1 to {MOST_CASES:,}, got {text}")
    return int(text)


def days(text: str) -> float:
    """Return a time in days."""
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.0 < found <= 36_500.0:
        raise argparse.ArgumentTypeError(f"a number of days above 0, at most 36,500, got {text}")
    return found

"""`ricochet keys` and `ricochet cache`: manage API keys and results in the data folder of a service."""

import argparse
import sys
import time
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from service.auth.api_keys import SCOPES
from service.cli.arguments import DATA_DIR, FAILED, CommandError, add_actions, examples, read_settings, reason_of
from service.cli.outputs import sentence_number

if TYPE_CHECKING:
    from service.auth.api_keys import ApiKey
    from service.settings import Settings

KEY_ACTIONS = (
    (
        "add",
        "make a key and print its token, which is not shown again",
        "ricochet keys add --owner alice --scope run --scope read --cases-per-hour 100000",
    ),
    ("list", "list the keys, without their tokens", "ricochet keys list"),
    ("revoke", "make a key invalid at once, also in a running service", "ricochet keys revoke ID"),
)
CACHE_ACTIONS = (
    ("stat", "print the size of the cache, also while the service runs", "ricochet cache stat"),
    ("verify", "read all results, and set damaged files aside", "ricochet cache verify"),
    ("rebuild", "rebuild the index from the stored results", "ricochet cache rebuild"),
    ("evict", "remove the least recently used results", "ricochet cache evict --bytes 1000000000"),
)
MAX_OWNER_LENGTH = 100
"""Longest name of an owner [characters]. An arbitrary choice: the name appears in each line of the audit log."""
MAX_CASES = 1_000_000_000
"""Largest accepted quota [cases per hour]. It only catches typing errors, since no service computes as many."""
MAX_DAYS = 36_500.0
"""Longest accepted lifetime of a key [days]. A century, which only catches typing errors."""


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Add the flag `--data-dir`, which selects the data folder of a service."""
    parser.add_argument("--data-dir", metavar="FOLDER", help=f"the data folder (default: {DATA_DIR})")


def settings_for(args: argparse.Namespace) -> "Settings":
    """Read the settings; `--data-dir` overrides the data folder."""
    return read_settings(**({} if args.data_dir is None else {"data_dir": args.data_dir}))


def add_keys(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet keys`."""
    parser.description = "Add, list and revoke the API keys in the data folder, RICOCHET_DATA_DIR."
    parser.epilog = examples("ricochet keys add --owner alice --cases-per-hour 100000")
    actions = add_actions(parser, KEY_ACTIONS)
    for action in actions.values():
        add_folder(action)
    add = actions["add"]
    add.add_argument(
        "--owner", required=True, type=_owner, metavar="NAME", help="owner of the jobs; several keys may have one owner"
    )
    add.add_argument(
        "--scope", action="append", choices=SCOPES, help="what the key permits, repeatable (default: read and run)"
    )
    add.add_argument(
        "--cases-per-hour",
        type=_cases,
        metavar="NUMBER",
        help="largest number of cases in any hour (default: unlimited)",
    )
    add.add_argument("--expires", type=_days, metavar="DAYS", help="lifetime of the key (default: until revoked)")
    actions["revoke"].add_argument("id", metavar="ID", help="id of the key, from `ricochet keys list`")
    parser.set_defaults(run=run_keys)


def run_keys(args: argparse.Namespace) -> int:
    """Run an action on the keys.

    Raises
    ------
    CommandError
        If the keys cannot be read or written, or there is no such key.
    """
    from service.auth.api_keys import KeysUnreadableError, add_key, make_key, read_keys, revoke_key

    folder = settings_for(args).data_dir
    try:
        if args.action == "add":
            scopes = frozenset(args.scope or ("read", "run"))
            key, token = make_key(args.owner, scopes, cases_per_hour=args.cases_per_hour, days=args.expires)
            add_key(folder, key)
            print(f"key {key.id} of {key.owner}; its token is not shown again:", file=sys.stderr)
            print(token)
        elif args.action == "list":
            for key in read_keys(folder).values():
                print(_line(key))
        elif revoke_key(folder, args.id) is None:
            raise CommandError(f"there is no key {args.id}", FAILED)
    except (KeysUnreadableError, OSError) as error:
        raise CommandError(reason_of(error), FAILED) from None
    return 0


def _line(key: "ApiKey") -> str:
    limit = "no limit" if key.cases_per_hour is None else f"{sentence_number(key.cases_per_hour)} cases an hour"
    if key.revoked is not None:
        state = f"revoked {_date(key.revoked)}"
    elif key.usable_at(time.time()):
        state = "valid" if key.expires is None else f"valid until {_date(key.expires)}"
    else:
        state = f"expired {_date(key.expires or 0.0)}"
    return f"{key.id}  {key.owner}  {','.join(sorted(key.scopes))}  {limit}  made {_date(key.created)}  {state}"


def _date(timestamp: float) -> str:
    """Return the date of a timestamp, in UTC."""
    return datetime.fromtimestamp(timestamp, UTC).strftime("%Y-%m-%d")


def _owner(text: str) -> str:
    if not (0 < len(text) <= MAX_OWNER_LENGTH and text.isprintable() and text == text.strip()):
        raise argparse.ArgumentTypeError(f"must be 1 to {MAX_OWNER_LENGTH} printable characters, got {text!r}")
    return text


def _cases(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 0 < int(text) <= MAX_CASES):
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to {MAX_CASES:,}, got {text!r}")
    return int(text)


def _days(text: str) -> float:
    try:
        days = float(text)
    except ValueError:
        days = 0.0
    if not 0.0 < days <= MAX_DAYS:
        raise argparse.ArgumentTypeError(f"must be a number of days above 0, at most {MAX_DAYS:,.0f}, got {text!r}")
    return days


def add_cache(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet cache`."""
    parser.description = "Inspect and repair the results in the data folder, RICOCHET_DATA_DIR."
    parser.epilog = examples("ricochet cache stat")
    actions = add_actions(parser, CACHE_ACTIONS)
    for action in actions.values():
        add_folder(action)
    evict = actions["evict"]
    evict.add_argument(
        "--bytes", type=int, metavar="N", help="size to reduce the results to (default: RICOCHET_CACHE_BYTES)"
    )
    parser.set_defaults(run=run_cache)


def run_cache(args: argparse.Namespace) -> int:
    """Run an action on the stored results; return 1 if files are damaged.

    Raises
    ------
    CommandError
        If the folder cannot be used, for example because a service runs on it.
    """
    from service.cache import maintenance
    from service.errors import UnusableFolderError

    settings = settings_for(args)
    folder, damaged = settings.data_dir, list[str]()
    try:
        if args.action == "stat":
            found = maintenance.stat(folder)
        elif args.action == "verify":
            verified = maintenance.verify(folder)
            found, damaged = verified.statistics, verified.damaged
        elif args.action == "rebuild":
            found = maintenance.rebuild(folder)
        else:
            found = maintenance.evict(folder, settings.cache_bytes if args.bytes is None else max(0, args.bytes))
    except UnusableFolderError as error:
        raise CommandError(str(error), FAILED) from None
    print(f"{found.cases} results, {found.segments} files, {found.bytes} bytes")
    for name in damaged:
        print(f"damaged, set aside: {name}")
    return FAILED if damaged else 0

"""`python -m dynident_service.new_key NAME`: make an API key and print it once.

Holds how long a key may be valid (100 years).
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from dataclasses import asdict
from datetime import datetime

from dynident.errors import DynidentError
from dynident_service.api_keys import SCOPES, create_key, list_keys, revoke_keys
from dynident_service.settings import load_settings
from dynident_service.storage.data_directory import prepare_data_directory, restrict_file_permissions
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.quotas import QuotaLimits

MOST_DAYS = 36500
"""A century; the calendar of computers ends with the year 9999."""
MOST = 2**63 - 1
"""What a column of the database holds."""


def main(arguments: list[str]) -> int:
    """Make a key under the name given, or list or revoke keys."""
    purpose = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m dynident_service.new_key", description=purpose)
    parser.add_argument("name", nargs="?", help="what the key is for")
    parser.add_argument("--scope", choices=SCOPES, default="admin", help="read; send and change; also delete (default)")
    parser.add_argument("--owner", help="who is responsible for it")
    parser.add_argument("--days", type=_parse_days, help="after how many days it expires; never by default")
    parser.add_argument("--quota-bytes", type=_parse_number, help="how many bytes of files it may store; 0: no limit")
    parser.add_argument("--quota-recordings", type=_parse_number, help="how many recordings it may store; 0: no limit")
    parser.add_argument(
        "--quota-jobs", type=_parse_number, help="how many jobs it may have at the same time; 0: no limit"
    )
    parser.add_argument("--list", action="store_true", help="list the keys, without their secrets")
    parser.add_argument("--revoke", action="store_true", help="delete the keys with this name")
    options = parser.parse_args(arguments)
    if not options.list and options.name is None:
        parser.error("give the key a name")
    try:
        return _run(options)
    except DynidentError as error:
        print(f"{parser.prog}: {error.detail}", file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    settings = load_settings()
    with restrict_file_permissions():
        prepare_data_directory(settings.data_dir)
        with closing(Database(settings.database)) as database:
            migrate(database)
            return _manage_keys(database, options)


def _manage_keys(database: Database, options: argparse.Namespace) -> int:
    if options.list:
        for holder in list_keys(database):
            used = f"used {_format_day(holder.last_used_at)}, ends {_format_day(holder.expires_at)}"
            print(
                f"{holder.name}: {holder.scope}, owner {holder.owner or 'not given'}, "
                f"{used}{_describe_limits(holder.limits)}"
            )
    elif options.revoke:
        if revoke_keys(database, options.name) == 0:
            print(f"there is no key {options.name!r}", file=sys.stderr)
            return 1
    else:
        limits = QuotaLimits(options.quota_bytes, options.quota_recordings, options.quota_jobs)
        print(create_key(database, options.name, options.scope, options.owner, options.days, limits))
    return 0


def _parse_days(text: str) -> float:
    try:
        days = float(text)
    except ValueError:
        days = 0.0
    if not 0 < days <= MOST_DAYS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days above 0 and up to {MOST_DAYS}")
    return days


def _parse_number(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {MOST}")
    return int(text)


def _describe_limits(limits: QuotaLimits) -> str:
    quotas = [f"{most} {kind}" for kind, most in asdict(limits).items() if most is not None]
    return f", at most {', '.join(quotas)}" if quotas else ""


def _format_day(moment: datetime | None) -> str:
    return "never" if moment is None else moment.date().isoformat()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

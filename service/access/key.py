"""An API key: what is known of it, and the token its owner holds.

    ricochet_5f0c21d9_pV3v1k...       prefix, id, secret

The id is public: it stands in lists and in the audit log. Of the token only a hash is kept. A fast one is enough: slow
hashes make it costly to try out passwords that people choose, of which there are few, but nobody tries out the 2^256
secrets made here. It is also what lets thousands of requests a second be checked.
"""

import hashlib
import hmac
import re
import secrets
import time
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

Scope: TypeAlias = Literal["read", "run", "admin"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
"""`read`: results, one's own jobs, metrics; `run`: make and end work; `admin`: both, and the jobs of all owners."""

PREFIX = "ricochet_"
"""Of a token: tools that look for secrets in repositories and logs can find it."""
ID_BYTES, SECRET_BYTES = 4, 32
TOKEN = re.compile(PREFIX + r"([0-9a-f]{8})_[A-Za-z0-9_-]{43}")
NOBODY = "0" * 64
"""Compared with if there is no such key, so that this takes as long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """What is known of a key.

    Parameters
    ----------
    digest
        SHA-256 of the token, hexadecimal.
    cases_per_hour
        Cases that may be asked for within an hour; None if there is no limit.
    created, expires, revoked
        Seconds since 1970; None if it never was or will be. [s]
    """

    id: str
    owner: str
    scopes: frozenset[Scope]
    digest: str = field(repr=False)
    cases_per_hour: int | None = None
    created: float
    expires: float | None = None
    revoked: float | None = None

    @property
    def usable(self) -> bool:
        """Whether it opens anything now."""
        return self.revoked is None and (self.expires is None or time.time() < self.expires)

    def may(self, scope: Scope) -> bool:
        """Tell whether the key is good for this."""
        return scope in self.scopes or "admin" in self.scopes

    def fits(self, token: str) -> bool:
        """Tell whether this is its token."""
        return hmac.compare_digest(self.digest, digest_of(token))


def make_key(
    owner: str, scopes: frozenset[Scope], *, cases_per_hour: int | None = None, days: float | None = None
) -> tuple[Key, str]:
    """Return a new key and its token, which is kept nowhere."""
    name, now = secrets.token_hex(ID_BYTES), time.time()
    token = f"{PREFIX}{name}_{secrets.token_urlsafe(SECRET_BYTES)}"
    expires = None if days is None else now + 86_400.0 * days
    key = Key(
        id=name,
        owner=owner,
        scopes=scopes,
        digest=digest_of(token),
        cases_per_hour=cases_per_hour,
        created=now,
        expires=expires,
    )
    return key, token


def digest_of(token: str) -> str:
    """Return what is kept of a token."""
    return hashlib.sha256(token.encode()).hexdigest()


def id_in(token: str) -> str | None:
    """Return the id that a token names, None if it is no token."""
    found = TOKEN.fullmatch(token)
    return found[1] if found else None

"""Users of the console: people with their roles, their sessions, and the tokens of their programs.

Passphrases are kept as argon2id hashes; of sessions and tokens, which are 256 random bits, a SHA-256 is
enough. The database holds nothing that could be used to log in.
"""

from __future__ import annotations

import os
import secrets
import sqlite3
import time
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import sqlalchemy
from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    create_engine,
    delete,
    insert,
    select,
    update,
)
from sqlalchemy.exc import DatabaseError, IntegrityError, OperationalError

from rodeo.access.errors import (
    AccountExists,
    AccountsDamaged,
    LoginRefused,
    NotLoggedIn,
    UnknownAccount,
    WeakPassphrase,
)
from rodeo.access.roles import Role
from rodeo.errors import DiskFull, InvalidRequest
from rodeo.host.files import writing
from rodeo.site.config import Site
from rodeo.site.sections import ConsoleConfig


def workers(site: Site) -> list[str]:
    """As whom a person may work here: participants whose key is on the site, and who are no machine."""
    others = [participant.name for participant in site.participants if participant.address is None]
    return ["organization", *others]


def require_participant(site: Site, roles: Iterable[Role], participant: str | None) -> None:
    """Raises InvalidRequest where nobody could work with such an account."""
    known = workers(site)
    if participant is None:
        if Role.EXECUTOR in roles:
            sentence = f"an executor works as a participant of this site: choose one of {', '.join(known)}"
            raise InvalidRequest(sentence, fields={"participant": f"choose one of {', '.join(known)}"})
    elif participant not in known:
        sentence = f"nobody can work as {participant} here: this site has the keys of {', '.join(known)}"
        raise InvalidRequest(sentence, fields={"participant": f"choose one of {', '.join(known)}"})


MIN_PASSPHRASE = 12
MAX_PASSPHRASE = 256
"""Characters; longer ones would only keep the hash function busy."""

TOKEN_PREFIX = "rodeo_"
"""Makes a leaked token recognisable to those who search for such."""

LINK_S = 3600.0
"""Wall time for which a link that logs somebody in is valid, unless it is used before."""

_TOUCH_S = 30.0
"""The last use of a session is written down this often."""


def accounts_path(site: Site) -> Path:
    return site.data_dir / "console" / "accounts.sqlite"


@dataclass(frozen=True)
class User:
    name: str
    roles: frozenset[Role]
    participant: str | None
    """The wallet that an executor works with."""
    disabled: bool = False

    def has(self, *roles: Role) -> bool:
        return not self.roles.isdisjoint(roles)


@dataclass(frozen=True)
class Session:
    """A person at a browser. `key` is the hash of what is in the cookie."""

    key: str
    user: User
    ends_s: float
    """Wall time at which it ends when nothing happens."""


_metadata = MetaData()

_users = Table(
    "users",
    _metadata,
    Column("name", String(64), primary_key=True),
    Column("passphrase", String(256), nullable=False, doc="argon2id"),
    Column("roles", JSON, nullable=False),
    Column("participant", String(64)),
    Column("disabled", Boolean, nullable=False),
    Column("created_s", Float, nullable=False),
)

_sessions = Table(
    "sessions",
    _metadata,
    Column("key", String(64), primary_key=True),
    Column("user", String(64), nullable=False),
    Column("created_s", Float, nullable=False),
    Column("used_s", Float, nullable=False),
)

_tokens = Table(
    "tokens",
    _metadata,
    Column("id", Integer, primary_key=True),
    Column("key", String(64), nullable=False, unique=True),
    Column("user", String(64), nullable=False),
    Column("label", String(64), nullable=False),
    Column("created_s", Float, nullable=False),
    Column("used_s", Float),
)

_links = Table(
    "links",
    _metadata,
    Column("key", String(64), primary_key=True),
    Column("user", String(64), nullable=False),
    Column("ends_s", Float, nullable=False),
)

_marks = Table(
    "marks",
    _metadata,
    Column("user", String(64), primary_key=True),
    Column("chain", String(128), nullable=False),
    Column("seq", Integer, nullable=False),
    Column("heard_s", Float, nullable=False),
)


@dataclass(frozen=True)
class Mark:
    """How far somebody has read: events of a chain by their sequence, and what processes reported by the
    wall's time."""

    chain: str = ""
    seq: int = 0
    heard_s: float = 0.0


class Accounts:
    """The database at `path`. Thread-safe; other processes (the command line) may write to it too.

    Raises AccountsDamaged, and DiskFull where a new one has no room.
    """

    def __init__(self, path: Path, config: ConsoleConfig) -> None:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
        self._engine = create_engine(f"sqlite:///{path}")
        self._config = config
        self._hasher = PasswordHasher()
        # Also hashed without such an account, so that the time taken does not reveal whether it exists.
        self._nobody = self._hasher.hash(secrets.token_urlsafe())
        try:
            with self._engine.begin() as connection:
                found = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
                if found != "ok":
                    raise _damaged(path, str(found))
                _metadata.create_all(connection)
            for table in _metadata.sorted_tables:
                self._rows(select(table).limit(1))
        except OperationalError as error:
            if getattr(error.orig, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                raise DiskFull(f"no space left to write {path}") from error
            raise _damaged(path, str(error.orig)) from error
        except DatabaseError as error:
            raise _damaged(path, str(error.orig)) from error

    def close(self) -> None:
        self._engine.dispose()

    # -- people ----------------------------------------------------------------------------------------

    def add_user(
        self, name: str, passphrase: str, roles: Iterable[Role], participant: str | None = None
    ) -> User:
        """Raises AccountExists, WeakPassphrase."""
        user = User(name, frozenset(roles), participant)
        row = {
            "name": name,
            "passphrase": self._hash(passphrase),
            "roles": sorted(user.roles),
            "participant": participant,
            "disabled": False,
            "created_s": time.time(),
        }
        try:
            with self._engine.begin() as connection:
                connection.execute(insert(_users).values(row))
        except IntegrityError as error:
            raise AccountExists("an account of this name already exists", name=name) from error
        return user

    def user(self, name: str) -> User:
        """Raises UnknownAccount."""
        for row in self._rows(select(_users).where(_users.c.name == name)):
            return _user(row)
        raise UnknownAccount("there is no account of this name", name=name)

    def users(self) -> list[User]:
        return [_user(row) for row in self._rows(select(_users).order_by(_users.c.name))]

    def change_user(
        self, name: str, roles: Iterable[Role], participant: str | None, disabled: bool = False
    ) -> User:
        """Takes effect at once, in sessions that are open too. Raises UnknownAccount."""
        self.user(name)
        values = {"roles": sorted(roles), "participant": participant, "disabled": disabled}
        with self._engine.begin() as connection:
            connection.execute(update(_users).where(_users.c.name == name).values(values))
            if disabled:
                connection.execute(delete(_sessions).where(_sessions.c.user == name))
                connection.execute(delete(_tokens).where(_tokens.c.user == name))
                connection.execute(delete(_links).where(_links.c.user == name))
        return self.user(name)

    def set_passphrase(self, name: str, passphrase: str) -> None:
        """Ends the account's sessions and links. Raises UnknownAccount, WeakPassphrase."""
        self.user(name)
        hashed = self._hash(passphrase)
        with self._engine.begin() as connection:
            connection.execute(update(_users).where(_users.c.name == name).values(passphrase=hashed))
            connection.execute(delete(_sessions).where(_sessions.c.user == name))
            connection.execute(delete(_links).where(_links.c.user == name))

    def _hash(self, passphrase: str) -> str:
        if not MIN_PASSPHRASE <= len(passphrase) <= MAX_PASSPHRASE:
            raise WeakPassphrase(
                f"a passphrase has {MIN_PASSPHRASE} to {MAX_PASSPHRASE} characters",
                characters=len(passphrase),
            )
        return self._hasher.hash(passphrase)

    def is_passphrase(self, name: str, passphrase: str) -> bool:
        """Whether this opens the account, which must not be disabled. Takes about 50 ms on purpose."""
        rows = self._rows(select(_users).where(_users.c.name == name))
        hashed = rows[0]["passphrase"] if rows else self._nobody
        try:
            self._hasher.verify(hashed, passphrase[: MAX_PASSPHRASE + 1])
        except (VerificationError, InvalidHashError):
            return False
        return bool(rows) and not rows[0]["disabled"]

    def mark(self, name: str) -> Mark:
        """How far this person has read."""
        rows = self._rows(select(_marks).where(_marks.c.user == name))
        return Mark(rows[0]["chain"], rows[0]["seq"], rows[0]["heard_s"]) if rows else Mark()

    def set_mark(self, name: str, mark: Mark) -> None:
        with self._engine.begin() as connection:
            connection.execute(delete(_marks).where(_marks.c.user == name))
            connection.execute(insert(_marks).values(user=name, **vars(mark)))

    # -- sessions --------------------------------------------------------------------------------------

    def log_in(self, name: str, passphrase: str) -> str:
        """Open a session and return the cookie's content. Raises LoginRefused."""
        if not self.is_passphrase(name, passphrase):
            raise LoginRefused("the name or the passphrase is wrong")
        return self._open_session(name)

    def _open_session(self, name: str) -> str:
        token, now_s = secrets.token_urlsafe(32), time.time()
        with self._engine.begin() as connection:
            connection.execute(
                delete(_sessions).where(_sessions.c.created_s < now_s - self._config.session_max_s)
            )
            connection.execute(
                insert(_sessions).values(key=_key(token), user=name, created_s=now_s, used_s=now_s)
            )
        return token

    def make_link(self, name: str, valid_s: float = LINK_S) -> str:
        """A token that logs this person in once, for `valid_s` of wall time. Raises UnknownAccount."""
        self.user(name)
        token, now_s = secrets.token_urlsafe(24), time.time()
        with self._engine.begin() as connection:
            connection.execute(delete(_links).where(_links.c.ends_s <= now_s))
            connection.execute(insert(_links).values(key=_key(token), user=name, ends_s=now_s + valid_s))
        return token

    def log_in_by_link(self, token: str) -> str:
        """As `log_in`, with what `make_link` has made, which is void then. Raises LoginRefused."""
        with self._engine.begin() as connection:
            # Deleted and read in one statement: of two who bring it at once one gets in.
            used = delete(_links).where(_links.c.key == _key(token)).returning(_links.c.user, _links.c.ends_s)
            found = connection.execute(used).mappings().first()
        if found is None or found["ends_s"] <= time.time():
            raise LoginRefused("this link was used before, or is too old")
        try:
            disabled = self.user(found["user"]).disabled
        except UnknownAccount:
            disabled = True
        if disabled:
            raise LoginRefused("the account of this link is disabled")
        return self._open_session(found["user"])

    def session(self, token: str | None, touch: bool = False) -> Session:
        """The session of this cookie; with `touch` it counts as used now. Raises NotLoggedIn."""
        return self.session_of(_key(token or ""), touch)

    def session_of(self, key: str, touch: bool = False) -> Session:
        rows = self._rows(
            select(_sessions, _users.c.name, _users.c.roles, _users.c.participant, _users.c.disabled)
            .join(_users, _users.c.name == _sessions.c.user)
            .where(_sessions.c.key == key)
        )
        now_s = time.time()
        for row in rows:
            last_s = row["created_s"] + self._config.session_max_s
            ends_s = min(row["used_s"] + self._config.session_idle_s, last_s)
            if row["disabled"] or ends_s <= now_s:
                self._end(key)
                break
            if touch and now_s - row["used_s"] > min(_TOUCH_S, self._config.session_idle_s / 4):
                with self._engine.begin() as connection:
                    connection.execute(update(_sessions).where(_sessions.c.key == key).values(used_s=now_s))
                ends_s = min(now_s + self._config.session_idle_s, last_s)
            return Session(key, _user(row), ends_s)
        raise NotLoggedIn("log in first; there is no valid session")

    def log_out(self, token: str | None) -> None:
        self._end(_key(token or ""))

    def _end(self, key: str) -> None:
        with self._engine.begin() as connection:
            connection.execute(delete(_sessions).where(_sessions.c.key == key))

    # -- tokens ----------------------------------------------------------------------------------------

    def issue_token(self, name: str, label: str) -> str:
        """A token that may do what this person may; shown once. Raises UnknownAccount."""
        self.user(name)
        token = TOKEN_PREFIX + secrets.token_urlsafe(32)
        with self._engine.begin() as connection:
            connection.execute(
                insert(_tokens).values(key=_key(token), user=name, label=label, created_s=time.time())
            )
        return token

    def tokens(self, name: str) -> list[dict[str, Any]]:
        """`id`, `label`, `created_s` and `used_s` of each."""
        rows = self._rows(select(_tokens).where(_tokens.c.user == name).order_by(_tokens.c.id))
        return [{key: row[key] for key in ("id", "label", "created_s", "used_s")} for row in rows]

    def revoke_token(self, name: str, token_id: int) -> None:
        """Raises UnknownAccount."""
        with self._engine.begin() as connection:
            done = connection.execute(delete(_tokens).where(_tokens.c.user == name, _tokens.c.id == token_id))
        if not done.rowcount:
            raise UnknownAccount("there is no such token", token_id=token_id)

    def token_user(self, token: str) -> User:
        """The user of this token. Raises NotLoggedIn."""
        key, now_s = _key(token), time.time()
        for row in self._rows(
            select(_tokens, _users.c.name, _users.c.roles, _users.c.participant, _users.c.disabled)
            .join(_users, _users.c.name == _tokens.c.user)
            .where(_tokens.c.key == key, ~_users.c.disabled)
        ):
            if now_s - (row["used_s"] or 0.0) > _TOUCH_S:
                with self._engine.begin() as connection:
                    connection.execute(update(_tokens).where(_tokens.c.key == key).values(used_s=now_s))
            return _user(row)
        raise NotLoggedIn("the token is unknown or was revoked")

    def _rows(self, query: sqlalchemy.Select[Any]) -> list[dict[str, Any]]:
        with self._engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]


def _damaged(path: Path, found: str) -> AccountsDamaged:
    return AccountsDamaged(
        "the console's accounts are damaged: restore the file; or move it away, and make the "
        "accounts anew with `rodeo console create-admin NAME`",
        path=str(path),
        found=found,
    )


def _user(row: dict[str, Any]) -> User:
    return User(row["name"], frozenset(map(Role, row["roles"])), row["participant"], row["disabled"])


def _key(token: str) -> str:
    return sha256(token.encode()).hexdigest()

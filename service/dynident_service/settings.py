"""All settings of the service (`DYNIDENT_…`) with their defaults."""

from __future__ import annotations

import hashlib
import ipaddress
import os
from pathlib import Path
from typing import Literal

from pydantic import ByteSize, Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict, SettingsError

from dynident.errors import DynidentError
from dynident_service.environment_secrets import is_secret

MEGABYTE = 1_000_000


class LogSettings(BaseSettings):
    """What is written into the log, and how; read by every process of the service."""

    model_config = SettingsConfigDict(env_prefix="DYNIDENT_", extra="ignore")

    log_level: str = "info"
    traces: bool = Field(
        default=False, description="Send spans of requests and jobs, as the OTEL_… variables configure."
    )
    log_format: Literal["text", "json"] = Field(default="text", description="One JSON object per line, for programs.")


class Settings(LogSettings):
    """Where the service listens, where it keeps its data, and where jobs run."""

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    data_dir: Path = Path("dynident-data")
    database_url: str = Field(default="", description="Default: an SQLite file in the data directory.")
    object_store_url: str = Field(default="", description="Default: a folder in the data directory; or s3://bucket.")
    dask_scheduler: str = Field(default="", description="tcp://host:port of a running cluster; default: a local one.")
    workers: int = Field(
        default_factory=lambda: max(1, os.cpu_count() or 1), ge=1, description="Jobs at the same time."
    )
    request_workers: int = Field(
        default=4,
        ge=1,
        description="Computations at the same time that requests wait for; if there are several, one reads no files.",
    )
    max_upload_bytes: int = Field(default=4_000 * MEGABYTE, ge=1, description="Largest recording.")
    max_body_bytes: int = Field(default=32 * MEGABYTE, ge=1, description="Largest body of any other request.")
    request_threads: int = Field(
        default=8, ge=1, description="Requests at the same time that read or write the database."
    )
    max_connections: int = Field(default=500, ge=1, description="Connections at the same time.")
    max_requests: int = Field(
        default=100, ge=1, description="Requests at the same time, except those that follow a job."
    )
    max_followers: int = Field(default=200, ge=1, description="Requests at the same time that follow a job.")
    max_batch: int = Field(default=1000, ge=1, description="Identifications in one request at most.")
    header_timeout_seconds: float = Field(default=20.0, gt=0, description="Longest time until a request begins.")
    body_timeout_seconds: float = Field(default=30.0, gt=0, description="Longest pause within the body of a request.")
    answer_timeout_seconds: float = Field(
        default=30.0, gt=0, description="Longest time in which a client reads nothing of an answer."
    )
    slowest_upload_bytes_per_second: float = Field(
        default=10_000.0, gt=0, description="Lowest rate at which a body must arrive."
    )
    reserved_bytes: int = Field(default=100 * MEGABYTE, ge=0, description="Disk space that uploads leave free.")
    quota_bytes: int = Field(
        default=0, ge=0, description="Bytes of recordings and meshes that a key may store; 0: no limit."
    )
    quota_recordings: int = Field(
        default=0, ge=0, description="Number of recordings that a key may store; 0: no limit."
    )
    quota_jobs: int = Field(
        default=0, ge=0, description="Jobs of a key, queued or running at the same time; 0: no limit."
    )
    api_keys: list[SecretStr] = Field(
        default=[], description="Keys accepted besides those in the database; only their hashes are kept here."
    )
    require_keys: bool = Field(default=False, description="Require a key on the loopback interface, too.")
    public_url: str = Field(
        default="",
        pattern=r"^(https?://[^\s/?#@]+(/[^\s?#]*)?)?$",
        description="Address for users, https://…: links in reports use it. Default: where the service listens.",
    )
    allowed_origins: list[str] = Field(default=[], description="Web pages of other origins that may call the service.")
    max_attempts: int = Field(default=3, ge=1, description="Number of attempts at a job whose worker keeps dying.")
    job_deadline_seconds: float = Field(default=12 * 3600.0, gt=0, description="Longest time of one attempt at a job.")
    job_memory: ByteSize = Field(
        default=ByteSize(4_000 * MEGABYTE), ge=200 * MEGABYTE, description="Largest memory of one job, such as 4GB."
    )
    drain_seconds: float = Field(default=10.0, ge=0, description="How long jobs may continue when the service ends.")
    history_kept_days: float = Field(default=30.0, gt=0, description="How long events and retry keys are kept.")
    deleted_kept_seconds: float = Field(default=3600.0, ge=60, description="How long deleted files are kept.")

    @field_validator("api_keys")
    @classmethod
    def _keep_hashes(cls, keys: list[SecretStr]) -> list[SecretStr]:
        return [SecretStr(hash_key(key.get_secret_value())) for key in keys]

    @field_validator("database_url")
    @classmethod
    def _name_the_driver(cls, url: str) -> str:
        # Without a driver in the URL SQLAlchemy takes psycopg2; installed is its successor.
        for short in ("postgresql://", "postgres://"):
            if url.startswith(short):
                return "postgresql+psycopg://" + url.removeprefix(short)
        return url

    @property
    def database(self) -> str:
        """URL of the database, with its default resolved."""
        return self.database_url or f"sqlite:///{self.data_dir.resolve() / 'dynident.sqlite3'}"

    @property
    def objects(self) -> str:
        """URL of the object store, with its default resolved."""
        return self.object_store_url or (self.data_dir.resolve() / "objects").as_uri()

    @property
    def cache_dir(self) -> Path:
        """Where copies of remote objects are kept."""
        return self.data_dir.resolve() / "cache"

    @property
    def uploads_dir(self) -> Path:
        """Where uploads are while they are checked."""
        return self.data_dir.resolve() / "uploads"

    @property
    def processes_dir(self) -> Path:
        """Where child processes have their temporary files."""
        return self.data_dir.resolve() / "processes"

    @property
    def is_loopback(self) -> bool:
        """Whether only programs on this machine reach the service."""
        return is_loopback(self.host)

    @property
    def needs_keys(self) -> bool:
        """Whether requests must carry an API key."""
        return self.require_keys or not self.is_loopback


def load_settings(**given: object) -> Settings:
    """Read the settings of the environment; `given` replaces some of them.

    An unusable setting is refused by its name.
    """
    try:
        return Settings(**given)  # type: ignore[arg-type]
    except (ValidationError, SettingsError) as error:
        if isinstance(error, SettingsError):
            raise DynidentError(f"{error}; lists are JSON", title="Unusable setting") from error
        first = error.errors()[0]
        # The first error is enough: the user mends one variable at a time.
        name = f"DYNIDENT_{first['loc'][0]}".upper()
        # What is printed may get into a log: a secret is not repeated.
        value = "" if is_secret(name) else f" (it is {first['input']!r})"
        raise DynidentError(f"{first['msg']}{value}", pointer=name, title="Unusable setting") from error


def hash_key(key: str) -> str:
    """Return the SHA-256 of an API key. A fast hash is enough for a random key, which no dictionary contains."""
    return hashlib.sha256(key.encode()).hexdigest()


def is_loopback(host: str) -> bool:
    """Return whether a host name or address means this machine only."""
    if host == "localhost":
        return True
    try:
        # IPv6 addresses stand in brackets in URLs.
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        # Any other name may lead to another machine, today or tomorrow.
        return False

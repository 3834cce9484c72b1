"""The metrics at `/metrics`: requests, jobs, queue, storage."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from anyio import CapacityLimiter
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from dynident_service.storage.job_queue import QueueHealth

__all__ = ["CONTENT_TYPE_LATEST", "Metrics"]


class Metrics:
    """Metrics of requests, which are counted here, and of jobs, which are read from the queue on demand."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self.thread = CapacityLimiter(1)
        """A single thread renders the metrics, so that scrapes that hang with the database occupy no further ones."""
        self._requests = Counter(
            "dynident_requests", "Requests answered.", ("method", "route", "status"), registry=self._registry
        )
        self._seconds = Histogram(
            "dynident_request_seconds", "Time to answer.", ("method", "route"), registry=self._registry
        )

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request."""
        # The route is a template: labels of single resources would make a time series of each.
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)

    def watch_jobs(self, counts: Callable[[], dict[str, int]], strain: Callable[[], QueueHealth], folder: Path) -> None:
        """Add the jobs by state, the age of the queue, deaths by cause, and the free disk space of a folder."""
        self._registry.register(_JobsCollector(counts, strain))
        self._registry.register(_DiskCollector(folder))

    def render_text(self) -> bytes:
        """Render all metrics in Prometheus' text format."""
        return generate_latest(self._registry)


class _JobsCollector(Collector):
    def __init__(self, counts: Callable[[], dict[str, int]], strain: Callable[[], QueueHealth]) -> None:
        self._counts = counts
        self._strain = strain

    def collect(self) -> Iterable[Metric]:
        family = GaugeMetricFamily("dynident_jobs", "Jobs in the queue.", labels=("state",))
        for state, number in self._counts().items():
            family.add_metric((state,), number)
        yield family
        strain = self._strain()
        age = "Waiting time of the oldest queued job."
        yield GaugeMetricFamily("dynident_oldest_queued_job_seconds", age, strain.oldest_queued)
        deaths = "Number of restarts of jobs whose computation died or whose worker was lost."
        again = GaugeMetricFamily("dynident_job_deaths", deaths, labels=("cause",))
        again.add_metric(("computation",), strain.deaths)
        again.add_metric(("infrastructure",), strain.losses)
        yield again


class _DiskCollector(Collector):
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def collect(self) -> Iterable[Metric]:
        free = shutil.disk_usage(self._folder).free
        yield GaugeMetricFamily("dynident_free_disk_bytes", "Free space on the disk of the data directory.", free)

"""What the daemon counts, for Prometheus: its displays, its clients, what they say, what is wrong.

A display's counters are asked for when Prometheus asks; the rest is counted as it happens.
"""

import re
from collections.abc import Callable, Iterator
from typing import Protocol

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from tactile.messages import Code

BUCKETS = (5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.5, 1.0)
"""Of the time that a message takes [s]."""


class MetricsSource(Protocol):
    """What knows how the displays are; `tactile.server.host.Host` is one."""

    def figures(self) -> dict[str, dict[str, float]]:
        """Return for each display its counters by name."""
        ...

    def healthy(self) -> bool:
        """Return whether all that should play plays."""
        ...


class Displays(Collector):
    """The displays' counters and what the log lost, as they are when they are asked for."""

    def __init__(self, source: MetricsSource, dropped_logs: Callable[[], float]) -> None:
        self._source, self._dropped_logs = source, dropped_logs

    def collect(self) -> Iterator[Metric]:
        """Yield one family for each name; what ends in "_total" counts, the rest are levels."""
        yield CounterMetricFamily(
            "tactile_log_dropped", "Log lines not written.", self._dropped_logs()
        )
        yield GaugeMetricFamily(
            "tactile_healthy", "Whether all that should play plays.", int(self._source.healthy())
        )
        families: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
        for display, figures in self._source.figures().items():
            for figure, value in figures.items():
                name = "tactile_" + re.sub(r"[^a-z0-9_]", "_", figure.lower())
                if name not in families:
                    family = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
                    families[name] = family(name, f"Of a display: {figure}.", labels=["display"])
                families[name].add_metric([display], value)
        yield from families.values()


class Traffic:
    """What comes in by one transport."""

    def __init__(self, metrics: "Metrics", transport: str) -> None:
        self._metrics, self._transport = metrics, transport
        self.clients = metrics.clients.labels(transport)
        self._messages: dict[str, tuple[Counter, Histogram]] = {}

    def message(self, kind: str, seconds: float) -> None:
        """Count a message of a type and the time it took [s]."""
        bound = self._messages.get(kind)
        if bound is None:
            labels = self._transport, kind
            bound = self._metrics.messages.labels(*labels), self._metrics.seconds.labels(*labels)
            self._messages[kind] = bound
        bound[0].inc()
        bound[1].observe(seconds)

    def failure(self, code: Code) -> None:
        """Count what was answered by, or on OSC would be, a failure."""
        self._metrics.failures.labels(self._transport, code).inc()

    def drop(self, reason: str, count: int = 1) -> None:
        """Count what was not looked at, or not sent."""
        self._metrics.dropped.labels(self._transport, reason).inc(count)


class Metrics:
    """All that is counted, in a registry of its own.

    Parameters
    ----------
    source : of the displays' counters
    dropped_logs : how many lines of the log were not written
    """

    def __init__(
        self, source: MetricsSource, dropped_logs: Callable[[], float] = lambda: 0
    ) -> None:
        self.registry = CollectorRegistry(auto_describe=False)
        registry = self.registry
        self.clients = Gauge(
            "tactile_clients", "Clients at present.", ["transport"], registry=registry
        )
        self.messages = Counter(
            "tactile_messages",
            "Messages that were handled.",
            ["transport", "type"],
            registry=registry,
        )
        self.failures = Counter(
            "tactile_failures",
            "What was wrong with messages.",
            ["transport", "code"],
            registry=registry,
        )
        self.dropped = Counter(
            "tactile_dropped_messages", "Messages not handled or sent.",
            ["transport", "reason"], registry=registry,
        )  # fmt: skip
        self.strangers = Counter(
            "tactile_dropped_connections", "Connections that said nothing and made room.",
            registry=registry,
        )  # fmt: skip
        self.seconds = Histogram(
            "tactile_message_seconds", "From a message to its answer.",
            ["transport", "type"], buckets=BUCKETS, registry=registry,
        )  # fmt: skip
        self._traffic: dict[str, Traffic] = {}
        ProcessCollector(registry=self.registry)
        self.registry.register(Displays(source, dropped_logs))

    def of(self, transport: str) -> Traffic:
        """Return what counts for a transport."""
        if transport not in self._traffic:
            self._traffic[transport] = Traffic(self, transport)
        return self._traffic[transport]

    def text(self) -> bytes:
        """Return all of it, as Prometheus reads it."""
        return generate_latest(self.registry)

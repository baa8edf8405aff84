"""Metrics of the server for Prometheus: displays, clients, messages and failures.

The counters of displays are collected when Prometheus asks; everything else is counted as it
happens.
"""

import re
from collections.abc import Callable, Iterator

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
from tactile.server.host import Host

BUCKETS = (5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.5, 1.0)
"""Buckets of the time that a message takes [s]."""


class Displays(Collector):
    """Collector of the displays' counters and of the lost log lines, at the time of the request.

    Parameters
    ----------
    host : Host
        Displays of the server.
    dropped_logs : callable
        Function that returns the number of log lines that were not written.
    """

    def __init__(self, host: Host, dropped_logs: Callable[[], float]) -> None:
        self._host, self._dropped_logs = host, dropped_logs

    def collect(self) -> Iterator[Metric]:
        """Yield one family for each name; names ending in "_total" are counters, the others gauges.

        Yields
        ------
        Metric
            Family with one value for each display.
        """
        yield CounterMetricFamily(
            "tactile_log_dropped", "Log lines not written.", self._dropped_logs()
        )
        yield GaugeMetricFamily(
            "tactile_healthy", "Whether all that should play plays.", int(self._host.healthy())
        )
        families: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
        for display, figures in self._host.figures().items():
            for figure, value in figures.items():
                name = "tactile_" + re.sub(r"[^a-z0-9_]", "_", figure.lower())
                if name not in families:
                    family = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
                    families[name] = family(name, f"Of a display: {figure}.", labels=["display"])
                families[name].add_metric([display], value)
        yield from families.values()


class Traffic:
    """Counters of the messages of one transport.

    Parameters
    ----------
    metrics : Metrics
        Registry that the counters belong to.
    transport : str
        Name of the transport.

    Attributes
    ----------
    clients : Gauge
        Number of clients at present.
    """

    def __init__(self, metrics: "Metrics", transport: str) -> None:
        self._metrics, self._transport = metrics, transport
        self.clients = metrics.clients.labels(transport)
        self._messages: dict[str, tuple[Counter, Histogram]] = {}

    def message(self, kind: str, seconds: float) -> None:
        """Count a message and the time that it took.

        Parameters
        ----------
        kind : str
            Type of the message.
        seconds : float
            Time from the message to its answer [s].
        """
        bound = self._messages.get(kind)
        if bound is None:
            labels = self._transport, kind
            bound = self._metrics.messages.labels(*labels), self._metrics.seconds.labels(*labels)
            self._messages[kind] = bound
        bound[0].inc()
        bound[1].observe(seconds)

    def failure(self, code: Code) -> None:
        """Count a message that was answered by a failure, or would have been over OSC.

        Parameters
        ----------
        code : Code
            Kind of the failure.
        """
        self._metrics.failures.labels(self._transport, code).inc()

    def drop(self, reason: str, count: int = 1) -> None:
        """Count messages that were not processed, or not sent.

        Parameters
        ----------
        reason : str
            Reason why they were dropped.
        count : int
            Number of messages.
        """
        self._metrics.dropped.labels(self._transport, reason).inc(count)


class Metrics:
    """All metrics, in a registry of their own.

    Parameters
    ----------
    host : Host
        Displays of the server.
    dropped_logs : callable
        Function that returns the number of log lines that were not written.

    Attributes
    ----------
    registry : CollectorRegistry
        Registry of all metrics.
    clients, messages, failures, dropped, strangers, seconds : Gauge, Counter or Histogram
        Metrics with the labels of all transports, each described where it is created.
    """

    def __init__(self, host: Host, dropped_logs: Callable[[], float] = lambda: 0) -> None:
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
        self.registry.register(Displays(host, dropped_logs))

    def of(self, transport: str) -> Traffic:
        """Return the counters of a transport.

        Parameters
        ----------
        transport : str
            Name of the transport.

        Returns
        -------
        Traffic
            The same object for each call.
        """
        if transport not in self._traffic:
            self._traffic[transport] = Traffic(self, transport)
        return self._traffic[transport]

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus.

        Returns
        -------
        bytes
            Contents of ``/metrics``.
        """
        return generate_latest(self.registry)

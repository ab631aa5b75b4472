# SPDX-License-Identifier: Apache-2.0
"""Gauges as text for a monitor, in the format OpenMetrics 1.0 (https://openmetrics.io), which Prometheus reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime

from comarmor.values import dataclass

_ESCAPED = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})


@dataclass(frozen=True, slots=True)
class Gauge:
    """A gauge with its values.

    Attributes:
        name: its name, which ends with its unit if it has one.
        help: what it says, one sentence.
        samples: its values, each with labels by name, which differ.
        unit: the unit, e.g. ``seconds``; or empty.
    """

    name: str
    help: str
    samples: tuple[tuple[Mapping[str, str], float], ...]
    unit: str = ""


def moments(name: str, help_: str, by_label: Iterable[tuple[Mapping[str, str], datetime | None]]) -> Gauge:
    """Return a gauge of moments, in seconds since 1970; what has no moment has no sample."""
    samples = tuple((labels, moment.timestamp()) for labels, moment in by_label if moment is not None)
    return Gauge(f"{name}_timestamp_seconds", help_, samples, "seconds")


def openmetrics(gauges: Iterable[Gauge]) -> Iterator[str]:
    """Yield the lines of the text, without line ends."""
    for gauge in gauges:
        yield f"# TYPE {gauge.name} gauge"
        if gauge.unit:
            yield f"# UNIT {gauge.name} {gauge.unit}"
        yield f"# HELP {gauge.name} {gauge.help.translate(_ESCAPED)}"
        for by_name, value in gauge.samples:
            labels = ",".join(f'{name}="{text.translate(_ESCAPED)}"' for name, text in by_name.items())
            yield f"{gauge.name}{{{labels}}} {value:.15g}" if labels else f"{gauge.name} {value:.15g}"
    yield "# EOF"

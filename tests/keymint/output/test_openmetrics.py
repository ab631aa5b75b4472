# SPDX-License-Identifier: Apache-2.0
"""Gauges as text, read back by the parser of Prometheus' client."""

from __future__ import annotations

from datetime import UTC, datetime

from hypothesis import given, strategies as st
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from keymint.output.openmetrics import Gauge, moments, openmetrics

TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\r"), max_size=20)


@given(st.dictionaries(TEXT, st.floats(-1e12, 1e12).map(round), max_size=5), TEXT.map(str.strip))
def test_a_parser_reads_what_is_written(values: dict[str, float], help_: str) -> None:
    gauges = [Gauge("a_seconds", help_, "subject", values), Gauge("b", "B.", "authority", {"ca": 1})]
    text = "".join(f"{line}\n" for line in openmetrics(gauges))
    first, second = text_string_to_metric_families(text)
    assert (first.name, first.type, first.unit, first.documentation) == ("a_seconds", "gauge", "seconds", help_)
    assert {sample.labels["subject"]: sample.value for sample in first.samples} == values
    assert [sample.value for sample in second.samples] == [1]


def test_what_has_no_moment_has_no_sample() -> None:
    moment = datetime(2027, 1, 15, 8, tzinfo=UTC)
    gauge = moments("x", "X.", "subject", {"/a": moment, "/b": None})
    assert gauge == Gauge("keymint_x_timestamp_seconds", "X.", "subject", {"/a": 1_800_000_000})

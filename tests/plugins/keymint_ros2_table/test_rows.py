# SPDX-License-Identifier: Apache-2.0
"""Columns and places of rows."""

from __future__ import annotations

import pytest
from keymint_ros2_table.rows import COLUMNS, REQUIRED, column_order, row_origin

from comarmor.errors import ComArmorError, Origin


def test_the_order_of_columns() -> None:
    assert column_order(COLUMNS, Origin("t")) == tuple(range(7))
    assert column_order(REQUIRED[::-1], Origin("t")) == (4, 3, 2, 1, 0, -1, -1)


@pytest.mark.parametrize("name", REQUIRED)
def test_a_column_that_is_missing(name: str) -> None:
    with pytest.raises(ComArmorError, match=f"the column {name} is missing"):
        column_order([each for each in COLUMNS if each != name], Origin("t"))


def test_places() -> None:
    assert row_origin("a/t.csv", 7, "") == Origin("a/t.csv", 7)
    assert str(row_origin("a/t.csv", 7, "zones.xlsx:12")) == "zones.xlsx:12 [t.csv]:7"

# SPDX-License-Identifier: Apache-2.0
"""Key expressions of Zenoh: their notation, how two of them relate, and those that match what ``fnmatch`` matches."""

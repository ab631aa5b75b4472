# SPDX-License-Identifier: Apache-2.0
"""The model of Zenoh: what its access control decides about a message on a link, and whom it admits.

Measured on the library eclipse-zenoh 1.10.2; ``tests/real/test_zenoh_agreement.py`` compares
the two on random configurations.
"""

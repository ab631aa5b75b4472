# SPDX-License-Identifier: Apache-2.0
"""Configurations of Zenoh routers and sessions."""

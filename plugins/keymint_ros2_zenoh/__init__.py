# SPDX-License-Identifier: Apache-2.0
"""Build type for Zenoh: rules to the access control of one router and the configurations of its sessions."""

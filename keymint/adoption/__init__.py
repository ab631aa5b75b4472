# SPDX-License-Identifier: Apache-2.0
"""Take over keystores that another tool made: read them, compare them with a policy, and plan the workspace."""

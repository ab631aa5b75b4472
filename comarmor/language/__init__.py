# SPDX-License-Identifier: Apache-2.0
"""The ComArmor policy language: parse policies, decide requests, render policies, read policy tests."""

# SPDX-License-Identifier: Apache-2.0
"""Writes the permissions and governance documents of DDS Security 1.1, in the form that every vendor accepts."""

# SPDX-License-Identifier: Apache-2.0
"""Judge the bytes of a keystore: each rule once, each code raised in one place."""

#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs the real DDS software that tests/real uses (Debian or Ubuntu), the compilers for its probes, a token in software
# (PKCS #11) for keys in hardware, the browser for the tests of reports, and shells. If that fails, it
# prints the reason, and the tests that need it skip. With KEYMINT_REQUIRE_VENDORS=1 they fail, and so does this script.
set -euo pipefail
cd "$(dirname "$0")/.."

packages=(
    libddsc0debian cyclonedds-dev                # Cyclone DDS and its security plugins
    libfastrtps-dev libfastcdr-dev               # Fast DDS, with security compiled in
    gcc g++                                      # the probes of the real transports
    softhsm2 opensc libengine-pkcs11-openssl     # a token in software, its tools, and what Fast DDS asks tokens with
    openssl strace libfaketime                   # for other tests; the last one moves the clock
    chromium chromium-driver fonts-dejavu-core   # for the tests of pictures and reports
    zsh fish                                     # for the scripts of keystores, which bash, zsh and fish source
)
if .ci/apt-install "${packages[@]}"; then exit 0; fi
echo "setup-vendors: cannot install all of ${packages[*]} (see above): tests on real software will skip" >&2
[ "${KEYMINT_REQUIRE_VENDORS:-}" != 1 ]

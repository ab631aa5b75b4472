#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Renews what is due in a workspace, checks it, and writes its dates for a monitor. Run it daily: keymint-renew.timer, or renew.yml.
#
#   renew.sh WORKSPACE [METRICS]
#
# METRICS is a file for the textfile collector of Prometheus' node exporter, e.g. /var/lib/prometheus/node-exporter/keymint.prom.
# Exit codes: those of 'keymint renew', and 3 if 'keymint check' finds something.
set -u
workspace=${1:?"usage: renew.sh WORKSPACE [METRICS]"}
metrics=${2:-}

keymint renew --workspace "$workspace"
code=$?

if [ -n "$metrics" ]; then # the monitor never sees half a file
    keymint status --workspace "$workspace" --format openmetrics >"$metrics.new" && mv -f "$metrics.new" "$metrics"
fi

# Exit code 3 of 'renew' has been said; this finds what else is wrong, and what is about to expire in spite of it.
keymint check --workspace "$workspace" --within 14d || [ "$code" -ne 0 ] || code=3
exit "$code"

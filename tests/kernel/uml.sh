#!/bin/bash
# Run a command as root in user-mode Linux, with this machine's root, and return its exit code.
# What it writes to files is lost; its output comes out here.
# usage: uml.sh [--modules "vcan cuse"] [--seconds N] -- COMMAND...
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
. "$here/job.sh"
kernel=$kernels/uml

# The memory of the guest is a file in TMPDIR.
TMPDIR=$job run "$kernel/linux" mem=512M rootfstype=hostfs rootflags=/ ro init="$here/init.sh" \
    "job=$job" "kernel=$kernel" quiet \
    con=null con0=null,fd:1 ssl=null ssl1=null,fd:4 ssl2=null,fd:5 \
    4>&1 5>"$job/status" >"$job/console" 2>&1

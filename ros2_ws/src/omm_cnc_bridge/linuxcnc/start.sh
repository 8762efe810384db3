#!/bin/sh
# start.sh INI COMMAND…: starts LinuxCNC, and ends it when this script's input ends, which it does
# however the one who started it comes to an end. In namespaces of its own (omm_own_tmp is set then)
# it gets a loopback, and a /tmp for LinuxCNC's lock and logs.
set -e
folder=$(dirname "$1")
shift
cd "$folder"
if [ "$omm_own_tmp" ]; then
    ip link set lo up
    mount -t tmpfs -o mode=1777 tmpfs /tmp
    mkdir -p "$folder"
    mount --no-canonicalize --bind . "$folder" # where it lies in the /tmp that is now hidden
    cd "$folder"
fi
rm -f screen.pid
"$@" </dev/null >>output.txt 2>&1 &
linuxcnc=$!
while read -r _; do :; done
while [ ! -s screen.pid ] && kill -0 "$linuxcnc" 2>/dev/null; do sleep 0.1; done
kill "$(cat screen.pid)"
# One that hangs is not waited for: in namespaces of its own, it ends with this script.
tries=50
while kill -0 "$linuxcnc" 2>/dev/null && [ "$tries" -gt 0 ]; do
    sleep 0.1
    tries=$((tries - 1))
done

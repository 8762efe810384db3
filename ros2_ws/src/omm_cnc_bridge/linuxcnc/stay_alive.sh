#!/bin/sh
# LinuxCNC ends when its DISPLAY program ends: this one only waits. A machine has its own screen.
trap 'exit 0' TERM INT
echo $$ >screen.pid
while :; do sleep 1 & wait $!; done

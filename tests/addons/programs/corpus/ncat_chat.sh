#!/bin/sh
# ncat: agent 1 listens once and keeps what came, agent 2 sends lines with pauses.
if [ "$1" = 1 ]; then ncat -l 10.0.0.1 5083 --recv-only > got.txt; cat got.txt; echo "ended"
else sleep 1; for k in 1 2 3; do echo "line $k"; sleep 0.5; done | ncat --send-only 10.0.0.1 5083; echo "sent"; fi

#!/bin/sh
# iperf3: agent 1 serves one test, agent 2 sends 500 kB over TCP at 2 Mbit/s.
if [ "$1" = 1 ]; then iperf3 -s -1 -B 10.0.0.1 -p 5202 > server.txt; echo "served $?"
else sleep 1; iperf3 -c 10.0.0.1 -p 5202 -b 2M -n 500K -l 10K > client.txt; echo "ended with $?"; awk '/receiver/ {print "received", $5, $6}' client.txt; fi

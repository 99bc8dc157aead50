#!/bin/sh
# iperf3: agent 1 serves one test, agent 2 sends 3 seconds of UDP at 200 kbit/s.
if [ "$1" = 1 ]; then iperf3 -s -1 -B 10.0.0.1 -p 5201 > server.txt; echo "served $?"; grep -c receiver server.txt
else sleep 1; iperf3 -c 10.0.0.1 -p 5201 -u -b 200k -l 1000 -t 3 > client.txt; echo "ended with $?"; awk '/receiver/ {print "lost", $(NF-2), $(NF-1)}' client.txt; fi

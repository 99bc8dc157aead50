#!/bin/sh
# The tools of mosquitto: agent 2 subscribes, agent 3 publishes with a file of lines, agent 1 has the broker.
case $1 in
1) printf 'listener 1883 10.0.0.1\nallow_anonymous true\nuser root\nlog_dest stdout\nlog_type error\n' > mosquitto.conf
   /usr/sbin/mosquitto -c mosquitto.conf 2> mosquitto.err & broker=$!; sleep 6; kill -TERM $broker; wait $broker; echo "broker ended with $?";;
2) sleep 1; exec mosquitto_sub -h 10.0.0.1 -i two -t 'depth/#' -v -C 3 -q 1;;
3) sleep 2; for k in 1 2 3; do mosquitto_pub -h 10.0.0.1 -i three -t depth/$k -m "$k m" -q 1; sleep 0.5; done; echo published;;
esac

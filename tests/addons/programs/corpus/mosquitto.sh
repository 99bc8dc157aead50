#!/bin/sh
# mosquitto (Debian) is a child of agent 1 for 6.5 seconds, paho-mqtt the client in agents 2 and 3.
here=$(cd "$(dirname "$0")" && pwd)
[ "$1" = 1 ] || exec "${PYTHON:-python3}" "$here/mqtt_client.py" "$1"
printf 'listener 1883 10.0.0.1\nallow_anonymous true\nuser root\nlog_dest stdout\nlog_type error\n' > mosquitto.conf
/usr/sbin/mosquitto -c mosquitto.conf 2> mosquitto.err & broker=$!
sleep 6.5; kill -TERM $broker; wait $broker; echo "broker ended with $?"

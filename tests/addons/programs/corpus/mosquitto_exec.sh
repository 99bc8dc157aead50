#!/bin/sh
# As mosquitto.sh, but agent 1 becomes the broker by exec: it does not end by itself.
here=$(cd "$(dirname "$0")" && pwd)
[ "$1" = 1 ] || exec "${PYTHON:-python3}" "$here/mqtt_client.py" "$1"
printf 'listener 1883 10.0.0.1\nallow_anonymous true\nuser root\nlog_dest stdout\nlog_type error\n' > mosquitto.conf
exec /usr/sbin/mosquitto -c mosquitto.conf 2> mosquitto.err

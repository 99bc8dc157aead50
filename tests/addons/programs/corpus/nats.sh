#!/bin/sh
# nats-server (Debian, Go) is a child of agent 1 for 6 seconds, nats-py the client in agents 2 and 3.
here=$(cd "$(dirname "$0")" && pwd)
[ "$1" = 1 ] || exec "${PYTHON:-python3}" "$here/nats_client.py" "$1"
nats-server -a 10.0.0.1 -p 4222 -l nats.log & server=$!
sleep 6; kill -INT $server; wait $server; echo "server ended with $?"

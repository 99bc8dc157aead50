#!/bin/sh
# Agent 1 becomes redis-server by exec; agents 2 and 3 use redis-py, and agent 3 shuts the server down.
here=$(cd "$(dirname "$0")" && pwd)
[ "$1" = 1 ] && exec redis-server --bind 10.0.0.1 --port 6379 --save '' --appendonly no --protected-mode no --logfile redis.log
exec "${PYTHON:-python3}" "$here/redis_client.py" "$1"

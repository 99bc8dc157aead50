#!/bin/sh
# A shell script that waits, uses children and pipes, and ends in exec.
me=$1; here=$(cd "$(dirname "$0")" && pwd); python=${PYTHON:-python3}
sleep 0.5
for k in 1 2 3; do echo "line $k of $me"; done | sort -r | head -1
date +%Y | grep -c 20
GREETING="from the shell $(expr $me + 1)"; export GREETING
exec "$python" "$here/asyncio_datagrams.py" "$me"

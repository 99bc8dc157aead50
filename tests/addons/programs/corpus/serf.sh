#!/bin/sh
# serf (Debian, Go): a SWIM cluster of three agents, one event, then each prints who is alive.
me=$1; log=serf$me.log
[ "$me" = 1 ] || { sleep 0.5; join="-join 10.0.0.1"; }
serf agent -node "agent$me" -bind "10.0.0.$me:7946" -rpc-addr 127.0.0.1:7373 -profile local $join > $log 2>&1 & agent=$!
sleep 3; [ "$me" = 2 ] && serf event dive now
sleep 1; serf members | awk '{print $1, $3}' | sort
sleep 1; kill -INT $agent; wait $agent; echo "ended with $?"; grep -c 'Received event: user-event: dive' $log

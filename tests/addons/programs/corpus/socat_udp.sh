#!/bin/sh
# socat: agent 1 receives datagrams until 4 seconds are silent, and answers over TCP; agent 2 sends by children.
if [ "$1" = 1 ]; then
    socat TCP4-LISTEN:5082,bind=10.0.0.1,reuseaddr SYSTEM:'tr a-z A-Z' &
    socat -u -T 3 UDP4-RECV:5081 STDOUT; wait; echo "ended"
else
    sleep 1; for k in 1 2 3; do echo "line $k of 2" | socat -u - UDP4-SENDTO:10.0.0.1:5081; sleep 0.5; done
    (echo "hello by tcp"; sleep 0.5) | socat -t 1 - TCP4:10.0.0.1:5082
fi

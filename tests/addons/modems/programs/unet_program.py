"""A program that a user of UnetStack recognises: datagrams, a range, a reliable datagram. It knows nothing of us."""

import json
import sys

from unetpy import (
    DatagramDeliveryNtf,
    DatagramReq,
    Protocol,
    RangeNtf,
    RangeReq,
    Services,
    TxFrameNtf,
    TxFrameReq,
    UnetSocket,
)

WAIT_MS = 60_000
one, two = (UnetSocket("127.0.0.1", int(port)) for port in sys.argv[1:3])
found = {"addresses": [one.getLocalAddress(), two.getLocalAddress()], "host": one.host("auv2")}
found["nobody"] = one.host("nobody")
found["mtu"] = one.agentForService(Services.PHYSICAL).MTU
two.bind(Protocol.DATA)
two.setTimeout(WAIT_MS)
found["sent"] = [one.send([number, 2, 3], to=2) for number in range(5)]
heard = [two.receive() for _ in range(5)]
found["heard"] = [message.data for message in heard]
found["travel_us"] = [message.rxTime - message.txTime for message in heard]
found["too_long"] = one.send(bytes(5000), to=2)
gateway = one.getGateway()
found["range"] = gateway.request(RangeReq(recipient=one.agentForService(Services.RANGING), to=2), 5000).perf.value
found["range_m"] = gateway.receive(RangeNtf, WAIT_MS).range
link = one.agentForService(Services.LINK)
gateway.request(DatagramReq(recipient=link, to=2, data=[9, 9], reliability=True), 5000)
found["delivered"] = gateway.receive(DatagramDeliveryNtf, WAIT_MS).to
found["by_link"] = two.receive().data
phy = one.agentForService(Services.PHYSICAL)
found["asked_us"] = phy.time + 2_000_000
gateway.flush()
gateway.request(TxFrameReq(recipient=phy, to=2, data=[5], txTime=found["asked_us"]), 5000)
found["began_us"] = gateway.receive(TxFrameNtf, WAIT_MS).txTime
found["past"] = gateway.request(TxFrameReq(recipient=phy, to=2, data=[5], txTime=found["asked_us"]), 5000).reason
print(json.dumps(found))
for each in (one, two):
    each.close()

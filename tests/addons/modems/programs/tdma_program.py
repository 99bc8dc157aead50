"""Four programs for UnetStack in one: each has slots of its own, by the modem's clock."""

import json
import sys

from unetpy import Services, TxFrameNtf, TxFrameReq, UnetSocket

SLOT_US, TURNS, AHEAD_US = 60_000, 10, 1_000_000
gateways = [UnetSocket("127.0.0.1", port).getGateway() for port in map(int, sys.argv[1:])]
modems = [gateway.agentForService(Services.PHYSICAL) for gateway in gateways]
begin = modems[0].time + AHEAD_US
asked, began = [], []
for turn in range(TURNS):
    for n, gateway in enumerate(gateways):
        at = begin + (turn * len(gateways) + n) * SLOT_US
        gateway.send(TxFrameReq(recipient=modems[n], to=0, data=[turn], txTime=at))
        asked.append(at)
for _ in range(TURNS):
    began += [gateway.receive(TxFrameNtf, 30_000).txTime for gateway in gateways]
print(json.dumps({"late_us": [at - wanted for at, wanted in zip(began, asked, strict=True)]}))

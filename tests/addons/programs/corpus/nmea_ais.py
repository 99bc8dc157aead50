# pynmeagps and pyais: agent 1 sends its position and an AIS report by UDP broadcast, agent 2 decodes.
import datetime, socket, sys, time
from pynmeagps import GET, NMEAMessage, NMEAReader
from pyais import decode, encode_dict
me = int(sys.argv[1]); s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
if me == 1:
    s.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1); time.sleep(1.5)
    for k in range(3):
        now = datetime.datetime.now(datetime.timezone.utc)
        s.sendto(NMEAMessage("GN", "GLL", GET, lat=59.0 + k / 100, NS="N", lon=10.5, EW="E", time=now.time(), status="A", posMode="A").serialize(), ("10.0.0.255", 10110))
        for line in encode_dict({"msg_type": 1, "mmsi": 257000001, "lat": 59.0 + k / 100, "lon": 10.5, "speed": 3.5, "second": now.second}): s.sendto(line.encode(), ("10.0.0.255", 10110))
        time.sleep(1)
    print("sent")
else:
    s.bind(("", 10110)); s.settimeout(4)
    for k in range(6):
        data = s.recv(1000)
        if data.startswith(b"!"): m = decode(data); print("ais", m.mmsi, round(m.lat, 2), m.speed)
        else: m = NMEAReader.parse(data); print("nmea", m.msgID, m.lat, m.lon, type(m.time).__name__)
    print("done")

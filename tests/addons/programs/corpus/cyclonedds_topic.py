# CycloneDDS: three participants find each other by multicast; a reliable topic of a structure.
import sys, time
from dataclasses import dataclass
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

@dataclass
class Depth(IdlStruct):
    of: int
    k: int

me = int(sys.argv[1]); d = DomainParticipant(0); topic = Topic(d, "Depth", Depth)
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
writer, reader = DataWriter(d, topic, qos), DataReader(d, topic, qos); heard = set(); time.sleep(2)
for k in range(4):
    writer.write(Depth(me, k)); time.sleep(0.6); heard |= {(x.of, x.k) for x in reader.take(50)}
time.sleep(1); heard |= {(x.of, x.k) for x in reader.take(50)}
print(*sorted(x for x in heard if x[0] != me), "done")

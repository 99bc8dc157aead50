# twisted: a LineReceiver in agent 1, a client factory that tries again, and UDP with a LoopingCall.
import sys
from twisted.internet import protocol, reactor, task
from twisted.protocols.basic import LineReceiver
me = int(sys.argv[1]); other = 3 - me

class Udp(protocol.DatagramProtocol):
    def startProtocol(self): self.k = 0; self.loop = task.LoopingCall(self.send); self.loop.start(1, now=False)
    def send(self): self.transport.write(b"udp %d of %d" % (self.k, me), (f"10.0.0.{other}", 5030)); self.k += 1
    def datagramReceived(self, data, address): print("heard", data.decode(), address[0])

class Line(LineReceiver):
    def connectionMade(self): self.sendLine(b"hello of %d" % me)
    def lineReceived(self, line): print("line", line.decode())
    def connectionLost(self, reason): print("lost", reason.type.__name__)

reactor.listenUDP(5030, Udp())
if me == 1: reactor.callLater(0.2, lambda: reactor.listenTCP(5030, protocol.ServerFactory.forProtocol(Line), interface="10.0.0.1"))
else:
    factory = protocol.ReconnectingClientFactory.forProtocol(Line); factory.jitter = 0; reactor.callLater(1.5, reactor.connectTCP, "10.0.0.1", 5030, factory)
    reactor.callLater(4.2, lambda: (factory.stopTrying(), factory.connector and factory.connector.disconnect()))
reactor.callLater(5.5, reactor.stop); reactor.run(); print("done")

# thespian: an actor system of processes over TCP in agent 1; its answer goes by UDP to agent 2.
import socket, sys, time
from thespian.actors import Actor, ActorSystem
me = int(sys.argv[1]); s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

class Depth(Actor):
    total = 0
    def receiveMessage(self, message, sender):
        if isinstance(message, int): self.total += message; self.send(sender, self.total)

if __name__ == "__main__" and me == 1:
    system = ActorSystem("multiprocTCPBase", {"Admin Port": 1900}); actor = system.createActor(Depth)
    time.sleep(1)
    for k in range(3): s.sendto(b"%d" % system.ask(actor, k, 2), ("10.0.0.2", 5051)); time.sleep(0.5)
    system.shutdown(); print("done")
elif __name__ == "__main__":
    s.bind(("", 5051)); s.settimeout(7)
    for k in range(3): print("heard", s.recv(100))
